// @ts-check
/** The panels beside the picture: each is built once, and follows the view. */

import { lookFrom, STANDARD } from "./gestures.js";

/** @typedef {import("./view.js").RaysetView} RaysetView */
/** @typedef {import("./camera.js").Vector} Vector */

/**
 * @param {string} name @param {Record<string, string>} [attributes] @param {(Node | string)[]} [children]
 * @returns {HTMLElement}
 */
function element(name, attributes = {}, children = []) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

/** @param {string} text @param {() => void} act */
function button(text, act) {
  const made = element("button", { type: "button" }, [text]);
  made.addEventListener("click", act);
  return made;
}

let numbers = 0;

/**
 * A slider in a row of its own.
 * @param {string} name @param {[number, number, number]} range least, largest, step @param {number} value
 * @param {(value: number) => void} changed @param {(value: number) => string} [text]
 */
function slider(name, [min, max, step], value, changed, text = (v) => String(v)) {
  const id = `slider-${numbers++}`;
  const input = /** @type {HTMLInputElement} */ (
    element("input", { id, type: "range", min: `${min}`, max: `${max}`, step: `${step}`, value: `${value}` })
  );
  const output = element("output", { for: id }, [text(value)]);
  input.addEventListener("input", () => {
    output.textContent = text(input.valueAsNumber);
    changed(input.valueAsNumber);
  });
  const set = (/** @type {number} */ now) => {
    if (document.activeElement !== input) input.value = `${now}`;
    output.textContent = text(now);
  };
  return { row: element("div", { class: "row" }, [element("label", { for: id }, [name]), input, output]), input, set };
}

/** @param {string} name @param {boolean} value @param {(value: boolean) => void} changed */
function checkbox(name, value, changed) {
  const id = `check-${numbers++}`;
  const input = /** @type {HTMLInputElement} */ (element("input", { id, type: "checkbox" }));
  input.checked = value;
  input.addEventListener("change", () => changed(input.checked));
  return { row: element("div", { class: "row" }, [element("label", { for: id }, [name]), input]), input };
}

/** @param {string} title @param {Node[]} children */
const section = (title, children) => element("section", {}, [element("h2", {}, [title]), ...children]);

/**
 * Fills the panels of a view.
 * @param {HTMLElement} into @param {RaysetView} view @param {() => void} begin called before a change that may be taken back
 */
export function build(into, view, begin) {
  into.replaceChildren(viewpoints(view, begin), light(view, begin), sectionBox(view, begin), outAgain(view));
  for (const input of into.querySelectorAll("input")) input.addEventListener("pointerdown", begin);
}

/** @param {RaysetView} view @param {() => void} begin */
function viewpoints(view, begin) {
  const act = (/** @type {() => void} */ change) => () => (begin(), change());
  const home = button("Whole", act(() => (view.camera = view.home)));
  home.title = "See the scene whole (H)";
  const along = STANDARD.map(([name, direction]) => {
    const made = button(name, act(() => lookFrom(view, direction)));
    made.setAttribute("aria-label", `Look from ${name}`);
    return made;
  });
  return section("View", [element("div", { class: "buttons" }, [home, ...along])]);
}

/** @param {RaysetView} view @param {() => void} begin */
function light(view, begin) {
  const own = view.scene?.lights?.find?.((/** @type {any} */ each) => each.type === "directional");
  const up = view.home?.up ?? [0, 1, 0];
  // The sun is told by its place in the sky, against what is up.
  const axis = [0, 1, 2].reduce((best, k) => (Math.abs(up[k]) > Math.abs(up[best]) ? k : best), 0);
  const sign = Math.sign(up[axis]) || 1;
  const [east, north] = [(axis + 1) % 3, (axis + 2) % 3];
  const placed = (/** @type {import("./view.js").Sun} */ { direction, intensity, shadow }) => {
    const toward = direction.map((v) => -v / (Math.hypot(...direction) || 1));
    const height = Math.min(Math.max(toward[axis] * sign, -1), 1);
    const azimuth = (Math.atan2(toward[north], toward[east]) * 180) / Math.PI;
    return { azimuth, elevation: (Math.asin(height) * 180) / Math.PI, intensity, shadow };
  };
  const first = placed({ direction: own?.direction ?? [-0.5, -1, -0.5], intensity: own?.intensity ?? 1,
    shadow: own ? own.shadow !== false : false });
  let sun = { ...first };
  const apply = () => {
    const [a, e] = [(sun.azimuth * Math.PI) / 180, (sun.elevation * Math.PI) / 180];
    /** @type {Vector} */
    const goes = [0, 0, 0];
    goes[axis] = -Math.sin(e) * sign;
    goes[east] = -Math.cos(e) * Math.cos(a);
    goes[north] = -Math.cos(e) * Math.sin(a);
    view.changes = { ...view.changes, sun: { direction: goes, intensity: sun.intensity, shadow: sun.shadow } };
  };
  const degrees = (/** @type {number} */ v) => `${Math.round(v)}°`;
  const one = (/** @type {number} */ v) => v.toFixed(1);
  const exposure = slider("Exposure", [-4, 4, 0.1], view.scene?.image?.exposure ?? 0,
    (stops) => (view.changes = { ...view.changes, exposure: stops }), one);
  const ownExposure = view.scene?.image?.exposure ?? 0;
  const shadows = checkbox("Shadows", sun.shadow, (on) => (begin(), (sun.shadow = on), apply()));
  const around = slider("Sun, around", [-180, 180, 1], sun.azimuth, (v) => ((sun.azimuth = v), apply()), degrees);
  const height = slider("Sun, height", [-90, 90, 1], sun.elevation, (v) => ((sun.elevation = v), apply()), degrees);
  const bright = slider("Sun, bright", [0, 3, 0.05], sun.intensity, (v) => ((sun.intensity = v), apply()), one);
  const follow = () => {
    exposure.set(view.changes.exposure ?? ownExposure);
    sun = view.changes.sun ? placed(view.changes.sun) : { ...first };
    around.set(sun.azimuth);
    height.set(sun.elevation);
    bright.set(sun.intensity);
    shadows.input.checked = sun.shadow;
  };
  view.addEventListener("change", follow);
  follow();
  if (view.scene?.lights === "none") return section("Light", [exposure.row]);
  return section("Light", [exposure.row, around.row, height.row, bright.row, shadows.row]);
}

/** @param {RaysetView} view @param {() => void} begin */
function sectionBox(view, begin) {
  const [low, high] = view.bounds;
  const part = [[0, 1], [0, 1], [0, 1]];
  let on = false;
  const at = (/** @type {number} */ axis, /** @type {number} */ v) => (v === 1 ? high[axis] : low[axis] + v * (high[axis] - low[axis]));
  const apply = () => {
    const { section: _, ...others } = view.changes;
    if (!on) return void (view.changes = others);
    const corner = (/** @type {number} */ k) => /** @type {Vector} */ ([0, 1, 2].map((axis) => at(axis, part[axis][k])));
    view.changes = { ...others, section: { min: corner(0), max: corner(1) } };
  };
  const rows = checkbox("Section", false, (checked) => (begin(), (on = checked), apply()));
  const sliders = ["x", "y", "z"].flatMap((name, axis) => [0, 1].map((end) => {
    // A thousandth of the scene is told apart, however far from the origin it lies.
    const digits = Math.min(Math.max(3 - Math.floor(Math.log10(high[axis] - low[axis] || 1)), 0), 12);
    const text = (/** @type {number} */ v) => at(axis, v).toFixed(digits);
    return slider(`${name} ${end ? "to" : "from"}`, [0, 1, 0.005], end, (v) => {
      const apart = 0.005;
      part[axis][end] = end ? Math.max(v, part[axis][0] + apart) : Math.min(v, part[axis][1] - apart);
      on = true;
      apply();
    }, text);
  }));
  const follow = () => {
    const box = view.changes.section;
    rows.input.checked = on = Boolean(box);
    // Without a box, the sliders keep what it was.
    if (!box) return;
    for (let axis = 0; axis < 3; axis++) {
      [box.min, box.max].forEach((corner, end) => {
        const size = high[axis] - low[axis] || 1;
        part[axis][end] = Math.min(Math.max((corner[axis] - low[axis]) / size, 0), 1);
        sliders[2 * axis + end].set(part[axis][end]);
      });
    }
  };
  view.addEventListener("change", follow);
  follow();
  return section("Section box", [rows.row, ...sliders.map(({ row }) => row)]);
}

/** @param {RaysetView} view */
function outAgain(view) {
  const save = button("Save scene", async () => {
    const text = await view.sceneFile();
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([text], { type: "application/json" }));
    link.download = "scene.json";
    link.click();
    URL.revokeObjectURL(link.href);
  });
  const picture = button("Save picture", () => {
    view.canvas.toBlob((blob) => {
      if (!blob) return;
      const link = document.createElement("a");
      link.href = URL.createObjectURL(blob);
      link.download = "picture.png";
      link.click();
      URL.revokeObjectURL(link.href);
    });
  });
  const another = button("New window", async () => window.open(await view.invitation(), "_blank", "noopener"));
  const hint = element("p", {}, ["A saved scene is rendered by: rayset render scene.json -o picture.png"]);
  return section("Out again", [element("div", { class: "buttons" }, [save, picture, another]), hint]);
}
