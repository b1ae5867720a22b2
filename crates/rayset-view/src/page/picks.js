// @ts-check
/** Asking what is seen: a click tells of a point, two clicks of the distance between two, a double click turns about it. */

import { focus, subtract } from "./camera.js";
import { button, buttons, element, panel, short } from "./widgets.js";

/** @typedef {import("./view.js").RaysetView} RaysetView */
/** @typedef {import("./view.js").Picked} Picked */
/** @typedef {import("./overlay.js").Overlay} Overlay */

/** A pointer that moves less than so many pixels clicks. */
const STILL = 4;
/** What a double click leaves of the distance. */
const NEARER = 0.5;

/** @param {RaysetView} view @param {() => void} begin @param {Overlay} overlay */
export function picksPanel(view, begin, overlay) {
  const { canvas } = view;
  /** @type {Picked[]} the last two, the latest last */
  let picks = [];
  const told = element("div", { "aria-live": "polite" });
  const hint = "Click a point of the picture for its coordinates and values, and another one for the distance; Enter takes the middle. "
    + "A double click, or F for the middle, makes a point the one that the camera turns about.";
  const clear = button("Clear", () => ((picks = []), show()));
  clear.title = "Remove the points from the list and the picture";
  const note = element("p", { class: "caption", role: "status" });
  const made = panel("Measure", [told, note, buttons([clear])]);

  const show = () => {
    clear.hidden = picks.length === 0;
    note.textContent = "";
    told.replaceChildren(...(picks.length ? picks.map((pick, k) => table(pick, view.unit, picks.length > 1 ? `Point ${k + 1}` : "Point")) : [element("p", {}, [hint])]));
    const [a, b] = picks.map(placeOf);
    if (a && b) {
      const apart = subtract(b, a);
      const steps = picks.map(({ step }) => step ?? 0);
      const exact = digits(Math.max(...picks.map(({ error }) => error)), Math.max(...steps));
      const unit = view.unit ? ` ${view.unit}` : "";
      told.append(element("p", { class: "distance" }, [`Distance ${exact(Math.hypot(...apart))}${unit}`]),
        element("p", { class: "caption" }, [`along x, y, z: ${apart.map(exact).join(", ")}${unit}`]));
    }
    overlay.redraw();
  };
  overlay.set("picks", () => {
    const places = picks.map(placeOf);
    const [a, b] = places;
    return { marks: places.map((at, k) => ({ at, label: `${k + 1}` })), lines: a && b ? [[a, b]] : [] };
  });

  /** @param {number} x @param {number} y from the left and the top, 0 to 1 @param {(pick: Picked) => void} then */
  const ask = async (x, y, then) => {
    /** @type {Picked} */
    let pick;
    try {
      pick = await view.pick(x, y);
    } catch {
      // Not connected, or asked again.
      return;
    }
    if (pick.position) then(pick);
    else {
      made.open = true;
      note.textContent = "Nothing is seen there.";
      note.scrollIntoView({ block: "nearest" });
    }
  };
  const keep = (/** @type {Picked} */ pick) => {
    picks = [...picks.slice(-1), pick];
    made.open = true;
    show();
    // The answer, beside panels that are open above.
    told.lastElementChild?.scrollIntoView({ block: "nearest" });
  };
  const turnAbout = (/** @type {Picked} */ pick) => {
    if (!view.camera || !pick.position) return;
    begin();
    view.camera = focus(view.camera, pick.position, NEARER);
  };

  /** Where the pointer went down; none once it has moved away from there. @type {[number, number] | null} */
  let pressed = null;
  /** @type {number} */
  let waiting = 0;
  const place = (/** @type {MouseEvent} */ event) => {
    const box = canvas.getBoundingClientRect();
    return /** @type {[number, number]} */ ([(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height]);
  };
  canvas.addEventListener("pointerdown", (event) => {
    const clicks = event.isPrimary && event.button === 0 && !event.shiftKey;
    pressed = clicks ? [event.clientX, event.clientY] : null;
  });
  // A drag that comes back to where it began is no click.
  canvas.addEventListener("pointermove", (event) => {
    if (pressed && Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) > STILL) pressed = null;
  });
  canvas.addEventListener("pointerup", (event) => {
    if (!pressed || !event.isPrimary) return;
    pressed = null;
    const at = place(event);
    // The first half of a double click is not told of.
    clearTimeout(waiting);
    waiting = window.setTimeout(() => ask(...at, keep), 250);
  });
  canvas.addEventListener("dblclick", (event) => {
    clearTimeout(waiting);
    ask(...place(event), turnAbout);
  });
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === "Enter") ask(0.5, 0.5, keep);
    if (event.key.toLowerCase() === "f") ask(0.5, 0.5, turnAbout);
  });
  show();
  return made;
}

/** @param {Picked} pick @returns {import("./camera.js").Vector} */
const placeOf = (pick) => /** @type {import("./camera.js").Vector} */ (pick.point?.position ?? pick.position);

/** The decimals that multiples of a step have. @param {number} step */
function decimalsOf(step) {
  const isWhole = (/** @type {number} */ k) => Math.abs(step * 10 ** k - Math.round(step * 10 ** k)) < 1e-6 && Math.round(step * 10 ** k) > 0;
  for (let k = 0; k < 9; k++) if (isWhole(k)) return k;
  return Math.ceil(-Math.log10(step));
}

/**
 * Writes numbers that are known up to an error, and are multiples of a step if there is one, with the digits that both leave.
 * @param {number} error @param {number | null} [step] @returns {(value: number) => string}
 */
function digits(error, step) {
  const known = error > 0 ? Math.floor(-Math.log10(2 * error) + 1e-9) : 9;
  const decimals = step ? Math.min(known, decimalsOf(step)) : known;
  return (value) => {
    const size = Math.abs(value);
    if (size >= 1e9 || (size > 0 && size < 1e-6)) {
      return value.toExponential(Math.min(Math.max(decimals + Math.floor(Math.log10(size)), 0), 15));
    }
    if (decimals > 0) return value.toFixed(Math.min(decimals, 9)).replace(/(\.\d*?)0+$/, "$1").replace(/\.$/, "");
    const unit = 10 ** -decimals;
    return String(Math.round(value / unit) * unit);
  };
}

/** @param {Picked} pick @param {string | null} unit of lengths @param {string} title */
function table(pick, unit, title) {
  const { point } = pick;
  const lengths = unit ? ` ${unit}` : "";
  const inScene = (/** @type {number[]} */ at) => `${at.map(digits(pick.error, pick.step)).join(", ")}${lengths}`;
  const inFile = point && `${point.stored.map((v, axis) => digits(point.error, point.step?.[axis])(v)).join(", ")}${lengths}`;
  /** @type {[string, string][]} */
  const rows = [["x, y, z", inFile ?? inScene(/** @type {number[]} */ (pick.position))]];
  if (pick.value !== null) rows.push(["value", short(pick.value)]);
  const isMoved = point && point.stored.some((v, k) => v !== point.position[k]);
  if (isMoved) rows.push(["in the scene", inScene(point.position)]);
  const values = new Map(point?.values.map(([name, value]) => [name, value]));
  const isColored = ["red", "green", "blue"].every((name) => values.has(name));
  if (isColored) rows.push(["colour", ["red", "green", "blue"].map((name) => values.get(name)).join(", ")]);
  for (const [name, value, unit] of point?.values ?? []) {
    if (isColored && ["red", "green", "blue"].includes(name)) continue;
    rows.push([name, `${short(value)}${unit ? ` ${unit}` : ""}`]);
  }
  return element("table", {}, [element("caption", {}, [title]), element("tbody", {}, rows.map(([name, text]) =>
    element("tr", {}, [element("th", { scope: "row" }, [name]), element("td", {}, [text])])))]);
}
