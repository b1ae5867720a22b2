// @ts-check
/**
 * Movements of a camera among what is seen. Distances are those of the last picture, so that nobody flies through a surface: a movement
 * ahead leaves a part of the way that the picture vouches for, and the next picture vouches for more.
 */

import { add, beforeAll, dot, fly, halfHeight, pan, placeAt, scale, subtract, zoom } from "./camera.js";

/** @typedef {import("./view.js").RaysetView} RaysetView */
/** @typedef {import("./camera.js").Camera} Camera */
/** @typedef {import("./camera.js").Vector} Vector */

/** The part of the way to a surface that is left until another picture has seen it. */
const UNVOUCHED = 0.25;
/** The nearest that an eye comes to a surface, and the least height of an orthographic picture, as parts of the scene's size. */
const NEAREST = 1e-4;
/** The farthest that an eye goes from the scene's middle, as a multiple of its size, or of where it was first. */
const FARTHEST = 8;
/** A step through what is in the way, as a part of the scene's size. */
const THROUGH = 0.02;
/** Half the height of the window in whose middle one flies, as a part of half the picture's. */
const CORRIDOR = 0.2;

/** @param {RaysetView} view */
const sizeOf = (view) => {
  const size = Math.hypot(...subtract(view.framed[1], view.framed[0]));
  return Number.isFinite(size) && size > 0 ? size : 1;
};

/** @param {RaysetView} view */
const aspectOf = (view) => view.canvas.width / view.canvas.height;

/** How far ahead something is seen at a place of the picture; as far as the pivot if nothing is. @param {RaysetView} view @param {number} x @param {number} y */
export function aheadAt(view, x, y) {
  const { camera } = view;
  if (!camera) return 1;
  return view.nearest([x, y])?.ahead ?? camera.distance;
}

/**
 * Comes nearer to what is seen at a place, or goes away from it. What is there stays there.
 * @param {RaysetView} view @param {number} factor of the distance @param {number} x @param {number} y from -1 to 1
 * @param {boolean} [isThrough] whether surfaces may be passed
 */
export function approach(view, factor, x, y, isThrough = false) {
  const { camera } = view;
  if (!camera || !(factor > 0)) return;
  const [aspect, size] = [aspectOf(view), sizeOf(view)];
  const seen = view.nearest([x, y]);
  if (camera.height) {
    const least = Math.max(factor, (NEAREST * size) / camera.height);
    const most = (2 * FARTHEST * size) / camera.height;
    view.camera = beforeAll(zoom(camera, Math.min(factor < 1 ? Math.min(least, 1) : factor, Math.max(most, 1)), x, y, aspect), view.bounds);
    return;
  }
  const ahead = seen?.ahead ?? camera.distance;
  if (isThrough && factor < 1) {
    const step = (1 - factor) * Math.max(ahead, THROUGH * 5 * size);
    const along = subtract(placeAt(camera, x, y, aspect, 1), camera.position);
    view.camera = { ...camera, position: add(camera.position, scale(along, step)) };
    return;
  }
  if (factor >= 1) {
    view.camera = within(view, zoom(camera, factor, x, y, aspect, ahead), size);
    return;
  }
  // What is not seen is not come through either; but then nobody vouches for more than the way to the pivot.
  const left = Math.max(NEAREST * size, UNVOUCHED * (seen?.vouched ?? 0));
  const free = Math.max((seen?.free ?? ahead) - left, 0);
  const least = Math.max(1 - free / ahead, 0);
  view.camera = zoom(camera, Math.max(factor, least), x, y, aspect, ahead);
}

/** A camera that has gone away, no farther than whence the scene is still seen. @param {RaysetView} view @param {Camera} camera @param {number} size */
function within(view, camera, size) {
  const before = view.camera;
  if (!before) return camera;
  const middle = scale(add(view.framed[0], view.framed[1]), 0.5);
  const far = (/** @type {Camera} */ each) => Math.hypot(...subtract(each.position, middle));
  const most = Math.max(FARTHEST * size, view.home ? 2 * far(view.home) : 0);
  if (far(camera) <= most || far(camera) <= far(before)) return camera;
  return far(before) >= most ? before : stopped(before, camera, middle, most);
}

/** Where a way from one camera to another leaves a ball. @param {Camera} from @param {Camera} to @param {Vector} middle @param {number} radius @returns {Camera} */
function stopped(from, to, middle, radius) {
  const [way, out] = [subtract(to.position, from.position), subtract(from.position, middle)];
  const [a, b, c] = [dot(way, way), dot(way, out), dot(out, out) - radius * radius];
  const t = Math.min(Math.max((-b + Math.sqrt(Math.max(b * b - a * c, 0))) / (a || 1), 0), 1);
  return { ...to, position: add(from.position, scale(way, t)), distance: from.distance + t * (to.distance - from.distance) };
}

/** Moves what is so far ahead by a part of the picture's height. @param {RaysetView} view @param {number} x @param {number} y @param {number} ahead */
export function shift(view, x, y, ahead) {
  if (view.camera) view.camera = beforeAll(pan(view.camera, x, y, ahead), view.bounds);
}

/**
 * Flies for a moment: ahead by parts of the way to what is in the middle, aside by parts of the way to the nearest that is seen.
 * @param {RaysetView} view @param {[number, number, number]} by parts: ahead, sideways, upward @param {boolean} isThrough
 */
export function flyBy(view, [ahead, sideways, upward], isThrough) {
  const { camera } = view;
  if (!camera) return;
  const size = sizeOf(view);
  if (camera.height) {
    const unit = 2 * halfHeight(camera, 1);
    view.camera = beforeAll(fly(camera, 0, sideways * unit, upward * unit), view.bounds);
    if (ahead) approach(view, Math.exp(-ahead), 0, 0);
    return;
  }
  const nearest = view.nearest([0, 0], Math.max(aspectOf(view), 1))?.free ?? camera.distance;
  const unit = Math.max(Math.min(nearest, size), NEAREST * size);
  let way = 0;
  if (ahead < 0) way = ahead * Math.max(unit, 0.1 * camera.distance);
  if (ahead > 0) {
    const seen = view.nearest([0, 0], CORRIDOR);
    const free = Math.min(seen?.free ?? Math.max(camera.distance, THROUGH * size), size);
    const left = Math.max(NEAREST * size, UNVOUCHED * (seen?.vouched ?? 0));
    const step = free * (1 - Math.exp(-ahead));
    way = isThrough ? Math.max(step, ahead * THROUGH * size) : Math.max(Math.min(step, free - left), 0);
  }
  const moved = fly(camera, way, sideways * unit, upward * unit);
  // It turns about what lies ahead, not about what it has flown by.
  const distance = way > 0 ? Math.max(camera.distance - way, Math.min(camera.distance, nearest)) : camera.distance;
  view.camera = within(view, { ...moved, distance }, size);
}
