// @ts-check
/** Opacity over density or value: a curve over the data's histogram, whose points are dragged, or moved with arrow keys. */

import { button, buttons, element, following, panel, shape, short } from "./widgets.js";

/** @typedef {import("./view.js").RaysetView} RaysetView */
/** @typedef {import("./view.js").Style} Style */
/** @typedef {[number, number]} Point value and opacity */

const [WIDTH, HEIGHT, MARGIN] = [256, 120, 10];
/** Points that a curve is simplified to before it is edited. */
const MOST_POINTS = 10;

/**
 * @param {RaysetView} view @param {() => void} begin @param {(part: Partial<Style>) => void} restyle
 */
export function editor(view, begin, restyle) {
  const svg = shape("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: "curve", role: "group",
    "aria-label": "Opacity over the values; points are moved with arrow keys, Delete removes one" });
  const under = shape("g", { class: "spread" });
  const line = shape("polyline");
  const dots = shape("g");
  svg.append(under, line, dots);
  const caption = element("p", { class: "caption" });
  /** @type {Point[]} */
  let points = [];
  /** Whether a point is being moved, so that the curve is what the person has, and not what the program says. */
  let isHeld = false;
  /** The range that is shown; it stays while a point is moved. @type {{low: number, high: number, isLog: boolean} | null} */
  let held = null;

  const range = () => held ?? shownRange();
  const shownRange = () => {
    const spread = view.legend?.densities;
    const values = points.map(([value]) => value);
    const [low, high] = [Math.min(...values, spread?.low ?? Infinity), Math.max(...values, spread?.high ?? -Infinity)];
    const isLog = Boolean(spread?.logarithmic) && low > 0;
    return { low, high: high > low ? high : low + 1, isLog };
  };
  const x = (/** @type {number} */ value) => {
    const { low, high, isLog } = range();
    const t = isLog ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
    return MARGIN + t * (WIDTH - 2 * MARGIN);
  };
  const y = (/** @type {number} */ opacity) => HEIGHT - MARGIN - opacity * (HEIGHT - 2 * MARGIN);
  const valueAt = (/** @type {number} */ at) => {
    const { low, high, isLog } = range();
    const t = Math.min(Math.max((at - MARGIN) / (WIDTH - 2 * MARGIN), 0), 1);
    return isLog ? low * (high / low) ** t : low + t * (high - low);
  };
  const opacityAt = (/** @type {number} */ at) => Math.min(Math.max((HEIGHT - MARGIN - at) / (HEIGHT - 2 * MARGIN), 0), 1);

  const apply = () => restyle({ opacity: points.map(([value, opacity]) => [value, opacity]) });

  const draw = () => {
    const spread = view.legend?.densities;
    under.replaceChildren();
    if (spread) {
      const most = Math.max(...spread.counts, 1);
      spread.counts.forEach((count, k) => {
        const edge = (/** @type {number} */ i) => {
          const t = i / spread.counts.length;
          return x(spread.logarithmic ? spread.low * (spread.high / spread.low) ** t : spread.low + t * (spread.high - spread.low));
        };
        // By their roots: few values are seen beside many.
        const tall = Math.sqrt(count / most) * (HEIGHT - 2 * MARGIN);
        under.append(shape("rect", { x: edge(k), y: HEIGHT - MARGIN - tall, width: Math.max(edge(k + 1) - edge(k) - 0.5, 0.5), height: tall }));
      });
    }
    line.setAttribute("points", points.map(([value, opacity]) => `${x(value)},${y(opacity)}`).join(" "));
    while (dots.childElementCount > points.length) dots.lastElementChild?.remove();
    while (dots.childElementCount < points.length) dots.append(dot(dots.childElementCount));
    points.forEach(([value, opacity], k) => {
      const at = dots.children[k];
      at.setAttribute("cx", `${x(value)}`);
      at.setAttribute("cy", `${y(opacity)}`);
      at.setAttribute("aria-label", `point ${k + 1}: opacity ${opacity.toFixed(2)} at ${short(value)}`);
    });
    const { low, high } = range();
    const over = view.choices?.attributes.length ? "density" : "value";
    caption.textContent = points.length
      ? `Opacity, 0 at the bottom to 1 at the top, over ${over}, ${short(low)} to ${short(high)}${spread ? "; grey bars: how often each occurs" : ""}` : "";
  };

  /** Moves a point, between its neighbours. @param {number} k @param {number} value @param {number} opacity */
  const move = (k, value, opacity) => {
    const [least, most] = [points[k - 1]?.[0] ?? -Infinity, points[k + 1]?.[0] ?? Infinity];
    points[k] = [Math.min(Math.max(value, least), most), opacity];
    draw();
    apply();
  };

  /** @param {number} k */
  const dot = (k) => {
    const made = shape("circle", { r: 5, tabindex: 0, role: "button" });
    made.addEventListener("pointerdown", (event) => {
      begin();
      held = shownRange();
      isHeld = true;
      made.setPointerCapture(event.pointerId);
      event.stopPropagation();
    });
    made.addEventListener("pointermove", (event) => {
      if (!isHeld || !made.hasPointerCapture(event.pointerId)) return;
      const [px, py] = place(event);
      move(k, valueAt(px), opacityAt(py));
    });
    for (const ended of /** @type {const} */ (["pointerup", "pointercancel"])) made.addEventListener(ended, () => {
      isHeld = false;
      held = null;
      draw();
    });
    made.addEventListener("keydown", (event) => {
      const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
      const step = /** @type {Record<string, number[]>} */ (steps)[event.key];
      if (event.key === "Delete" && points.length > 2) {
        begin();
        points.splice(k, 1);
        draw();
        apply();
      } else if (step) {
        if (!event.repeat) begin();
        move(k, valueAt(x(points[k][0]) + 2 * step[0]), Math.min(Math.max(points[k][1] + 0.02 * step[1], 0), 1));
      } else return;
      event.preventDefault();
    });
    return made;
  };

  /** @param {MouseEvent} event @returns {[number, number]} */
  const place = (event) => {
    const box = svg.getBoundingClientRect();
    return [((event.clientX - box.left) / box.width) * WIDTH, ((event.clientY - box.top) / box.height) * HEIGHT];
  };
  svg.addEventListener("dblclick", (event) => {
    if (event.target instanceof Element && event.target.tagName === "circle") return;
    const [px, py] = place(event);
    begin();
    points = [...points, /** @type {Point} */ ([valueAt(px), opacityAt(py)])].sort((a, b) => a[0] - b[0]);
    draw();
    apply();
  });

  const add = button("Add point", () => {
    // In the middle of the longest piece.
    const gaps = points.slice(1).map((point, k) => x(point[0]) - x(points[k][0]));
    const k = gaps.indexOf(Math.max(...gaps));
    if (k < 0) return;
    begin();
    const [a, b] = [points[k], points[k + 1]];
    points.splice(k + 1, 0, [valueAt((x(a[0]) + x(b[0])) / 2), (a[1] + b[1]) / 2]);
    draw();
    apply();
  });
  add.title = "Add a point in the middle of the longest piece of the curve; a double click on the curve adds one there";
  const reset = button("Reset", () => (begin(), restyle({ opacity: undefined })), "Reset opacity to that of the look");
  const made = panel("Opacity", [svg, caption, buttons([add, reset])]);
  const follow = () => {
    if (isHeld) return;
    const own = (view.changes.style ?? view.choices?.style)?.opacity;
    points = Array.isArray(own) ? own.map(([value, opacity]) => /** @type {Point} */ ([value, opacity])) : curve(view.legend?.transferFunction?.opacity);
    made.hidden = points.length === 0;
    draw();
  };
  following(view, follow);
  return made;
}

/** An opacity rule of a scene file as a curve of few points. @param {any} rule @returns {Point[]} */
function curve(rule) {
  if (rule === "clamp") return [[0, 0], [1, 1]];
  if (typeof rule?.extinction === "number" && rule.extinction > 0) {
    return [0, 0.25, 0.5, 1, 2, 4].map((depth) => [depth / rule.extinction, 1 - Math.exp(-depth)]);
  }
  return Array.isArray(rule) ? simplified(rule.map(([value, opacity]) => [value, opacity])) : [];
}

/** The points of a curve that matter most: one after another, the one that is farthest from the lines between those before. @param {Point[]} points @returns {Point[]} */
function simplified(points) {
  const kept = new Set([0, points.length - 1]);
  while (kept.size < Math.min(MOST_POINTS, points.length)) {
    const known = [...kept].sort((a, b) => a - b);
    let [worst, farthest] = [0, -1];
    for (let i = 1; i < known.length; i++) {
      const [from, to] = [known[i - 1], known[i]];
      for (let k = from + 1; k < to; k++) {
        const t = (points[k][0] - points[from][0]) / (points[to][0] - points[from][0] || 1);
        const off = Math.abs(points[k][1] - (points[from][1] + t * (points[to][1] - points[from][1])));
        if (off > farthest) [worst, farthest] = [k, off];
      }
    }
    if (farthest < 0) break;
    kept.add(worst);
  }
  return [...kept].sort((a, b) => a - b).map((k) => points[k]);
}
