// @ts-check
/** Mouse, touch and keys on the picture, as movements of a camera. */

import { beforeAll, filledBy, framing, orbit, withRays } from "./camera.js";
import { aheadAt, approach, flyBy, shift } from "./motion.js";

/** @typedef {import("./view.js").RaysetView} RaysetView */

/** Radians for a drag across the whole height. */
const TURN = Math.PI;
/** What a key moves in a second: radians, factors, parts of the way to what is seen. */
const SPEED = { turn: 1.2, zoom: 2.5, fly: 0.8 };
/** What a pixel of a wheel, and of a pinch on a pad, comes nearer by, as a logarithm. */
const [WHEEL, PINCH] = [0.0015, 0.01];
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
  /** How far ahead is what the pointer, or the middle of two, took hold of. */
  let held = 1;

  /** A place of the picture, -1 to 1. @param {{x: number, y: number}} at @returns {[number, number, number]} and the aspect */
  const place = ({ x, y }) => {
    const box = canvas.getBoundingClientRect();
    const across = ((x - box.left) / box.width) * 2 - 1;
    return [across, 1 - ((y - box.top) / box.height) * 2, box.width / box.height];
  };

  const hold = () => {
    const all = [...down.values()];
    if (all.length === 0) return;
    const middle = { x: all.reduce((sum, { x }) => sum + x, 0) / all.length, y: all.reduce((sum, { y }) => sum + y, 0) / all.length };
    const [x, y] = place(middle);
    held = aheadAt(view, x, y);
  };

  canvas.addEventListener("pointerdown", (event) => {
    if (down.size === 0) begin();
    canvas.setPointerCapture(event.pointerId);
    down.set(event.pointerId, { x: event.clientX, y: event.clientY });
    hold();
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
      const [px, py] = place(middle);
      approach(view, apart(before) / Math.max(apart(now), 1), px, py);
      shift(view, x / 2, y / 2, aheadAt(view, px, py));
    } else if (event.buttons & 6 || event.shiftKey) {
      shift(view, x, y, held);
    } else {
      view.camera = beforeAll(orbit(view.camera, -x * TURN, -y * TURN), view.bounds);
    }
    down.set(event.pointerId, now);
  });

  for (const name of /** @type {const} */ (["pointerup", "pointercancel"])) {
    canvas.addEventListener(name, (event) => {
      down.delete(event.pointerId);
      hold();
    });
  }
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());

  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    if (!view.camera) return;
    const now = performance.now();
    if (now - wheeling > 400) begin();
    wheeling = now;
    // With Shift, browsers turn a wheel sideways. Lines and pages, where they count in those.
    const turned = event.shiftKey && !event.deltaY ? event.deltaX : event.deltaY;
    const pixels = turned * [1, 16, 400][event.deltaMode];
    // Two fingers that pinch on a pad are told as a wheel with Ctrl, in hundredths of a factor.
    const rate = event.ctrlKey ? PINCH : WHEEL;
    const factor = Math.exp(Math.min(Math.max(pixels * rate, -0.6), 0.6));
    const [x, y] = place({ x: event.clientX, y: event.clientY });
    approach(view, factor, x, y, event.shiftKey);
  }, { passive: false });

  // Safari tells of a pinch by events of its own.
  let pinched = 1;
  for (const name of ["gesturestart", "gesturechange"]) {
    canvas.addEventListener(name, (event) => {
      event.preventDefault();
      const { scale, clientX, clientY } = /** @type {any} */ (event);
      const [x, y] = place({ x: clientX, y: clientY });
      if (name === "gesturestart") begin();
      else approach(view, pinched / scale, x, y);
      pinched = scale;
    });
  }

  keys(view, begin);
}

/** Keys move as long as they are held. @param {RaysetView} view @param {() => void} begin */
function keys(view, begin) {
  /** @type {Map<string, string>} places on the keyboard, and what they meant when they were pressed */
  const held = new Map();
  let last = 0;
  /** With Shift, surfaces are no obstacle. */
  let isThrough = false;

  const step = (/** @type {number} */ now) => {
    if (held.size === 0 || !view.camera) return;
    const seconds = Math.min((now - last) / 1000, 0.1);
    last = now;
    const sum = [0, 0, 0, 0, 0, 0];
    for (const key of held.values()) KEYS[key].forEach((part, k) => (sum[k] += part * seconds));
    const [across, over, nearer, ahead, sideways, upward] = sum;
    if (across || over) view.camera = beforeAll(orbit(view.camera, across * SPEED.turn, over * SPEED.turn), view.bounds);
    if (nearer) approach(view, SPEED.zoom ** nearer, 0, 0, isThrough);
    if (ahead || sideways || upward) {
      flyBy(view, [ahead * SPEED.fly, sideways * SPEED.fly, upward * SPEED.fly], isThrough);
    }
    requestAnimationFrame(step);
  };

  view.canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (key === "h" && view.home) {
      begin();
      view.camera = view.home;
    }
    isThrough = event.shiftKey;
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
    isThrough = event.shiftKey;
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

/** Sees the whole exactly along a direction; from above with north up. @param {RaysetView} view @param {import("./camera.js").Vector} direction */
export function lookFrom(view, direction) {
  if (!view.home || !view.camera) return;
  const { height } = view.camera;
  const { height: _, ...home } = view.home;
  const aspect = view.canvas.width / view.canvas.height;
  const [camera, up] = [{ ...home, ...(height ? { height } : {}) }, view.upAlong(direction)];
  const seen = view.outline.length ? filledBy(camera, direction, up, view.outline, aspect) : framing(camera, direction, up, view.framed, aspect);
  view.camera = beforeAll({ ...seen, vertical: view.vertical }, view.bounds);
}

/** Sees the same by parallel rays, or by those of an eye. @param {RaysetView} view @param {boolean} isOrthographic */
export function setOrthographic(view, isOrthographic) {
  if (view.camera) view.camera = withRays(view.camera, isOrthographic, view.bounds);
}
