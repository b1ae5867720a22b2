// @ts-check
/** Mouse, touch and keys on the picture, as movements of a camera. */

import { fly, lookAlong, orbit, pan, zoom } from "./camera.js";

/** @typedef {import("./view.js").RaysetView} RaysetView */

/** Radians for a drag across the whole height. */
const TURN = Math.PI;
/** What a key moves in a second: radians, factors, distances to the pivot. */
const SPEED = { turn: 1.2, zoom: 2.5, fly: 0.8 };
/** @type {Record<string, [number, number, number, number, number, number]>} across, over, nearer, ahead, sideways, upward */
const KEYS = {
  ArrowLeft: [1, 0, 0, 0, 0, 0],
  ArrowRight: [-1, 0, 0, 0, 0, 0],
  ArrowUp: [0, -1, 0, 0, 0, 0],
  ArrowDown: [0, 1, 0, 0, 0, 0],
  "+": [0, 0, -1, 0, 0, 0],
  "=": [0, 0, -1, 0, 0, 0],
  "-": [0, 0, 1, 0, 0, 0],
  w: [0, 0, 0, 1, 0, 0],
  s: [0, 0, 0, -1, 0, 0],
  a: [0, 0, 0, 0, -1, 0],
  d: [0, 0, 0, 0, 1, 0],
  q: [0, 0, 0, 0, 0, -1],
  e: [0, 0, 0, 0, 0, 1],
};

/**
 * Lets a person move the camera of a view.
 * @param {RaysetView} view @param {() => void} begin called before each movement, which may be taken back as a whole
 */
export function listen(view, begin) {
  const { canvas } = view;
  /** @type {Map<number, {x: number, y: number}>} pointers that are down */
  const down = new Map();
  let wheeling = 0;

  /** A place of the picture, -1 to 1. @param {{x: number, y: number}} at @returns {[number, number, number]} and the aspect */
  const place = ({ x, y }) => {
    const box = canvas.getBoundingClientRect();
    const across = ((x - box.left) / box.width) * 2 - 1;
    return [across, 1 - ((y - box.top) / box.height) * 2, box.width / box.height];
  };

  canvas.addEventListener("pointerdown", (event) => {
    if (down.size === 0) begin();
    canvas.setPointerCapture(event.pointerId);
    down.set(event.pointerId, { x: event.clientX, y: event.clientY });
    canvas.focus();
  });

  canvas.addEventListener("pointermove", (event) => {
    const before = down.get(event.pointerId);
    if (!before || !view.camera) return;
    const now = { x: event.clientX, y: event.clientY };
    const height = canvas.clientHeight || 1;
    const [x, y] = [(now.x - before.x) / height, (now.y - before.y) / height];
    const other = [...down].find(([id]) => id !== event.pointerId)?.[1];
    if (other) {
      const apart = (/** @type {{x: number, y: number}} */ at) => Math.hypot(at.x - other.x, at.y - other.y);
      const middle = { x: (now.x + other.x) / 2, y: (now.y + other.y) / 2 };
      const factor = apart(before) / Math.max(apart(now), 1);
      view.camera = pan(zoom(view.camera, factor, ...place(middle)), x / 2, y / 2);
    } else if (event.buttons & 6 || event.shiftKey) {
      view.camera = pan(view.camera, x, y);
    } else {
      view.camera = orbit(view.camera, -x * TURN, -y * TURN);
    }
    down.set(event.pointerId, now);
  });

  for (const name of /** @type {const} */ (["pointerup", "pointercancel"])) {
    canvas.addEventListener(name, (event) => down.delete(event.pointerId));
  }
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());

  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    if (!view.camera) return;
    const now = performance.now();
    if (now - wheeling > 400) begin();
    wheeling = now;
    // Lines and pages, where a browser counts in those.
    const pixels = event.deltaY * [1, 16, 400][event.deltaMode];
    const factor = Math.exp(Math.min(Math.max(pixels, -400), 400) * 0.0015);
    view.camera = zoom(view.camera, factor, ...place({ x: event.clientX, y: event.clientY }));
  }, { passive: false });

  keys(view, begin);
}

/** Keys move as long as they are held. @param {RaysetView} view @param {() => void} begin */
function keys(view, begin) {
  /** @type {Map<string, string>} places on the keyboard, and what they meant when they were pressed */
  const held = new Map();
  let last = 0;

  const step = (/** @type {number} */ now) => {
    if (held.size === 0 || !view.camera) return;
    const seconds = Math.min((now - last) / 1000, 0.1);
    last = now;
    const sum = [0, 0, 0, 0, 0, 0];
    for (const key of held.values()) KEYS[key].forEach((part, k) => (sum[k] += part * seconds));
    const [across, over, nearer, ahead, sideways, upward] = sum;
    let camera = view.camera;
    if (across || over) camera = orbit(camera, across * SPEED.turn, over * SPEED.turn);
    if (nearer) camera = zoom(camera, SPEED.zoom ** nearer, 0, 0, 1);
    if (ahead || sideways || upward) {
      camera = fly(camera, ahead * SPEED.fly, sideways * SPEED.fly, upward * SPEED.fly);
    }
    view.camera = camera;
    requestAnimationFrame(step);
  };

  view.canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (key === "h" && view.home) {
      begin();
      view.camera = view.home;
    }
    if (!(key in KEYS)) return;
    event.preventDefault();
    if (held.has(event.code)) return;
    if (held.size === 0) {
      begin();
      last = performance.now();
      requestAnimationFrame(step);
    }
    held.set(event.code, key);
  });
  view.canvas.addEventListener("keyup", (event) => {
    // With a command key, some systems say no more of the others.
    if (event.key === "Meta") held.clear();
    held.delete(event.code);
  });
  view.canvas.addEventListener("blur", () => held.clear());
}

/** The standard views: names, and along which axis of the world they look. @type {[string, import("./camera.js").Vector][]} */
export const STANDARD = [
  ["+x", [-1, 0, 0]],
  ["−x", [1, 0, 0]],
  ["+y", [0, -1, 0]],
  ["−y", [0, 1, 0]],
  ["+z", [0, 0, -1]],
  ["−z", [0, 0, 1]],
];

/** @param {RaysetView} view @param {import("./camera.js").Vector} direction */
export function lookFrom(view, direction) {
  if (view.home) view.camera = lookAlong({ ...view.home }, direction);
}
