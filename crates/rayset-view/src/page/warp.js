// @ts-check
/**
 * A picture seen from a little elsewhere: its pixels, each as far away as it is, put where another camera sees them. What comes into
 * sight that the picture has not seen is filled with what is farther away of its neighbours, until the program's next picture comes.
 *
 * This runs on the processor: a picture has few pixels while it moves, and a graphics card that is none would take longer.
 */

import { cross, dot, right, subtract } from "./camera.js";

/** @typedef {import("./camera.js").Camera} Camera */
/** @typedef {import("./camera.js").Vector} Vector */
/** @typedef {import("./frames.js").Depths} Depths */

/** What is nothing is as far away as this many times the farthest that is something. */
const BEHIND = 1.5;

/** @param {Camera} camera @returns {[Vector, Vector, Vector]} right, above, ahead */
function axes(camera) {
  const across = right(camera);
  return [across, cross(across, camera.direction), camera.direction];
}

/** @param {Camera} camera */
const tangent = (camera) => Math.tan((camera.fovy * Math.PI) / 360);

export class Warp {
  /** @type {Camera | null} of the picture */
  #camera = null;
  #columns = 0;
  #rows = 0;
  #colors = new Uint32Array(0);
  /** How far each pixel's ray goes, in steps of length 1 along the camera's direction. */
  #ahead = new Float32Array(0);
  #canvas = document.createElement("canvas");
  #context = this.#canvas.getContext("2d", { willReadFrequently: true });

  /**
   * Takes a picture, as a camera has seen it.
   * @param {Camera} camera @param {Depths} depths @param {CanvasImageSource} picture @param {number} aspect
   */
  take(camera, depths, picture, aspect) {
    this.#camera = null;
    const { columns, rows, nearest, farthest, parts } = depths;
    if (!this.#context || parts.length !== columns * rows || !(farthest < Infinity)) return;
    [this.#canvas.width, this.#canvas.height] = [columns, rows];
    this.#context.drawImage(picture, 0, 0, columns, rows);
    this.#colors = new Uint32Array(this.#context.getImageData(0, 0, columns, rows).data.buffer);
    this.#ahead = new Float32Array(parts.length);
    const half = tangent(camera);
    for (let row = 0, at = 0; row < rows; row++) {
      const y = (1 - (2 * row + 1) / rows) * half;
      for (let column = 0; column < columns; column++, at++) {
        const x = ((2 * column + 1) / columns - 1) * half * aspect;
        const distance = parts[at] > 0 ? (nearest * 65535) / parts[at] : farthest * BEHIND;
        this.#ahead[at] = distance / Math.sqrt(1 + x * x + y * y);
      }
    }
    [this.#camera, this.#columns, this.#rows] = [camera, columns, rows];
  }

  /**
   * Draws the picture as another camera sees it. Returns a canvas of the picture's proportions, of few pixels; `null` if there is
   * no picture.
   * @param {Camera} camera @param {number} aspect
   */
  draw(camera, aspect) {
    const [old, columns, rows] = [this.#camera, this.#columns, this.#rows];
    if (!old || !this.#context) return null;
    const [from, to] = [axes(old), axes(camera)];
    // In double precision: places may be far from the origin.
    const offset = subtract(old.position, camera.position);
    const [mx, my, mz] = to.map((axis) => dot(axis, offset));
    const [rx, ry, rz] = to.map((axis) => from.map((each) => dot(axis, each)));
    const [half, now] = [tangent(old), tangent(camera)];
    const drawn = new Uint32Array(columns * rows);
    const depth = new Float32Array(columns * rows).fill(Infinity);
    for (let row = 0, at = 0; row < rows; row++) {
      const y = (1 - (2 * row + 1) / rows) * half;
      for (let column = 0; column < columns; column++, at++) {
        const x = ((2 * column + 1) / columns - 1) * half * aspect;
        const t = this.#ahead[at];
        const z = mz + t * (rz[0] * x + rz[1] * y + rz[2]);
        if (!(z > 0)) continue;
        const across = (mx + t * (rx[0] * x + rx[1] * y + rx[2])) / (z * now * aspect);
        const above = (my + t * (ry[0] * x + ry[1] * y + ry[2])) / (z * now);
        // A pixel covers the four whose centres are nearest: less, and a picture that comes nearer has holes.
        const left = Math.floor((across + 1) * 0.5 * columns - 0.5);
        const top = Math.floor((1 - above) * 0.5 * rows - 0.5);
        for (let j = Math.max(top, 0); j <= top + 1 && j < rows; j++) {
          for (let i = Math.max(left, 0); i <= left + 1 && i < columns; i++) {
            const place = j * columns + i;
            if (z < depth[place]) {
              depth[place] = z;
              drawn[place] = this.#colors[at];
            }
          }
        }
      }
    }
    for (let row = 0; row < rows; row++) fill(drawn, depth, row * columns, (row + 1) * columns);
    const image = new ImageData(new Uint8ClampedArray(drawn.buffer), columns, rows);
    [this.#canvas.width, this.#canvas.height] = [columns, rows];
    this.#context.putImageData(image, 0, 0);
    return this.#canvas;
  }
}

/**
 * Fills what nothing was drawn on in a row from the neighbour on either side that is farther away.
 * @param {Uint32Array} drawn @param {Float32Array} depth @param {number} start @param {number} end
 */
function fill(drawn, depth, start, end) {
  for (let at = start; at < end; at++) {
    if (depth[at] < Infinity) continue;
    let next = at;
    while (next < end && depth[next] === Infinity) next++;
    const [before, after] = [at > start ? at - 1 : -1, next < end ? next : -1];
    if (before < 0 && after < 0) return;
    const source = before < 0 || (after >= 0 && depth[after] > depth[before]) ? after : before;
    drawn.fill(drawn[source], at, next);
    at = next;
  }
}
