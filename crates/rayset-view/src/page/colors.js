// @ts-check
/** Colour maps as scene files write them: what they are called, and a bar that shows them. */

import { short } from "./widgets.js";

/** @typedef {import("./view.js").RaysetView} RaysetView */
/** @typedef {[string, string[]][]} Palettes names, each with colours evenly spaced */
/** @typedef {[number, string][]} Stops places from 0 to 1, and their colours */

/** Fewer stops may grow by equal factors by chance. */
const FEWEST = 8;
/** Most that a channel of a map's colours is off from those of a palette that it was made of. */
const OFF = 6;

/** Whether a colour, as a scene file writes it, is a map. @param {unknown} given @param {Palettes} palettes */
export function isMap(given, palettes) {
  if (Array.isArray(given)) return Array.isArray(given[0]);
  return typeof given === "string" && palettes.some(([name]) => given === name || given === `${name}_r`);
}

/** @param {any} given @param {Palettes} palettes @returns {Stops} */
export function stopsOf(given, palettes) {
  if (Array.isArray(given)) return given.map(([at, shown]) => [at, shown]);
  const isReversed = given.endsWith("_r");
  const colors = palettes.find(([name]) => name === given.replace(/_r$/, ""))?.[1] ?? [];
  const ordered = isReversed ? [...colors].reverse() : colors;
  return ordered.map((shown, k) => [k / (ordered.length - 1), shown]);
}

/**
 * Whether a map is one over the logarithm: its stops stand for values that grow by the same factor from one to the next.
 * @param {unknown} given @param {[number, number]} range
 */
export function isLogarithmic(given, [low, high]) {
  if (!Array.isArray(given) || given.length < FEWEST || !Array.isArray(given[0])) return false;
  const values = given.map(([at]) => low + at * (high - low));
  const factors = values.slice(1).map((value, k) => value / values[k]);
  const last = factors[factors.length - 1];
  // Near the lower end, places are differences of nearly equal numbers.
  return values.every((value) => value > 0) && Math.abs(last - 1) > 1e-3 && factors.every((factor) => Math.abs(factor / last - 1) < 1e-3);
}

/** @param {string} color `#rrggbb` @returns {number[]} */
const channels = (color) => [1, 3, 5].map((at) => Number.parseInt(color.slice(at, at + 2), 16));

/** The colour of a map at a place. @param {Stops} stops @param {number} at @returns {number[]} */
function colorAt(stops, at) {
  const next = stops.findIndex(([place]) => place >= at);
  if (next <= 0) return channels(stops[next === 0 ? 0 : stops.length - 1][1]);
  const [[from, a], [to, b]] = [stops[next - 1], stops[next]];
  const t = to > from ? (at - from) / (to - from) : 1;
  return channels(a).map((v, k) => v + t * (channels(b)[k] - v));
}

/**
 * The colours of classes or labels, each with its name.
 * @param {RaysetView} view @returns {{color: string, name: string}[]}
 */
export function classColors(view) {
  const { transferFunction: shown, classes } = view.legend ?? {};
  if (!shown || !classes?.length || !view.choices || !isMap(shown.color, view.choices.palettes)) return [];
  const stops = stopsOf(shown.color, view.choices.palettes);
  const [low, high] = shown.valueRange ?? [0, 1];
  return classes.map(([value, name]) => ({ color: `rgb(${colorAt(stops, (value - low) / (high - low)).join(" ")})`, name }));
}

/**
 * The name of the palette that a map has the colours of; `null` if it has others.
 * @param {any} given @param {[number, number]} range @param {Palettes} palettes @returns {string | null}
 */
export function nameOf(given, range, palettes) {
  if (typeof given === "string") return given;
  const shown = stopsOf(given, palettes);
  const isLog = isLogarithmic(given, range);
  const places = Array.from({ length: 17 }, (_, k) => k / 16);
  const of = places.map((t) => colorAt(shown, isLog ? logPlace(t, range) : t));
  const isLike = (/** @type {string} */ name) => {
    const stops = stopsOf(name, palettes);
    return places.every((t, k) => colorAt(stops, t).every((v, c) => Math.abs(v - of[k][c]) <= OFF));
  };
  return palettes.flatMap(([name]) => [name, `${name}_r`]).find(isLike) ?? null;
}

/** Where on a map, in parts of its range, the value is that is a part of the way along the logarithm. @param {number} t @param {[number, number]} range */
const logPlace = (t, [low, high]) => (low * (high / low) ** t - low) / (high - low);

/**
 * The part of the way along a bar where a value is.
 * @param {number} value @param {[number, number]} range @param {boolean} isLog
 */
const along = (value, [low, high], isLog) =>
  isLog ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low || 1);

/** Round values for the marks of a bar. @param {[number, number]} range @param {boolean} isLog @returns {number[]} */
export function ticks([a, b], isLog) {
  const [low, high] = [Math.min(a, b), Math.max(a, b)];
  if (!(high > low)) return [low];
  if (isLog) {
    const [first, last] = [Math.ceil(Math.log10(low) - 1e-9), Math.floor(Math.log10(high) + 1e-9)];
    const step = Math.max(Math.ceil((last - first) / 4), 1);
    const powers = [];
    for (let power = first; power <= last; power += step) powers.push(10 ** power);
    if (powers.length >= 2) return powers.map((value) => Number(value.toPrecision(1)));
    return [low, Math.sqrt(low * high), high].map((value) => Number(value.toPrecision(3)));
  }
  const rough = (high - low) / 4;
  const power = 10 ** Math.floor(Math.log10(rough));
  const unit = ([1, 2, 5, 10].find((factor) => factor * power >= rough) ?? 10) * power;
  const marks = [];
  for (let k = Math.ceil(low / unit - 1e-9); k * unit <= high + 1e-9 * unit; k++) marks.push(Number((k * unit).toPrecision(6)));
  return marks;
}

/**
 * Draws the bar of what a view shows in colours of a map: spread of the values, colours, marks.
 * @param {HTMLCanvasElement} canvas @param {HTMLElement} caption @param {RaysetView} view
 */
export function drawBar(canvas, caption, view) {
  const context = canvas.getContext("2d");
  const shown = view.legend?.transferFunction;
  if (!context || !shown || !view.choices) return;
  const { width, height } = canvas;
  /** @type {[number, number]} */
  const range = shown.valueRange ?? [0, 1];
  const isLog = isLogarithmic(shown.color, range);
  const input = shown.input ?? (view.choices.attributes.length ? "density" : "value");
  const attribute = view.choices.attributes.find(({ name }) => name === input);
  const [barTop, barHeight] = [height - 28, 14];
  context.clearRect(0, 0, width, height);
  const gradient = context.createLinearGradient(0, 0, width, 0);
  for (const [at, shownColor] of stopsOf(shown.color, view.choices.palettes)) {
    const place = isLog ? along(range[0] + at * (range[1] - range[0]), range, true) : at;
    gradient.addColorStop(Math.min(Math.max(place, 0), 1), shownColor);
  }
  context.fillStyle = gradient;
  context.fillRect(0, barTop, width, barHeight);
  // How the values are spread over the bar.
  const spread = attribute?.histogram ?? (attribute ? null : view.legend?.densities);
  if (spread) {
    const most = Math.max(...spread.counts, 1);
    const at = (/** @type {number} */ k) => {
      const t = k / spread.counts.length;
      const value = spread.logarithmic ? spread.low * (spread.high / spread.low) ** t : spread.low + t * (spread.high - spread.low);
      return along(isLog ? Math.max(value, 1e-300) : value, range, isLog) * width;
    };
    spread.counts.forEach((count, k) => {
      const [left, end] = [at(k), at(k + 1)];
      const tall = (count / most) * (barTop - 4);
      context.fillRect(Math.min(left, end), barTop - 2 - tall, Math.max(Math.abs(end - left) - 0.5, 0.5), tall);
    });
  }
  const unit = attribute?.unit ? ` ${attribute.unit}` : "";
  context.fillStyle = getComputedStyle(caption).color;
  context.font = "11px system-ui, sans-serif";
  context.textBaseline = "bottom";
  let free = -Infinity;
  for (const value of ticks(range, isLog).sort((a, b) => along(a, range, isLog) - along(b, range, isLog))) {
    const text = short(value);
    const x = along(value, range, isLog) * width;
    const wide = context.measureText(text).width;
    const left = Math.min(Math.max(x - wide / 2, 0), width - wide);
    if (left < free) continue;
    context.fillRect(Math.min(Math.max(x - 0.5, 0), width - 1), barTop + barHeight, 1, 3);
    context.fillText(text, left, height + 1);
    free = left + wide + 6;
  }
  const scale = isLog ? ", log scale" : "";
  caption.textContent = `${input}: ${short(range[0])} to ${short(range[1])}${unit}${scale}`;
  canvas.setAttribute("aria-label", `Colours of ${input} from ${short(range[0])} to ${short(range[1])}${unit}${scale}`);
}
