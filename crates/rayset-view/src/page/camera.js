// @ts-check
/**
 * Cameras, and how they move. A camera is never changed: every movement makes a new one.
 *
 * @typedef {[number, number, number]} Vector
 * @typedef {object} Camera
 * @property {Vector} position world space
 * @property {Vector} direction length 1
 * @property {Vector} up what is up in the picture; length 1
 * @property {number} fovy vertical angle in degrees
 * @property {number} distance from the position to what it turns about, along the direction
 * @property {Vector} [vertical] what stays upright when it turns, length 1; `up` if it is missing
 * @property {number} [height] of an orthographic picture, in units of the scene; missing of one with an angle
 */

/** Straight up and down, as a cosine: beyond, what is upright is a point of the picture. */
const STEEPEST = 0.9999;
/** The part of the picture's shorter side that a framed box fills. */
const FILLED = 0.9;
/** Steps until a camera that is filled by places stands still. */
const ROUNDS = 24;

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
 * @param {{position: Vector, direction: Vector, up: Vector, fovy: number, height?: number}} pose
 * @param {[Vector, Vector]} bounds @param {Vector} [vertical] @returns {Camera}
 */
export function cameraOf(pose, bounds, vertical) {
  const direction = unit(pose.direction);
  const middle = scale(add(bounds[0], bounds[1]), 0.5);
  const size = Math.hypot(...subtract(bounds[1], bounds[0]));
  const ahead = dot(subtract(middle, pose.position), direction);
  const distance = ahead > 0 && Number.isFinite(ahead) ? ahead : size || 1;
  const { position, fovy, height } = pose;
  const upright = vertical ?? uprightOf(direction, unit(pose.up));
  return { position, direction, up: upInPicture(direction, pose.up, upright), fovy, distance, vertical: upright, ...(height ? { height } : {}) };
}

/**
 * The axis of the world that a camera's `up` leans from, if there is one.
 * @param {Vector} direction @param {Vector} up @returns {Vector}
 */
function uprightOf(direction, up) {
  for (const axis of [0, 1, 2]) {
    for (const sign of [1, -1]) {
      /** @type {Vector} */
      const candidate = [0, 0, 0];
      candidate[axis] = sign;
      if (isUpright(direction, up, candidate)) return candidate;
    }
  }
  return up;
}

/** A vector's part across a direction, of length 1. @param {Vector} direction @param {Vector} v */
const across = (direction, v) => unit(subtract(v, scale(direction, dot(direction, v))));

/** Whether a vertical is up in a picture. @param {Vector} direction @param {Vector} up @param {Vector} vertical */
const isUpright = (direction, up, vertical) =>
  Math.abs(dot(vertical, direction)) < STEEPEST && dot(across(direction, vertical), across(direction, up)) > 1 - 1e-6;

/**
 * What is up in a picture: the vertical itself where that says it, because its numbers are round.
 * @param {Vector} direction @param {Vector} up @param {Vector} vertical @returns {Vector}
 */
const upInPicture = (direction, up, vertical) => (isUpright(direction, up, vertical) ? vertical : unit(up));

/** @param {Camera} camera @returns {Vector} */
export const right = (camera) => unit(cross(camera.direction, camera.up));

/** Right, above and ahead in the picture, each of length 1. @param {Camera} camera @returns {[Vector, Vector, Vector]} */
export function axes(camera) {
  const sideways = right(camera);
  return [sideways, cross(sideways, camera.direction), camera.direction];
}

/** Half the height of what is seen so far ahead. @param {Camera} camera @param {number} ahead */
export const halfHeight = (camera, ahead) => (camera.height ? camera.height / 2 : Math.tan((camera.fovy * Math.PI) / 360) * ahead);

/** What a camera turns about. @param {Camera} camera @returns {Vector} */
export const pivot = (camera) => add(camera.position, scale(camera.direction, camera.distance));

/**
 * Turns about the pivot, up to straight above or below.
 * @param {Camera} camera @param {number} sideways radians @param {number} over radians @returns {Camera}
 */
export function orbit(camera, sideways, over) {
  const vertical = camera.vertical ?? camera.up;
  const axis = turned(right(camera), vertical, sideways);
  const level = turned(camera.direction, vertical, sideways);
  // How far the direction is above the horizon; over the top the picture would be upside down.
  const height = Math.asin(Math.min(Math.max(dot(level, vertical), -1), 1));
  // What looks up from upside down, as a scene may, goes on as it is.
  const sense = dot(cross(axis, level), vertical) < -1e-9 ? -1 : 1;
  const least = Math.max(-Math.PI / 2 - height * sense, Math.min(over, Math.PI / 2 - height * sense));
  const direction = unit(turned(level, axis, least));
  const up = upInPicture(direction, cross(axis, direction), vertical);
  return { ...camera, direction, up, position: subtract(pivot(camera), scale(direction, camera.distance)) };
}

/**
 * A place so far ahead of the camera, seen at a place of the picture.
 * @param {Camera} camera @param {number} x from -1, left, to 1 @param {number} y from -1, below, to 1
 * @param {number} aspect width over height @param {number} ahead along the camera's direction @returns {Vector}
 */
export function placeAt(camera, x, y, aspect, ahead) {
  const [sideways, above] = axes(camera);
  const half = halfHeight(camera, ahead);
  return add(add(camera.position, scale(camera.direction, ahead)), add(scale(sideways, x * half * aspect), scale(above, y * half)));
}

/**
 * Comes nearer to what is seen at a place of the picture (`factor` below 1), which stays there.
 * @param {Camera} camera @param {number} factor @param {number} x @param {number} y @param {number} aspect
 * @param {number} [ahead] how far ahead that is; as far as the pivot by default @returns {Camera}
 */
export function zoom(camera, factor, x, y, aspect, ahead = camera.distance) {
  const target = placeAt(camera, x, y, aspect, ahead);
  if (camera.height) {
    const off = subtract(target, placeAt(camera, 0, 0, aspect, ahead));
    return { ...camera, height: camera.height * factor, position: add(camera.position, scale(off, 1 - factor)) };
  }
  const position = add(target, scale(subtract(camera.position, target), factor));
  // It turns about what it comes nearer to; going away, about what it turned about before.
  const distance = factor < 1 ? ahead * factor : camera.distance + ahead * (factor - 1);
  return { ...camera, position, distance };
}

/**
 * Moves along with what is so far ahead, by a part of the picture's height.
 * @param {Camera} camera @param {number} x @param {number} y @param {number} [ahead] as far as the pivot by default @returns {Camera}
 */
export function pan(camera, x, y, ahead = camera.distance) {
  const height = 2 * halfHeight(camera, ahead);
  const [sideways, above] = axes(camera);
  const by = add(scale(sideways, -x * height), scale(above, y * height));
  return { ...camera, position: add(camera.position, by) };
}

/**
 * Moves by lengths along the picture's axes, the last along what stays upright.
 * @param {Camera} camera @param {number} ahead @param {number} sideways @param {number} upward @returns {Camera}
 */
export function fly(camera, ahead, sideways, upward) {
  const vertical = camera.vertical ?? camera.up;
  const by = add(scale(camera.direction, ahead), add(scale(right(camera), sideways), scale(vertical, upward)));
  return { ...camera, position: add(camera.position, by) };
}

/**
 * A camera that sees a box whole, exactly along a direction.
 * @param {Camera} camera whose angle and kind it has
 * @param {Vector} direction @param {Vector} up at a right angle to it, both of length 1
 * @param {[Vector, Vector]} box @param {number} aspect width over height @returns {Camera}
 */
export function framing(camera, direction, up, box, aspect) {
  const middle = scale(add(box[0], box[1]), 0.5);
  const half = scale(subtract(box[1], box[0]), 0.5);
  const sideways = cross(direction, up);
  const extent = (/** @type {Vector} */ axis) => axis.reduce((sum, part, k) => sum + Math.abs(part) * half[k], 0);
  const shown = Math.max(extent(up), extent(sideways) / aspect) || 1;
  const at = (/** @type {number} */ distance) => subtract(middle, scale(direction, distance));
  if (camera.height) {
    const distance = extent(direction) + 2 * shown;
    return { ...camera, direction, up, distance, position: at(distance), height: (2 * shown) / FILLED };
  }
  const tangent = Math.tan((camera.fovy * Math.PI) / 360) * FILLED;
  let distance = 0;
  for (let corner = 0; corner < 8; corner++) {
    const from = /** @type {Vector} */ (half.map((part, k) => ((corner >> k) & 1 ? part : -part)));
    const spread = Math.max(Math.abs(dot(from, up)), Math.abs(dot(from, sideways)) / aspect);
    distance = Math.max(distance, spread / tangent - dot(from, direction));
  }
  return { ...camera, direction, up, distance: distance || 1, position: at(distance || 1) };
}

/**
 * A camera that looks exactly along a direction, and whose picture some places fill.
 * @param {Camera} camera whose angle and kind it has
 * @param {Vector} direction @param {Vector} up at a right angle to it, both of length 1
 * @param {Vector[]} places @param {number} aspect width over height @returns {Camera}
 */
export function filledBy(camera, direction, up, places, aspect) {
  const sideways = cross(direction, up);
  const spread = (/** @type {number[]} */ values) => {
    const [low, high] = [Math.min(...values), Math.max(...values)];
    return { middle: (low + high) / 2, half: (high - low) / 2 };
  };
  const [across, upward, along] = [sideways, up, direction].map((axis) => spread(places.map((place) => dot(place, axis))));
  const center = add(add(scale(sideways, across.middle), scale(up, upward.middle)), scale(direction, along.middle));
  const half = Math.max(upward.half, across.half / aspect) || 1;
  const at = (/** @type {Vector} */ position) => ({ ...camera, direction, up, position, distance: dot(subtract(center, position), direction) });
  if (camera.height) return { ...at(subtract(center, scale(direction, along.half + 2 * half))), height: (2 * half) / FILLED };
  const tangent = Math.tan((camera.fovy * Math.PI) / 360);
  let position = subtract(center, scale(direction, along.half + half / tangent));
  for (let round = 0; round < ROUNDS; round++) {
    // Seen from nearby, what is in front is larger: the camera moves until what it sees is in the middle and fills the picture.
    const seen = (/** @type {Vector} */ axis) => spread(places.map((place) => {
      const from = subtract(place, position);
      return dot(from, axis) / Math.max(dot(from, direction), 0.01 * half);
    }));
    const [x, y] = [seen(sideways), seen(up)];
    const filled = Math.max(y.half / tangent, x.half / (tangent * aspect)) / FILLED;
    const distance = Math.max(dot(subtract(center, position), direction), 1e-6 * half);
    position = add(position, scale(add(scale(sideways, x.middle), scale(up, y.middle)), distance));
    // A part of the way, so that it does not swing.
    position = subtract(position, scale(direction, distance * (Math.min(Math.max(filled, 0.5), 2) - 1) * 0.7));
  }
  return at(position);
}

/**
 * The same view by parallel rays, or by those of an eye: what is at the pivot stays as large. The rays of an orthographic camera start
 * before everything.
 * @param {Camera} camera @param {boolean} isOrthographic @param {[Vector, Vector]} bounds @returns {Camera}
 */
export function withRays(camera, isOrthographic, bounds) {
  if (isOrthographic === Boolean(camera.height)) return camera;
  if (isOrthographic) return beforeAll({ ...camera, height: 2 * halfHeight(camera, camera.distance) }, bounds);
  const { height = 1, ...rest } = camera;
  const distance = height / 2 / Math.tan((camera.fovy * Math.PI) / 360);
  return { ...rest, distance, position: subtract(pivot(camera), scale(camera.direction, distance)) };
}

/**
 * An orthographic camera moved back or ahead along its rays, which changes nothing of what they meet, until it is before everything; any
 * other as it is.
 * @param {Camera} camera @param {[Vector, Vector]} bounds @returns {Camera}
 */
export function beforeAll(camera, bounds) {
  if (!camera.height) return camera;
  const half = scale(subtract(bounds[1], bounds[0]), 0.5);
  const middle = scale(add(bounds[0], bounds[1]), 0.5);
  const extent = camera.direction.reduce((sum, part, k) => sum + Math.abs(part) * half[k], 0);
  const center = pivot(camera);
  const distance = dot(subtract(center, middle), camera.direction) + 1.25 * extent + 0.25 * camera.height;
  if (!Number.isFinite(distance) || (camera.distance >= distance && camera.distance < 4 * distance)) return camera;
  // Not less than a little, for a pivot before everything.
  const back = Math.max(distance, 1e-3 * camera.height);
  return { ...camera, distance: back, position: subtract(center, scale(camera.direction, back)) };
}

/**
 * Where a place of the scene is in the picture: from -1, left and below, to 1; `null` behind the eye.
 * @param {Camera} camera @param {Vector} point @param {number} aspect width over height @returns {[number, number] | null}
 */
export function project(camera, point, aspect) {
  const from = subtract(point, camera.position);
  const ahead = dot(from, camera.direction);
  if (!(ahead > 0)) return null;
  const half = halfHeight(camera, ahead);
  const [sideways, above] = axes(camera);
  return [dot(from, sideways) / (half * aspect), dot(from, above) / half];
}

/**
 * Turns towards a place, which it turns about from then on, and comes nearer to it.
 * @param {Camera} camera @param {Vector} point @param {number} factor of the distance to it @returns {Camera}
 */
export function focus(camera, point, factor) {
  if (camera.height) {
    const off = dot(subtract(point, camera.position), camera.direction);
    return { ...camera, height: camera.height * factor, position: subtract(point, scale(camera.direction, off)), distance: off };
  }
  const from = subtract(point, camera.position);
  const far = Math.hypot(...from);
  if (!(far > 0)) return camera;
  const vertical = camera.vertical ?? camera.up;
  let direction = unit(from);
  if (Math.abs(dot(direction, vertical)) >= STEEPEST) direction = camera.direction;
  const distance = far * factor;
  const up = direction === camera.direction ? camera.up : vertical;
  return { ...camera, direction, up, distance, position: subtract(point, scale(direction, distance)) };
}
