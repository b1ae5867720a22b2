// @ts-check
/** What a cloud or grid looks like: the looks of `rayset render`, its colours, and their bar. */

import { editor } from "./transfer.js";
import { checkbox, color, element, following, number, panel, select, short, slider } from "./widgets.js";

/** @typedef {import("./view.js").RaysetView} RaysetView */
/** @typedef {import("./view.js").Style} Style */
/** @typedef {import("./view.js").Legend} Legend */

const OWN = "as the look has it";
const ONE = "one colour";
const AS = "look:";

/** @param {RaysetView} view @param {() => void} begin */
export function lookPanel(view, begin) {
  const choices = view.choices;
  if (!choices) return [];
  const { looks, attributes, palettes } = choices;

  /** What was chosen last: here, or when the program was started. @returns {Style} */
  const shown = () => view.changes.style ?? choices.style;
  /** @param {Partial<Style>} part */
  const restyle = (part) => {
    const style = { ...shown(), ...part };
    for (const key of Object.keys(style)) if (/** @type {any} */ (style)[key] === undefined) delete (/** @type {any} */ (style)[key]);
    view.changes = { ...view.changes, style };
  };
  const act = (/** @type {Partial<Style>} */ part) => (begin(), restyle(part));

  const look = select("Look", [["", "chosen from the data"], ...looks.map((name) => /** @type {[string, string]} */ ([name, name]))],
    // Opacity is over another density, and colours over other values.
    (name) => act({ look: name || undefined, opacity: undefined, color: undefined, colorBy: undefined, colormap: undefined,
      valueRange: undefined, log: undefined }));
  // Voxels have nothing but their values.
  const shows = attributes.length ? ["density", ...attributes.map(({ name }) => name)] : [];
  const by = select("Colours", [["", OWN], [AS, ONE], ...shows.map((name) => /** @type {[string, string]} */ ([name, `by ${name}`]))],
    (name) => {
      const nothing = { color: undefined, colorBy: undefined, valueRange: undefined, log: undefined, colormap: undefined };
      if (!name) return act(nothing);
      if (name === AS) return act({ ...nothing, color: one.input.value });
      const range = attributes.find((each) => each.name === name)?.range ?? view.legend?.densities;
      const [low, high] = Array.isArray(range) ? range : [range?.low ?? 0, range?.high ?? 1];
      act({ ...nothing, colorBy: name, colormap: shown().colormap ?? "viridis",
        valueRange: low < high ? [low, high] : [low, low + 1] });
    });
  const one = color("Colour", "#dbccb2", (value) => restyle({ color: value }));
  const map = select("Map", palettes.flatMap(([name]) => /** @type {[string, string][]} */ ([[name, name], [`${name}_r`, `${name}, reversed`]])),
    (name) => act({ colormap: name, color: undefined }));
  const end = (/** @type {0 | 1} */ which) => number(which ? "largest value of the map" : "least value of the map", (value) => {
    const range = shownRange(view.legend);
    /** @type {[number, number]} */
    const changed = [...range];
    changed[which] = value;
    act({ valueRange: changed });
  });
  const [low, high] = [end(0), end(1)];
  const range = element("div", { class: "row" }, [element("span", {}, ["Range"]), low.input, high.input]);
  const log = checkbox("Logarithm", false, (on) => act({ log: on || undefined }));
  // By powers of two, from a sixteenth to sixteen times.
  const radius = slider("Point radius", [-4, 4, 0.25], 0, (power) => restyle({ radiusScale: power ? 2 ** power : undefined }),
    (power) => `${short(2 ** power)}×`);
  const bar = element("canvas", { class: "bar", width: "256", height: "44", role: "img" });
  const caption = element("p", { class: "caption" });
  const said = element("p", { class: "caption" });

  const follow = () => {
    const style = shown();
    look.input.value = style.look ?? "";
    by.input.value = style.color ? AS : style.colorBy ?? "";
    if (style.color) one.input.value = style.color;
    radius.set(Math.log2(style.radiusScale ?? 1));
    one.row.hidden = !style.color;
    if (style.colormap) map.input.value = style.colormap;
    log.input.checked = Boolean(style.log);
    const transfer = view.legend?.transferFunction ?? {};
    const hasMap = isMap(transfer.color, palettes);
    map.row.hidden = range.hidden = log.row.hidden = Boolean(style.color) || (!hasMap && !style.colormap);
    if (hasMap && !style.colormap && typeof transfer.color === "string") map.input.value = transfer.color;
    [low, high].forEach((each, k) => each.set(transfer.valueRange?.[k]));
    bar.hidden = caption.hidden = !hasMap;
    // Of what the program says of its choice, the look and its reason; colours are told by the bar.
    said.textContent = view.legend?.line?.match(/^[^(]*\([^)]*\)/)?.[0] ?? "";
    if (hasMap) drawBar(/** @type {HTMLCanvasElement} */ (bar), caption, view);
  };
  following(view, follow);
  return [
    panel("Look", [look.row, by.row, one.row, map.row, range, log.row, bar, caption, ...(attributes.length ? [radius.row] : []), said], true),
    editor(view, begin, restyle),
  ];
}

/** @param {Legend | null} legend @returns {[number, number]} */
const shownRange = (legend) => legend?.transferFunction?.valueRange ?? [0, 1];

/** @param {unknown} given @param {[string, string[]][]} palettes */
function isMap(given, palettes) {
  if (Array.isArray(given)) return Array.isArray(given[0]);
  return typeof given === "string" && palettes.some(([name]) => given === name || given === `${name}_r`);
}

/**
 * The colours of a map at places from 0 to 1.
 * @param {any} given as a scene file has it @param {[string, string[]][]} palettes @returns {[number, string][]}
 */
function stops(given, palettes) {
  if (Array.isArray(given)) return given.map(([at, shown]) => [at, shown]);
  const isReversed = given.endsWith("_r");
  const colors = palettes.find(([name]) => name === given.replace(/_r$/, ""))?.[1] ?? [];
  const ordered = isReversed ? [...colors].reverse() : colors;
  return ordered.map((shown, k) => [k / (ordered.length - 1), shown]);
}

/** @param {HTMLCanvasElement} canvas @param {HTMLElement} caption @param {RaysetView} view */
function drawBar(canvas, caption, view) {
  const context = canvas.getContext("2d");
  const shown = view.legend?.transferFunction;
  if (!context || !shown || !view.choices) return;
  const { width, height } = canvas;
  const [low, high] = shownRange(view.legend);
  const input = shown.input ?? (view.choices.attributes.length ? "density" : "value");
  const attribute = view.choices.attributes.find(({ name }) => name === input);
  context.clearRect(0, 0, width, height);
  const gradient = context.createLinearGradient(0, 0, width, 0);
  for (const [at, shownColor] of stops(shown.color, view.choices.palettes)) {
    gradient.addColorStop(Math.min(Math.max(at, 0), 1), shownColor);
  }
  context.fillStyle = gradient;
  context.fillRect(0, height - 14, width, 14);
  // How the values are spread over the bar.
  const spread = attribute?.histogram ?? (attribute ? null : view.legend?.densities);
  if (spread) {
    const most = Math.max(...spread.counts, 1);
    const at = (/** @type {number} */ k) => {
      const t = k / spread.counts.length;
      const value = spread.logarithmic ? spread.low * (spread.high / spread.low) ** t : spread.low + t * (spread.high - spread.low);
      return ((value - low) / (high - low || 1)) * width;
    };
    spread.counts.forEach((count, k) => {
      const [left, end] = [at(k), at(k + 1)];
      const tall = (count / most) * (height - 18);
      context.fillRect(left, height - 16 - tall, Math.max(end - left - 0.5, 0.5), tall);
    });
  }
  const unit = attribute?.unit ? ` ${attribute.unit}` : "";
  caption.textContent = `${short(low)} to ${short(high)}${unit}: ${input}`;
  canvas.setAttribute("aria-label", `Colours of ${input} from ${short(low)} to ${short(high)}${unit}`);
}
