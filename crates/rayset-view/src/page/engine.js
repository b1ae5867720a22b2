// @ts-check
/** What the engine does: which pages of the cloud are in memory, drawn on a map of it, and what was read for them. */

import { dot } from "./camera.js";
import { bytes, checkbox, element, panel, short } from "./widgets.js";

/** @typedef {import("./view.js").RaysetView} RaysetView */
/** @typedef {import("./view.js").Report} Report */
/** @typedef {import("./camera.js").Vector} Vector */

/** Milliseconds between two reports. */
const BETWEEN = 500;
/** Milliseconds after which a report is asked for again. */
const PATIENCE = 5000;

/** @param {RaysetView} view */
export function enginePanel(view) {
  const map = /** @type {HTMLCanvasElement} */ (element("canvas", { class: "map", width: "256", height: "256", role: "img",
    "aria-label": "Map of the cloud: bright where its pages are in memory" }));
  const caption = element("p", { class: "caption" });
  const table = element("table", { class: "numbers" });
  let isOn = false;
  let timer = 0;
  /** @type {[Vector, Vector][]} */
  let boxes = [];

  const ask = async () => {
    clearTimeout(timer);
    if (!isOn) return;
    // A question that is not answered is asked again.
    timer = window.setTimeout(ask, PATIENCE);
    try {
      const report = await view.engine(boxes.length === 0);
      if (report.regions) boxes = report.regions;
      map.hidden = boxes.length === 0;
      caption.textContent = numbers(table, report) + (boxes.length ? ". The map shows the cloud from above: bright is in memory, the dot is the camera." : ".");
      draw(map, boxes, report.resident, view);
    } catch {
      // Not connected, or asked again: the next attempt may be luckier.
      return;
    }
    clearTimeout(timer);
    timer = window.setTimeout(ask, BETWEEN);
  };
  const on = checkbox("Show memory", false, (checked) => {
    const wasOn = isOn;
    isOn = checked;
    map.hidden = caption.hidden = table.hidden = !checked;
    if (checked && !wasOn) ask();
  });
  map.hidden = caption.hidden = table.hidden = true;
  on.row.title = "Watch which parts of the file are in memory, and what is read";
  return panel("Memory", [on.row, map, caption, table]);
}

/** @param {HTMLElement} table @param {Report} report */
function numbers(table, report) {
  const used = report.kinds.reduce((sum, kind) => sum + kind.bytes, 0);
  const kinds = report.kinds.filter((kind) => kind.bytes || kind.hits || kind.misses);
  /** @type {[string, (kind: Report["kinds"][0]) => string][]} */
  const rows = [
    ["in memory", (kind) => bytes(kind.bytes)],
    ["found in memory", (kind) => (kind.hits + kind.misses ? `${((100 * kind.hits) / (kind.hits + kind.misses)).toFixed(2)} %` : "")],
    ["requests", (kind) => short(kind.hits + kind.misses)],
    ["pages read", (kind) => short(kind.reads)],
    ["bytes read", (kind) => bytes(kind.bytesRead)],
    ["for the first time", (kind) => bytes(kind.bytesUnique)],
    ["evicted", (kind) => short(kind.evictions)],
    ["time waited, s", (kind) => short(Number(kind.waitedSeconds.toFixed(3)))],
  ];
  const head = element("tr", {}, [element("td"), ...kinds.map(({ name }) => element("th", { scope: "col" }, [name]))]);
  const lines = rows.map(([name, of]) =>
    element("tr", {}, [element("th", { scope: "row" }, [name]), ...kinds.map((kind) => element("td", {}, [of(kind)]))]));
  table.replaceChildren(element("tbody", {}, [head, ...lines]));
  return `${bytes(used)} of ${bytes(report.budget)} for parts of the file are in use`;
}

/**
 * Draws the regions of a cloud from above, those on top last.
 * @param {HTMLCanvasElement} canvas @param {[Vector, Vector][]} boxes @param {number[]} resident @param {RaysetView} view
 */
function draw(canvas, boxes, resident, view) {
  const context = canvas.getContext("2d");
  if (!context || boxes.length === 0) return;
  const up = view.vertical;
  const above = [0, 1, 2].reduce((best, k) => (Math.abs(up[k]) > Math.abs(up[best]) ? k : best), 0);
  // Two axes as on a map: to the right, and away from the reader.
  const [east, north] = above === 1 ? [0, 2] : [(above + 1) % 3, (above + 2) % 3];
  const flip = above === 1 ? 1 : -1;
  const [low, high] = [0, 1].map((end) => [east, north].map((axis) => boxes.reduce((v, box) => (end ? Math.max : Math.min)(v, box[end][axis]), end ? -Infinity : Infinity)));
  const size = Math.max(high[0] - low[0], high[1] - low[1]) || 1;
  const unit = (canvas.width - 16) / size;
  const middle = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2];
  const x = (/** @type {Vector} */ p) => canvas.width / 2 + (p[east] - middle[0]) * unit;
  const y = (/** @type {Vector} */ p) => canvas.height / 2 + flip * (p[north] - middle[1]) * unit;
  context.clearRect(0, 0, canvas.width, canvas.height);
  const ordered = boxes.map((box, k) => ({ box, part: resident[k] ?? 0 })).sort((a, b) => a.part - b.part);
  for (const { box: [least, largest], part } of ordered) {
    const [left, right] = [x(least), x(largest)];
    const [top, bottom] = [Math.min(y(least), y(largest)), Math.max(y(least), y(largest))];
    context.fillStyle = part > 0 ? `hsl(${215 - 175 * part} 85% ${35 + 25 * part}% / ${0.35 + 0.5 * part})` : "hsl(215 10% 50% / 0.22)";
    context.fillRect(left, top, Math.max(right - left, 1), Math.max(bottom - top, 1));
  }
  const camera = view.camera;
  if (!camera) return;
  // The eye, and how wide it sees.
  const half = Math.atan(Math.tan((camera.fovy * Math.PI) / 360) * (view.canvas.width / view.canvas.height));
  const ahead = Math.atan2(flip * camera.direction[north], camera.direction[east]);
  const [eyeX, eyeY] = [x(camera.position), y(camera.position)];
  context.strokeStyle = context.fillStyle = getComputedStyle(canvas).color;
  context.beginPath();
  for (const angle of [ahead - half, ahead + half]) {
    context.moveTo(eyeX, eyeY);
    context.lineTo(eyeX + 400 * Math.cos(angle), eyeY + 400 * Math.sin(angle));
  }
  if (Math.abs(dot(camera.direction, up)) < 0.98) context.stroke();
  context.beginPath();
  context.arc(Math.min(Math.max(eyeX, 4), canvas.width - 4), Math.min(Math.max(eyeY, 4), canvas.height - 4), 4, 0, 2 * Math.PI);
  context.fill();
}
