// @ts-check
/** What a cloud or grid looks like: the looks of `rayset render`, its colours, and their bar. */

import { classColors, drawBar, isLogarithmic, isMap, nameOf } from "./colors.js";
import { editor } from "./transfer.js";
import { checkbox, color, element, following, number, panel, select, short, slider } from "./widgets.js";

/** @typedef {import("./view.js").RaysetView} RaysetView */
/** @typedef {import("./view.js").Style} Style */
/** @typedef {import("./view.js").Legend} Legend */

const OWN = "those of the look";
const ONE = "a single colour";
const AS = "look:";
/** Colours that no map of the list has: those of classes, of a scan's Hounsfield units. */
const OTHER = "";

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

  const look = select("Look", [["", "automatic"], ...looks.map((name) => /** @type {[string, string]} */ ([name, name]))],
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
  const map = select("Colour map", [[OTHER, "that of the look"], ...palettes.flatMap(([name]) => /** @type {[string, string][]} */ ([[name, name], [`${name}_r`, `${name}, reversed`]]))],
    (name) => act({ colormap: name || undefined, color: undefined }));
  const end = (/** @type {0 | 1} */ which) => number(which ? "value at the upper end of the colour map" : "value at the lower end of the colour map", (value) => {
    const range = shownRange(view.legend);
    /** @type {[number, number]} */
    const changed = [...range];
    changed[which] = value;
    act({ valueRange: changed });
  });
  const [low, high] = [end(0), end(1)];
  const rangeName = element("span", {}, ["Value range"]);
  const range = element("div", { class: "row wide" }, [rangeName, low.input, high.input]);
  const log = checkbox("Logarithmic", false, (on) => act({ log: on || undefined }));
  // By powers of two, from a sixteenth to sixteen times.
  const radius = slider("Point radius", [-4, 4, 0.25], 0, (power) => restyle({ radiusScale: power ? 2 ** power : undefined }),
    (power) => `${short(2 ** power)}×`);
  const bar = element("canvas", { class: "bar", width: "256", height: "58", role: "img" });
  const caption = element("p", { class: "caption" });
  const classes = element("ul", { class: "classes", "aria-label": "Colours of classes" });
  const said = element("p", { class: "caption" });
  look.row.title = "How the data are shown; automatic: chosen from the data";
  by.row.title = "What the colours show";
  map.row.title = "The colours, from the lowest to the highest value";
  log.row.title = "Colours follow the logarithm of the values";
  radius.row.title = "The radius of all points, as a multiple of their own";

  /** The style that the legend tells of. */
  let told = "";
  const follow = () => {
    const style = shown();
    const isTold = told === JSON.stringify(style);
    look.input.value = style.look ?? "";
    by.input.value = style.color ? AS : style.colorBy ?? "";
    if (style.color) one.input.value = style.color;
    radius.set(Math.log2(style.radiusScale ?? 1));
    one.row.hidden = !style.color;
    const transfer = view.legend?.transferFunction ?? {};
    const hasMap = isMap(transfer.color, palettes);
    const isLog = isTold && hasMap && isLogarithmic(transfer.color, shownRange(view.legend));
    log.input.checked = Boolean(style.log) || isLog;
    // The logarithm belongs to the look then.
    log.input.disabled = isLog && !style.log;
    map.row.hidden = range.hidden = log.row.hidden = Boolean(style.color) || (!hasMap && !style.colormap);
    const name = style.colormap ?? (hasMap ? nameOf(transfer.color, shownRange(view.legend), palettes) : null);
    map.input.value = name ?? OTHER;
    [low, high].forEach((each, k) => each.set(transfer.valueRange?.[k]));
    const named = isTold ? classColors(view) : [];
    classes.replaceChildren(...named.map(({ color: shownColor, name: shownName }) => {
      const swatch = element("span", { class: "swatch" });
      swatch.style.background = shownColor;
      return element("li", {}, [swatch, shownName]);
    }));
    classes.hidden = !named.length;
    // Between two classes there is nothing to show or to change.
    range.hidden ||= named.length > 0;
    log.row.hidden ||= named.length > 0;
    bar.hidden = caption.hidden = !hasMap || named.length > 0;
    // Without the options that say otherwise: here, the controls do.
    said.textContent = (view.legend?.line ?? "").replace(/; --.*$/, "");
    const attribute = attributes.find((each) => each.name === transfer.input);
    rangeName.textContent = `Value range${attribute?.unit ? `, ${attribute.unit}` : ""}`;
    if (!bar.hidden) drawBar(/** @type {HTMLCanvasElement} */ (bar), caption, view);
  };
  // Before the others hear of it.
  view.addEventListener("legend", () => (told = JSON.stringify(shown())));
  if (view.legend) told = JSON.stringify(shown());
  following(view, follow);
  return [
    panel("Look", [look.row, by.row, one.row, map.row, range, log.row, bar, caption, classes, ...(attributes.length ? [radius.row] : []), said], true),
    editor(view, begin, restyle),
  ];
}

/** @param {Legend | null} legend @returns {[number, number]} */
const shownRange = (legend) => legend?.transferFunction?.valueRange ?? [0, 1];
