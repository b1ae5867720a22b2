// @ts-check
/** Frames as the program sends them, drawn onto a canvas in the order in which they came. */

const HEAD_BYTES = 16;
const WHOLE = 1;
/** Of a picture, without loss. */
export const PARTS = 2;
/** Of a picture that is saved. */
export const PIECE = 3;

/**
 * @typedef {object} Frame
 * @property {number} kind
 * @property {number} generation
 * @property {number} frame
 * @property {number} width
 * @property {number} height
 * @property {[number, number, number, number][]} rectangles
 * @property {Uint8Array<ArrayBuffer>} body
 */

/**
 * @typedef {object} Depths distances from the eye on a lattice over the picture
 * @property {number} columns
 * @property {number} rows
 * @property {number} nearest
 * @property {number} farthest
 * @property {number} [step] how far behind where a surface begins its distance may be
 * @property {Uint16Array<ArrayBuffer>} parts `nearest` by the distance, in 65535ths; 0 is nothing
 */

/** @param {ArrayBuffer} message @returns {Frame} */
export function parse(message) {
  const head = new DataView(message);
  const count = head.getUint16(2, true);
  /** @type {[number, number, number, number][]} */
  const rectangles = [];
  for (let i = 0; i < count; i++) {
    const at = HEAD_BYTES + 8 * i;
    const number = (/** @type {number} */ k) => head.getUint16(at + 2 * k, true);
    rectangles.push([number(0), number(1), number(2), number(3)]);
  }
  return {
    kind: head.getUint8(0),
    generation: head.getUint32(4, true),
    frame: head.getUint32(8, true),
    width: head.getUint16(12, true),
    height: head.getUint16(14, true),
    rectangles,
    body: new Uint8Array(message, HEAD_BYTES + 8 * count),
  };
}

/** @param {Uint8Array<ArrayBuffer>} bytes of zlib */
async function inflate(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8ClampedArray(await new Response(stream).arrayBuffer());
}

/** The distances of a whole frame, and its picture. @param {Uint8Array<ArrayBuffer>} body */
async function whole(body) {
  const head = new DataView(body.buffer, body.byteOffset);
  const length = head.getUint32(12, true);
  const parts = new Uint16Array((await inflate(body.subarray(16, 16 + length))).buffer);
  const [nearest, step] = [head.getFloat32(4, true), head.getFloat32(8, true)];
  let least = 65535;
  for (const part of parts) if (part > 0 && part < least) least = part;
  const [columns, rows] = [head.getUint16(0, true), head.getUint16(2, true)];
  const depths = { columns, rows, nearest, farthest: (nearest * 65535) / least, parts, step };
  const picture = await createImageBitmap(new Blob([body.subarray(16 + length)], { type: "image/jpeg" }));
  return { depths, picture };
}

/** Draws frames. */
export class Painter {
  /** @type {ImageData | null} the parts that have come without loss, with their exact bytes */
  #exact = null;
  #exactGeneration = -1;
  /** Frames are drawn in order, though they are decoded in their own time. */
  #last = Promise.resolve();

  /**
   * @param {HTMLCanvasElement} canvas
   * @param {(frame: Frame, depths: Depths, picture: ImageBitmap) => boolean} moving given whole frames; whether it has drawn them
   */
  constructor(canvas, moving) {
    this.canvas = canvas;
    this.moving = moving;
    const context = canvas.getContext("2d");
    if (!context) throw new Error("this browser draws nothing on a canvas");
    this.context = context;
  }

  /**
   * Gives the canvas another size; what it shows is stretched until something better comes.
   * @param {number} width @param {number} height
   */
  resize(width, height) {
    const { canvas, context } = this;
    if (canvas.width === width && canvas.height === height) return;
    const before = document.createElement("canvas");
    [before.width, before.height] = [canvas.width, canvas.height];
    before.getContext("2d")?.drawImage(canvas, 0, 0);
    [canvas.width, canvas.height] = [width, height];
    if (before.width > 0 && before.height > 0) context.drawImage(before, 0, 0, width, height);
  }

  /**
   * Draws a frame once those before it have been drawn.
   * @param {Frame} frame @param {(frame: Frame) => boolean} isWanted asked when it is this frame's turn
   * @returns {Promise<void>}
   */
  draw(frame, isWanted) {
    this.#last = this.#last.then(() => (isWanted(frame) ? this.#paint(frame, isWanted) : undefined)).catch(() => {});
    return this.#last;
  }

  /** The exact pixels of a generation: RGBA, straight alpha. @param {number} generation */
  exact(generation) {
    return this.#exactGeneration === generation ? this.#exact : null;
  }

  /** @param {Frame} frame @param {(frame: Frame) => boolean} isWanted */
  async #paint(frame, isWanted) {
    const { canvas, context } = this;
    if (frame.kind === WHOLE) {
      const { depths, picture } = await whole(frame.body);
      if (!this.moving(frame, depths, picture)) context.drawImage(picture, 0, 0, canvas.width, canvas.height);
      picture.close();
      return;
    }
    const pixels = await inflate(frame.body);
    // It may have moved on meanwhile.
    if (!isWanted(frame)) return;
    if (this.#exactGeneration !== frame.generation || !this.#exact) {
      this.#exact = new ImageData(frame.width, frame.height);
      this.#exactGeneration = frame.generation;
    }
    const exact = this.#exact;
    let at = 0;
    for (const [x, y, width, height] of frame.rectangles) {
      for (let row = y; row < y + height; row++, at += 4 * width) {
        exact.data.set(pixels.subarray(at, at + 4 * width), 4 * (row * exact.width + x));
      }
      context.putImageData(exact, 0, 0, x, y, width, height);
    }
  }
}
