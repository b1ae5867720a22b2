// @ts-check
/**
 * A picture seen from a little elsewhere: its pixels, each as far away as it is, put where another camera sees them. What comes into
 * sight that the picture has not seen has the colour of nothing, until the program's next picture comes.
 *
 * This runs on the processor: a picture has few pixels while it moves, and a graphics card that is none would take longer.
 */

import { axes, dot, halfHeight, subtract } from "./camera.js";

/** @typedef {import("./camera.js").Camera} Camera */
/** @typedef {import("./camera.js").Vector} Vector */
/** @typedef {import("./frames.js").Depths} Depths */

/** What is nothing is as far away as this many times the farthest that is something. */
const BEHIND = 1.5;
/** Neighbours whose distances differ by more than this part, and by more than a slope says, are two sides of an edge. */
const EDGE = 0.08;
/** What a slope may differ from one pixel to the next, as a factor. */
const SLOPE = 2.5;
/** Pixels beside an edge, on its far side, whose colours are blurred with those of the near side. */
const FRINGE = 2;
/** Holes of so many pixels within a surface are between its pixels: it has come nearer. */
const CRACK = 4;
/** What a page shows where nothing is known: `BEHIND` of the program, and of the style sheet. As the bytes of a pixel. */
const UNKNOWN = 0xff312a26;

export class Warp {
  /** @type {Camera | null} of the picture */
  #camera = null;
  #columns = 0;
  #rows = 0;
  #aspect = 1;
  /** How far behind where a surface begins its distance may be. */
  #step = 0;
  #colors = new Uint32Array(0);
  /** The colour where nothing is seen. */
  #backdrop = UNKNOWN;
  /** How far each pixel's ray goes along the camera's direction. */
  #ahead = new Float32Array(0);
  /** Of each pixel, 0 where nothing is; larger is nearer. */
  #parts = new Uint16Array(0);
  #canvas = document.createElement("canvas");
  #context = this.#canvas.getContext("2d", { willReadFrequently: true });

  /**
   * Takes a picture, as a camera has seen it.
   * @param {Camera} camera @param {Depths} depths @param {CanvasImageSource} picture @param {number} aspect
   */
  take(camera, depths, picture, aspect) {
    this.#camera = null;
    const { columns, rows, nearest, farthest, parts, step = 0 } = depths;
    if (!this.#context || parts.length !== columns * rows || !(farthest < Infinity)) return;
    [this.#canvas.width, this.#canvas.height] = [columns, rows];
    this.#context.drawImage(picture, 0, 0, columns, rows);
    this.#colors = new Uint32Array(this.#context.getImageData(0, 0, columns, rows).data.buffer);
    this.#backdrop = backdrop(this.#colors, parts, columns, rows);
    sharpen(this.#colors, parts, columns, rows, this.#backdrop);
    this.#parts = parts;
    this.#ahead = new Float32Array(parts.length);
    const half = halfHeight(camera, 1);
    for (let row = 0, at = 0; row < rows; row++) {
      const y = (1 - (2 * row + 1) / rows) * half;
      for (let column = 0; column < columns; column++, at++) {
        const x = ((2 * column + 1) / columns - 1) * half * aspect;
        const distance = parts[at] > 0 ? (nearest * 65535) / parts[at] : farthest * BEHIND;
        this.#ahead[at] = camera.height ? distance : distance / Math.sqrt(1 + x * x + y * y);
      }
    }
    [this.#camera, this.#columns, this.#rows, this.#aspect, this.#step] = [camera, columns, rows, aspect, step];
  }

  /** Calls a function with every pixel: its number, where another camera sees it, from -1 to 1, and how far ahead.
   * @param {Camera} camera @param {number} aspect @param {(at: number, x: number, y: number, ahead: number) => void} visit */
  #each(camera, aspect, visit) {
    const [old, columns, rows] = [this.#camera, this.#columns, this.#rows];
    if (!old) return;
    const [from, to] = [axes(old), axes(camera)];
    // In double precision: places may be far from the origin.
    const offset = subtract(old.position, camera.position);
    const [mx, my, mz] = to.map((axis) => dot(axis, offset));
    const [rx, ry, rz] = to.map((axis) => from.map((each) => dot(axis, each)));
    const [half, now] = [halfHeight(old, 1), halfHeight(camera, 1)];
    const [isParallel, seesParallel] = [Boolean(old.height), Boolean(camera.height)];
    for (let row = 0, at = 0; row < rows; row++) {
      const y = (1 - (2 * row + 1) / rows) * half;
      for (let column = 0; column < columns; column++, at++) {
        const x = ((2 * column + 1) / columns - 1) * half * this.#aspect;
        const t = this.#ahead[at];
        const spread = isParallel ? 1 : t;
        const [u, v] = [spread * x, spread * y];
        const z = mz + rz[0] * u + rz[1] * v + rz[2] * t;
        if (!(z > 0)) continue;
        const scale = seesParallel ? now : z * now;
        visit(at, (mx + rx[0] * u + rx[1] * v + rx[2] * t) / (scale * aspect), (my + ry[0] * u + ry[1] * v + ry[2] * t) / scale, z);
      }
    }
  }

  /**
   * How far ahead of a camera the nearest of what is seen within a window of its picture is, by the last picture; `null` where nothing is.
   * @param {Camera} camera @param {number} aspect
   * @param {[number, number]} middle of the window, -1 to 1 @param {number} [half] its half height; that of a pixel or a few by default
   * @returns {{ahead: number, free: number, vouched: number} | null} `free`: the part of the way on which there is surely nothing;
   *   `vouched`: the same from the camera that has seen it
   */
  nearest(camera, aspect, [x, y], half) {
    const old = this.#camera;
    if (!old) return null;
    const pixel = 2 / Math.max(this.#rows, 1);
    // A little around a place, and more if the picture has no pixel there.
    const windows = half === undefined ? [0.75 * pixel, 2 * pixel, 6 * pixel] : [half];
    const found = windows.map(() => ({ any: false, ahead: Infinity, at: -1 }));
    this.#each(camera, aspect, (at, px, py, ahead) => {
      const off = Math.max(Math.abs(px - x) * aspect, Math.abs(py - y));
      for (let k = windows.length - 1; k >= 0 && off <= windows[k]; k--) {
        found[k].any = true;
        if (this.#parts[at] > 0 && ahead < found[k].ahead) [found[k].ahead, found[k].at] = [ahead, at];
      }
    });
    const window = found.find(({ any }) => any);
    if (!window || window.at < 0) return null;
    const free = (/** @type {number} */ way) => Math.max(way - this.#step, 0);
    return { ahead: window.ahead, free: free(window.ahead), vouched: free(this.#ahead[window.at]) };
  }

  /**
   * Draws the picture as another camera sees it. Returns a canvas of the picture's proportions, of few pixels; `null` if there is
   * no picture.
   * @param {Camera} camera @param {number} aspect
   */
  draw(camera, aspect) {
    const [columns, rows] = [this.#columns, this.#rows];
    if (!this.#camera || !this.#context) return null;
    const drawn = new Uint32Array(columns * rows).fill(this.#backdrop);
    const depth = new Float32Array(columns * rows).fill(Infinity);
    this.#each(camera, aspect, (at, x, y, z) => {
      // A pixel covers the four whose centres are nearest: less, and a picture that comes nearer has holes.
      const left = Math.floor((x + 1) * 0.5 * columns - 0.5);
      const top = Math.floor((1 - y) * 0.5 * rows - 0.5);
      for (let j = Math.max(top, 0); j <= top + 1 && j < rows; j++) {
        for (let i = Math.max(left, 0); i <= left + 1 && i < columns; i++) {
          const place = j * columns + i;
          if (z < depth[place]) {
            depth[place] = z;
            drawn[place] = this.#colors[at];
          }
        }
      }
    });
    for (let row = 0; row < rows; row++) fill(drawn, depth, row * columns, 1, columns);
    for (let column = 0; column < columns; column++) fill(drawn, depth, column, columns, rows);
    const image = new ImageData(new Uint8ClampedArray(drawn.buffer), columns, rows);
    [this.#canvas.width, this.#canvas.height] = [columns, rows];
    this.#context.putImageData(image, 0, 0);
    return this.#canvas;
  }
}

/** The colour that most of nothing has. @param {Uint32Array} colors @param {Uint16Array} parts @param {number} columns @param {number} rows */
function backdrop(colors, parts, columns, rows) {
  /** @type {Map<number, [number, number]>} of similar colours: how many, and one of them */
  const counts = new Map();
  let [most, color] = [0, UNKNOWN];
  for (let at = 0; at < columns * rows; at++) {
    if (parts[at] > 0) continue;
    const similar = colors[at] & 0xf0f0f0;
    const known = counts.get(similar) ?? [0, colors[at]];
    known[0]++;
    counts.set(similar, known);
    if (known[0] > most) [most, color] = known;
  }
  return color;
}

/**
 * Gives pixels on the far side of an edge colours from farther away from it: their own are blurred with those of the near side.
 * @param {Uint32Array} colors @param {Uint16Array} parts @param {number} columns @param {number} rows @param {number} nothing
 */
function sharpen(colors, parts, columns, rows, nothing) {
  const before = colors.slice();
  /** Whether there is an edge between a pixel and the next along a line. @param {number} at @param {number} step @param {boolean} first @param {boolean} last */
  const isEdge = (at, step, first, last) => {
    const [a, b] = [parts[at], parts[at + step]];
    const jump = Math.abs(a - b);
    if (jump <= EDGE * Math.max(a, b)) return false;
    if (a === 0 || b === 0) return true;
    // Along a slope, parts change evenly.
    const beside = Math.max(first ? 0 : Math.abs(parts[at - step] - a), last ? 0 : Math.abs(parts[at + 2 * step] - b));
    return jump > SLOPE * beside || beside > jump;
  };
  /** @param {number} start @param {number} step @param {number} count */
  const line = (start, step, count) => {
    for (let i = 0; i + 1 < count; i++) {
      const at = start + i * step;
      if (!isEdge(at, step, i === 0, i + 2 >= count)) continue;
      const isAhead = parts[at] > parts[at + step];
      // From the edge towards the far side, as far as that goes on.
      const [sign, first] = isAhead ? [1, i + 1] : [-1, i];
      const far = parts[start + first * step];
      let source = first;
      for (let k = 1; k <= FRINGE; k++) {
        const next = first + sign * k;
        if (next < 0 || next >= count) break;
        const part = parts[start + next * step];
        if (Math.abs(part - far) > EDGE * Math.max(part, far) * k) break;
        source = next;
      }
      const isWide = source === first + sign * FRINGE;
      for (let k = 0; k < FRINGE; k++) {
        const next = first + sign * k;
        if (next < 0 || next >= count) break;
        const place = start + next * step;
        if (parts[place] > 0 !== far > 0) break;
        // Between two edges all are blurred: of nothing, the colour is known.
        if (isWide) colors[place] = before[start + source * step];
        else if (far === 0) colors[place] = nothing;
      }
    }
  };
  for (let row = 0; row < rows; row++) line(row * columns, 1, columns);
  for (let column = 0; column < columns; column++) line(column, columns, rows);
}

/**
 * Fills cracks of a line within a surface; wider holes show what nobody has seen, and stay.
 * @param {Uint32Array} drawn @param {Float32Array} depth @param {number} start @param {number} step @param {number} count
 */
function fill(drawn, depth, start, step, count) {
  for (let i = 0; i < count; i++) {
    if (depth[start + i * step] < Infinity) continue;
    let next = i;
    while (next < count && depth[start + next * step] === Infinity) next++;
    const [before, after] = [start + (i - 1) * step, start + next * step];
    const isCrack = i > 0 && next < count && next - i <= CRACK &&
      Math.abs(depth[before] - depth[after]) <= EDGE * Math.max(depth[before], depth[after]);
    const source = depth[after] > depth[before] ? after : before;
    for (let k = i; isCrack && k < next; k++) {
      const place = start + k * step;
      [drawn[place], depth[place]] = [drawn[source], depth[source]];
    }
    i = next;
  }
}
