// @ts-check
/**
 * Cameras, and how they move. A camera is never changed: every movement makes a new one.
 *
 * @typedef {[number, number, number]} Vector
 * @typedef {object} Camera
 * @property {Vector} position world space
 * @property {Vector} direction length 1
 * @property {Vector} up length 1; what stays upright
 * @property {number} fovy vertical angle in degrees
 * @property {number} distance from the position to what it turns about, along the direction
 */

/** The nearest to straight up or down that a camera looks, as a cosine. */
const STEEPEST = 0.999;

/** @param {Vector} a @param {Vector} b @returns {Vector} */
export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
/** @param {Vector} a @param {Vector} b @returns {Vector} */
export const subtract = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
/** @param {Vector} a @param {number} factor @returns {Vector} */
export const scale = (a, factor) => [a[0] * factor, a[1] * factor, a[2] * factor];
/** @param {Vector} a @param {Vector} b */
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
/** @param {Vector} a @param {Vector} b @returns {Vector} */
export const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];
/** @param {Vector} a @returns {Vector} */
export const unit = (a) => {
  const length = Math.hypot(...a);
  return length > 0 ? scale(a, 1 / length) : [0, 0, -1];
};

/**
 * Turns a vector about an axis (Rodrigues).
 * @param {Vector} v @param {Vector} axis length 1 @param {number} angle radians @returns {Vector}
 */
export function turned(v, axis, angle) {
  const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
  const along = scale(axis, dot(axis, v) * (1 - cos));
  return add(add(scale(v, cos), scale(cross(axis, v), sin)), along);
}

/**
 * The camera of a scene, turning about the middle of what it shows.
 * @param {{position: Vector, direction: Vector, up: Vector, fovy: number}} pose
 * @param {[Vector, Vector]} bounds @returns {Camera}
 */
export function cameraOf(pose, bounds) {
  const direction = unit(pose.direction);
  const middle = scale(add(bounds[0], bounds[1]), 0.5);
  const size = Math.hypot(...subtract(bounds[1], bounds[0]));
  const ahead = dot(subtract(middle, pose.position), direction);
  const distance = ahead > 0 && Number.isFinite(ahead) ? ahead : size || 1;
  return { position: pose.position, direction, up: upright(direction, unit(pose.up)), fovy: pose.fovy, distance };
}

/**
 * What stays upright when a camera turns: the axis of the world that its `up` leans from, if there is one.
 * @param {Vector} direction @param {Vector} up @returns {Vector}
 */
function upright(direction, up) {
  /** @param {Vector} v across the direction */
  const across = (v) => unit(subtract(v, scale(direction, dot(direction, v))));
  for (const axis of [0, 1, 2]) {
    for (const sign of [1, -1]) {
      /** @type {Vector} */
      const candidate = [0, 0, 0];
      candidate[axis] = sign;
      if (Math.abs(dot(candidate, direction)) < STEEPEST && dot(across(candidate), across(up)) > 1 - 1e-6) {
        return candidate;
      }
    }
  }
  return up;
}

/** @param {Camera} camera @returns {Vector} */
export const right = (camera) => unit(cross(camera.direction, camera.up));

/** What a camera turns about. @param {Camera} camera @returns {Vector} */
export const pivot = (camera) => add(camera.position, scale(camera.direction, camera.distance));

/**
 * Turns about the pivot.
 * @param {Camera} camera @param {number} across radians @param {number} over radians @returns {Camera}
 */
export function orbit(camera, across, over) {
  const center = pivot(camera);
  let direction = turned(camera.direction, camera.up, across);
  const tilted = turned(direction, unit(cross(direction, camera.up)), over);
  if (Math.abs(dot(tilted, camera.up)) < STEEPEST) direction = tilted;
  direction = unit(direction);
  return { ...camera, direction, position: subtract(center, scale(direction, camera.distance)) };
}

/**
 * The direction through a place of the picture.
 * @param {Camera} camera @param {number} x from -1, left, to 1 @param {number} y from -1, below, to 1
 * @param {number} aspect width over height @returns {Vector} of length 1 along the camera's direction
 */
export function ray(camera, x, y, aspect) {
  const half = Math.tan((camera.fovy * Math.PI) / 360);
  const across = right(camera);
  const above = cross(across, camera.direction);
  return add(camera.direction, add(scale(across, x * half * aspect), scale(above, y * half)));
}

/**
 * Comes nearer to what is seen at a place of the picture (`factor` below 1), which stays there.
 * @param {Camera} camera @param {number} factor @param {number} x @param {number} y @param {number} aspect
 * @returns {Camera}
 */
export function zoom(camera, factor, x, y, aspect) {
  const target = add(camera.position, scale(ray(camera, x, y, aspect), camera.distance));
  const position = add(target, scale(subtract(camera.position, target), factor));
  return { ...camera, position, distance: camera.distance * factor };
}

/**
 * Moves along with what is at the pivot's distance, by a part of the picture's height.
 * @param {Camera} camera @param {number} x @param {number} y @returns {Camera}
 */
export function pan(camera, x, y) {
  const height = 2 * Math.tan((camera.fovy * Math.PI) / 360) * camera.distance;
  const across = right(camera);
  const above = cross(across, camera.direction);
  const by = add(scale(across, -x * height), scale(above, y * height));
  return { ...camera, position: add(camera.position, by) };
}

/**
 * Flies, in parts of the distance to the pivot.
 * @param {Camera} camera @param {number} ahead @param {number} sideways @param {number} upward @returns {Camera}
 */
export function fly(camera, ahead, sideways, upward) {
  const by = add(scale(camera.direction, ahead), add(scale(right(camera), sideways), scale(camera.up, upward)));
  return { ...camera, position: add(camera.position, scale(by, camera.distance)) };
}

/**
 * Looks at the pivot from a direction, from as far away as before.
 * @param {Camera} camera @param {Vector} direction @returns {Camera}
 */
export function lookAlong(camera, direction) {
  let along = unit(direction);
  // Straight down, something has to be above: a little of where the camera looked before.
  if (Math.abs(dot(along, camera.up)) >= STEEPEST) along = unit(add(along, scale(camera.direction, 0.02)));
  return { ...camera, direction: along, position: subtract(pivot(camera), scale(along, camera.distance)) };
}

/**
 * Where a place of the scene is in the picture: from -1, left and below, to 1; `null` behind the eye.
 * @param {Camera} camera @param {Vector} point @param {number} aspect width over height @returns {[number, number] | null}
 */
export function project(camera, point, aspect) {
  const from = subtract(point, camera.position);
  const ahead = dot(from, camera.direction);
  if (!(ahead > 0)) return null;
  const half = Math.tan((camera.fovy * Math.PI) / 360) * ahead;
  const across = right(camera);
  return [dot(from, across) / (half * aspect), dot(from, cross(across, camera.direction)) / half];
}

/**
 * Turns towards a place, which it turns about from then on, and comes nearer to it.
 * @param {Camera} camera @param {Vector} point @param {number} factor of the distance to it @returns {Camera}
 */
export function focus(camera, point, factor) {
  const from = subtract(point, camera.position);
  const far = Math.hypot(...from);
  if (!(far > 0)) return camera;
  let direction = unit(from);
  if (Math.abs(dot(direction, camera.up)) >= STEEPEST) direction = camera.direction;
  const distance = far * factor;
  return { ...camera, direction, distance, position: subtract(point, scale(direction, distance)) };
}
