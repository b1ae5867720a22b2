// @ts-check
/** Exposure, and a sun in the place of the scene's. */

import { checkbox, element, following, panel, shape, slider } from "./widgets.js";

/** @typedef {import("./view.js").RaysetView} RaysetView */
/** @typedef {import("./camera.js").Vector} Vector */

/** @param {RaysetView} view @param {() => void} begin */
export function lightPanel(view, begin) {
  const own = view.scene?.lights?.find?.((/** @type {any} */ each) => each.type === "directional");
  const up = view.vertical;
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
  const stopsText = (/** @type {number} */ v) => `${v > 0 ? "+" : ""}${v.toFixed(1)} stops`;
  const exposure = slider("Exposure", [-4, 4, 0.1], view.scene?.image?.exposure ?? 0,
    (stops) => (view.changes = { ...view.changes, exposure: stops }), stopsText);
  const ownExposure = view.scene?.image?.exposure ?? 0;
  const shadows = checkbox("Shadows", sun.shadow, (on) => (begin(), (sun.shadow = on), apply()));
  const dial = sunDial(sun, (azimuth, elevation) => {
    [sun.azimuth, sun.elevation] = [azimuth, elevation];
    apply();
  }, begin);
  const around = slider("Sun azimuth", [-180, 180, 1], sun.azimuth, (v) => ((sun.azimuth = v), apply()), degrees);
  const height = slider("Sun height", [-90, 90, 1], sun.elevation, (v) => ((sun.elevation = v), apply()), degrees);
  const bright = slider("Sun intensity", [0, 3, 0.05], sun.intensity, (v) => ((sun.intensity = v), apply()), one);
  const follow = () => {
    exposure.set(view.changes.exposure ?? view.legend?.exposure ?? ownExposure);
    sun = view.changes.sun ? placed(view.changes.sun) : { ...first };
    around.set(sun.azimuth);
    height.set(sun.elevation);
    bright.set(sun.intensity);
    shadows.input.checked = sun.shadow;
    dial.set(sun.azimuth, sun.elevation);
    for (const { row } of sunny) row.hidden = view.legend?.isLit === false;
  };
  const names = ["x", "y", "z"];
  exposure.row.title = "Brightness of the picture: one stop more is twice the light";
  dial.row.title = "The sky: drag the sun; overhead is the middle, the horizon is the outer circle";
  around.row.title = `Where the sun stands, counterclockwise seen from above: 0° along ${names[east]}, 90° along ${names[north]}`;
  height.row.title = "Angle of the sun above the horizon";
  bright.row.title = "How bright the sun is";
  shadows.row.title = "The sun casts shadows";
  const sunny = [dial, around, height, bright, shadows];
  following(view, follow);
  return panel("Light", [exposure.row, ...sunny.map(({ row }) => row)]);
}

/**
 * The sky from below: the sun where it stands, overhead in the middle, at the horizon on the rim.
 * @param {{azimuth: number, elevation: number}} first degrees @param {(azimuth: number, elevation: number) => void} moved
 * @param {() => void} begin
 */
function sunDial(first, moved, begin) {
  const RIM = 40;
  const sun = shape("circle", { r: 6, class: "sun" });
  const svg = shape("svg", { viewBox: "-50 -50 100 100", class: "dial", "aria-hidden": "true" });
  svg.append(shape("circle", { r: RIM, class: "sky" }), shape("circle", { r: RIM / 2, class: "sky" }), sun);
  const set = (/** @type {number} */ azimuth, /** @type {number} */ elevation) => {
    const far = RIM * (1 - Math.max(elevation, 0) / 90);
    const angle = (azimuth * Math.PI) / 180;
    sun.setAttribute("cx", `${far * Math.cos(angle)}`);
    sun.setAttribute("cy", `${-far * Math.sin(angle)}`);
    sun.classList.toggle("below", elevation < 0);
  };
  const follow = (/** @type {PointerEvent} */ event) => {
    const box = svg.getBoundingClientRect();
    const x = ((event.clientX - box.left) / box.width) * 100 - 50;
    const y = ((event.clientY - box.top) / box.height) * 100 - 50;
    const far = Math.min(Math.hypot(x, y) / RIM, 1);
    moved(Math.round((Math.atan2(-y, x) * 180) / Math.PI), Math.round(90 * (1 - far)));
  };
  svg.addEventListener("pointerdown", (event) => {
    begin();
    svg.setPointerCapture(event.pointerId);
    follow(event);
  });
  svg.addEventListener("pointermove", (event) => svg.hasPointerCapture(event.pointerId) && follow(event));
  set(first.azimuth, first.elevation);
  return { row: element("div", { class: "row" }, [element("span", {}, ["Sun"]), svg]), set };
}
