// @ts-check
/**
 * The view itself, for any page: a canvas that shows a scene which `rayset view` serves.
 *
 *     const view = new RaysetView(canvas, { socket: "socket" });
 *     view.addEventListener("hello", () => { view.camera = orbit(view.camera, 0.5, 0); });
 *
 * Events: `opening` (`detail.what`, `detail.part`: there is nothing to see yet), `hello` (a scene has been opened; `view.scene`,
 * `view.bounds`, `view.choices` and `view.camera` are known), `change` (the camera or the changes are others), `legend` (`view.legend`
 * is another), `frame` (`detail.width`, `detail.height`, `detail.milliseconds` since it was asked for), `reprojected` (the last picture was drawn as the camera sees it now), `converged` (`detail.seconds`: the picture
 * is complete), `problem` (`detail.what`), `connection` (`detail.open`, and `detail.what`, why not, if the program said so).
 */

import { axes, cameraOf, cross, dot, filledBy, project, scale, subtract, unit, zoom } from "./camera.js";
import { Painter, parse, PARTS, PIECE } from "./frames.js";
import { Warp } from "./warp.js";

/**
 * @typedef {import("./camera.js").Camera} Camera
 * @typedef {import("./camera.js").Vector} Vector
 * @typedef {{direction: Vector, intensity: number, shadow: boolean}} Sun
 * @typedef {{min: Vector, max: Vector}} Section
 * @typedef {{form: "box" | "ellipsoid" | "cylinder", center: Vector, size: Vector, turns?: {axis: Vector, degrees: number}[], keep?: boolean}} Cutter
 *   takes away what is inside of it, or all else
 * @typedef {{look?: string, color?: string, colorBy?: string, colormap?: string, valueRange?: [number, number] | string, log?: boolean, radiusScale?: number, opacity?: [number, number][] | string, [other: string]: unknown}} Style
 *   options of `rayset render`; a text is a range in percent, or an opacity that is no curve
 * @typedef {{exposure?: number, sun?: Sun, section?: Section, cutters?: Cutter[], cap?: string, style?: Style}} Changes
 *   what is other than in the scene that was opened; `cap`: the colour that fills cuts
 * @typedef {{low: number, high: number, logarithmic: boolean, counts: number[]}} Histogram
 * @typedef {{name: string, unit: string, range: [number, number], histogram: Histogram | null}} Attribute
 * @typedef {{looks: string[], attributes: Attribute[], palettes: [string, string[]][], style: Style}} Choices
 * @typedef {{look: string, line: string, isLit: boolean, exposure: number, transferFunction: any, classes: [number, string][], densities: Histogram | null, remarks: string[]}} Legend
 * @typedef {{question: number, position: Vector | null, point: {position: Vector, stored: Vector, error: number, step: Vector | null, values: [string, number, string][]} | null, value: number | null, error: number, step: number | null}} Picked
 *   `value` of a grid; `error`: how exactly places are known; `step` of the coordinates of the file that they come from
 * @typedef {{name: string, bytes: number, hits: number, misses: number, reads: number, bytesRead: number, bytesUnique: number, evictions: number, waitedSeconds: number}} KindReport
 * @typedef {{budget: number, kinds: KindReport[], regions: [Vector, Vector][] | null, resident: number[]}} Report
 * @typedef {{up: Vector, facing: Vector, framed: [Vector, Vector], outline: Vector[], isFramed: boolean}} Stance what is up, in which direction one looks at the front,
 *   what fills a picture of the whole, its outermost places, and whether the first camera frames it
 */

/** A picture moves as long as changes follow each other faster than this, in milliseconds. */
const REST = 120;
/** A picture that was asked for less than so many milliseconds ago is drawn as it is. */
const RECENT = 80;
/** Milliseconds between two drawings of the last picture: the program needs the processor, too. */
const BETWEEN_WARPS = 25;
/** Width and height of the picture that a camera was made for, if a scene does not say. */
const CHOSEN_SIZE = [16, 9];
/** Pixels of the screen for one of the page, at most: eyes see no more. */
const MOST_RATIO = 2;
/** The part of the pixels that memory allows that edges are chosen for: they are rounded. */
const ROOM = 0.99;
/** Largest edge of a picture. */
const MOST_EDGE = 4096;
/** Largest edge of a picture that is saved. */
const MOST_SAVED_EDGE = 16384;
/** Waits before the next attempt to connect, in milliseconds. */
const RETRIES = [250, 500, 1000, 2000, 4000];

export class RaysetView extends EventTarget {
  /** @type {any} the scene as it was opened */
  scene = null;
  /** @type {[Vector, Vector]} its least and largest coordinates */
  bounds = [[0, 0, 0], [0, 0, 0]];
  /** @type {[Vector, Vector]} what fills a picture of the whole: the bounds without strays */
  framed = [[0, 0, 0], [0, 0, 0]];
  /** @type {Vector} what is up */
  vertical = [0, 0, 1];
  /** @type {Vector} the direction in which one looks at the front; seen from above, what is up in the picture */
  facing = [0, 1, 0];
  /** @type {Vector[]} the outermost places of what fills a picture of the whole; none of a scene */
  outline = [];
  title = "";
  /** @type {string | null} of lengths */
  unit = null;
  /** @type {string[]} what the program remarked when it opened this */
  remarks = [];
  /** @type {Choices | null} looks to choose among; `null` for a scene that says itself what it looks like */
  choices = null;
  /** @type {Legend | null} what the picture shows in which colours */
  legend = null;

  /** @type {Camera | null} */
  #camera = null;
  /** The first camera, as the program chose it. @type {Camera | null} */
  #chosen = null;
  /** Whether it was chosen to show the whole. */
  #isFramed = false;
  /** The same for the shape of the canvas. @type {{camera: Camera, aspect: number} | null} */
  #home = null;
  /** @type {Changes} */
  #changes = {};
  #generation = 0;
  #converged = false;
  #restTimer = 0;
  #rests = false;
  #pending = 0;
  #failures = 0;
  #mostPixels = Infinity;
  #memory = { bytesPerPixel: 0, mostPixels: Infinity };
  #closed = false;
  /** @type {WebSocket | null} */
  #socket = null;
  /** @type {Map<number, {camera: Camera, changes: Changes, asked: number}>} generations whose pictures may still come, and when they were asked for */
  #asked = new Map();
  /** The last whole frame, for as long as nothing better has come. */
  #warp = new Warp();
  /** When that frame was asked for. */
  #warpAsked = 0;
  /** When it was last drawn for another camera. */
  #warped = 0;
  /** What is on the canvas, and how many columns of rays it has. @type {{camera: Camera | null, changes: Changes | null, columns: number}} */
  #drawn = { camera: null, changes: null, columns: 0 };
  /** Why the program serves this page not. @type {string | null} */
  #refusal = null;
  /** Answers that are waited for: by what they answer. @type {Map<string, {resolve: (answer: any) => void, reject: (error: Error) => void}>} */
  #waiting = new Map();
  #questions = 0;
  /** Pieces of the picture that is being saved. @type {ArrayBuffer[]} */
  #pieces = [];
  /** @type {(part: number) => void} */
  #progress = () => {};
  #address;
  #painter;
  #observer;

  /** @param {HTMLCanvasElement} canvas @param {{socket?: string}} [options] an address relative to the page's */
  constructor(canvas, options = {}) {
    super();
    this.canvas = canvas;
    this.#painter = new Painter(canvas, (frame, depths, picture) => this.#takeWhole(frame, depths, picture));
    const address = new URL(options.socket ?? "socket", document.baseURI);
    address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
    this.#address = address;
    this.#observer = new ResizeObserver(() => this.#resized());
    this.#observer.observe(canvas);
    this.#resized();
    this.#connect();
  }

  /** Where it is best seen from, in a picture of the canvas's shape. @returns {Camera | null} */
  get home() {
    const aspect = this.#aspect;
    if (this.#chosen && this.#home?.aspect !== aspect) this.#home = { camera: this.#fitted(this.#chosen), aspect };
    return this.#home?.camera ?? null;
  }

  /** @returns {Camera | null} */
  get camera() {
    return this.#camera;
  }

  set camera(camera) {
    // What has flown out of the numbers stays where it was.
    if (!camera || ![...camera.position, ...camera.direction, camera.distance, camera.height ?? 1].every(Number.isFinite)) return;
    this.#camera = camera;
    this.#changed();
  }

  /** @returns {Changes} */
  get changes() {
    return this.#changes;
  }

  set changes(changes) {
    // What is no number cannot be said.
    if (!isSaid(changes)) return;
    this.#changes = changes;
    this.#changed();
  }

  /** Whether the picture is complete: what `rayset render` makes. */
  get isConverged() {
    return this.#converged;
  }

  /** The exact pixels of the picture, as far as they have come; `null` before. */
  get pixels() {
    return this.#painter.exact(this.#generation);
  }

  /** What has to be said to see this again. */
  get state() {
    return { camera: this.#camera, changes: this.#changes };
  }

  set state({ camera, changes }) {
    this.#changes = isSaid(changes) ? changes : {};
    if (camera) this.camera = camera;
    else this.#changed();
  }

  /** Asks for the command that renders the bytes that are seen; `null` if no options say it: then a scene has to be saved first. @returns {Promise<string | null>} */
  async command() {
    const question = ++this.#questions;
    return (await this.#ask(`command ${question}`, { type: "command", question, show: this.#now })).command;
  }

  /**
   * Pixels of the picture, and those of the screen that it covers, which are more if memory allows no more; then also the bytes of memory
   * that would do, or, if none would, give the most.
   */
  get sharpness() {
    const { width, height, clientWidth, clientHeight } = this.canvas;
    const ratio = Math.min(window.devicePixelRatio || 1, MOST_RATIO);
    const screen = [clientWidth, clientHeight].map((length) => Math.min(Math.round(length * ratio), MOST_EDGE));
    if (width >= screen[0] - 1 && height >= screen[1] - 1) return { picture: [width, height], screen, wanted: null };
    const wanted = Math.min((screen[0] * screen[1]) / ROOM, this.#memory.mostPixels) * this.#memory.bytesPerPixel;
    return { picture: [width, height], screen, wanted };
  }

  /**
   * What is nearest within a window of the picture, by the last picture that came with distances.
   * @param {[number, number]} middle of the window, -1 to 1 @param {number} [half] its half height; a few pixels by default
   * @returns {{ahead: number, free: number, vouched: number} | null} how far ahead it is, on which part of the way there is surely
   *   nothing, and on which there was when it was seen
   */
  nearest(middle, half) {
    return this.#camera && this.#warp.nearest(this.#camera, this.#aspect, middle, half);
  }

  /** Everything that decides the picture, as the program is told. */
  get shown() {
    const { position, direction, up, fovy, height } = /** @type {Camera} */ (this.#camera);
    const size = [this.canvas.width, this.canvas.height];
    return { camera: { position, direction, up, fovy, ...(height ? { height } : {}) }, size, changes: this.#changes };
  }

  /** Asks for the scene file of what is seen. @returns {Promise<string>} */
  async sceneFile() {
    return (await this.#ask("saved", { type: "save", ...this.#now })).scene;
  }

  /** Asks for an address that opens another page, once, in any browser. @returns {Promise<string>} */
  async invitation() {
    const { token } = await this.#ask("invited", { type: "invite" });
    const address = new URL("./", this.#address);
    address.protocol = address.protocol === "wss:" ? "https:" : "http:";
    address.search = `token=${token}`;
    return address.href;
  }

  /**
   * Asks what lies behind a place of the picture.
   * @param {number} x @param {number} y from the left and from the top, 0 to 1 @returns {Promise<Picked>}
   */
  pick(x, y) {
    const question = ++this.#questions;
    return this.#ask(`picked ${question}`, { type: "pick", question, at: [x, y], show: this.#now });
  }

  /** Asks what is in memory and what has been read. @param {boolean} withMap whether boxes of the cloud are wanted, too @returns {Promise<Report>} */
  engine(withMap) {
    return this.#ask("engine", { type: "engine", withMap });
  }

  /**
   * Asks for a picture of what is seen, of any size.
   * @param {[number, number]} size in pixels @param {(part: number) => void} progress is told which part is done
   * @returns {Promise<Blob>} a PNG file
   */
  async picture(size, progress = () => {}) {
    if (this.#waiting.has("pictured")) throw new Error("a picture is being saved already");
    const isSize = size.every((edge) => Number.isInteger(edge) && edge >= 1 && edge <= MOST_SAVED_EDGE);
    if (!isSize) throw new Error(`a picture has 1 to ${MOST_SAVED_EDGE} pixels a side`);
    [this.#pieces, this.#progress] = [[], progress];
    await this.#ask("pictured", { type: "picture", ...this.#now, size });
    const pieces = this.#pieces;
    this.#pieces = [];
    return new Blob(pieces, { type: "image/png" });
  }

  /** Gives up the picture that is being saved. */
  cancelPicture() {
    this.#send({ type: "cancel" });
  }

  get #now() {
    return { generation: this.#generation, moving: false, ...this.shown };
  }

  /** Says something, and waits for its answer. @param {string} answer its name @param {object} message @returns {Promise<any>} */
  #ask(answer, message) {
    return new Promise((resolve, reject) => {
      if (!this.#isOpen) return reject(new Error("not connected"));
      this.#waiting.get(answer)?.reject(new Error("asked again"));
      this.#waiting.set(answer, { resolve, reject });
      this.#send(message);
    });
  }

  /** @param {string} answer @param {any} message */
  #answered(answer, message) {
    this.#waiting.get(answer)?.resolve(message);
    this.#waiting.delete(answer);
  }

  /** @param {string} answer @param {string} what is wrong */
  #refused(answer, what) {
    this.#waiting.get(answer)?.reject(new Error(what));
    this.#waiting.delete(answer);
  }

  /** Ends the connection. */
  close() {
    this.#closed = true;
    this.#observer.disconnect();
    this.#socket?.close();
  }

  #connect() {
    if (this.#closed) return;
    const socket = new WebSocket(this.#address);
    socket.binaryType = "arraybuffer";
    this.#socket = socket;
    socket.onmessage = (event) => {
      if (typeof event.data === "string") this.#hear(JSON.parse(event.data));
      else this.#frame(event.data);
    };
    socket.onclose = () => {
      for (const { reject } of this.#waiting.values()) reject(new Error("the connection is gone"));
      this.#waiting.clear();
      this.#tell("connection", { open: false, what: this.#refusal });
      this.#refusal = null;
      if (this.#closed) return;
      const wait = RETRIES[Math.min(this.#failures++, RETRIES.length - 1)];
      setTimeout(() => this.#connect(), wait);
    };
  }

  /** @param {any} message */
  #hear(message) {
    switch (message.type) {
      case "hello":
        this.#failures = 0;
        this.title = message.title;
        if (this.scene && JSON.stringify(this.scene) !== JSON.stringify(message.scene)) {
          // The program has come back with another scene: what was looked at is not in it.
          [this.#camera, this.#changes, this.#warp] = [null, {}, new Warp()];
        }
        this.scene = message.scene;
        this.bounds = message.bounds;
        [this.unit, this.remarks] = [message.unit, message.remarks];
        this.#stand(message.stance, message.camera);
        this.choices = message.choices;
        [this.#mostPixels, this.#memory] = [message.mostPixels, message.memory];
        this.#resized();
        [this.#chosen, this.#home] = [cameraOf(message.camera, this.framed, this.vertical), null];
        this.#camera ??= this.home;
        this.#tell("connection", { open: true });
        this.#tell("hello", {});
        this.#changed();
        break;
      case "converged":
        if (message.generation !== this.#generation) break;
        // Frames are drawn in their own time: the last of them first.
        this.#painter.draw(NOTHING, () => false).then(() => {
          if (message.generation !== this.#generation) return;
          this.#converged = true;
          this.#tell("converged", { seconds: message.seconds });
        });
        break;
      case "problem":
        this.#refused("saved", message.what);
        if (message.generation === this.#generation) this.#tell("problem", { what: message.what });
        break;
      case "opening":
        this.#tell("opening", { what: message.what, part: message.part });
        break;
      case "styled":
        this.legend = message;
        this.#tell("legend", {});
        break;
      case "progress":
        this.#progress(message.part);
        break;
      case "pictured":
        if (message.what === null) this.#answered("pictured", message);
        else this.#refused("pictured", message.what);
        break;
      case "picked":
        // Questions that come too fast are not answered; answers come in the order of the questions.
        for (const waits of this.#waiting.keys()) {
          if (waits.startsWith("picked ") && Number(waits.slice(7)) < message.question) this.#refused(waits, "asked again");
        }
        this.#answered(`picked ${message.question}`, message);
        break;
      case "command":
        this.#answered(`command ${message.question}`, message);
        break;
      case "refused":
        this.#refusal = message.what;
        break;
      case "invited":
      case "saved":
      case "engine":
        this.#answered(message.type, message);
        break;
    }
  }

  /** Takes note of how the scene stands. @param {Stance | null} stance @param {{direction: Vector, up: Vector}} camera */
  #stand(stance, { direction, up }) {
    [this.framed, this.outline, this.#isFramed] = [stance?.framed ?? this.bounds, stance?.outline ?? [], stance?.isFramed ?? false];
    // Of a scene, the camera says what is upright.
    const vertical = stance?.up ?? cameraOf({ position: [0, 0, 0], direction, up, fovy: 35 }, this.bounds).vertical ?? up;
    /** @type {Vector} maps have north along y; what has y up faces the reader */
    const front = Math.abs(vertical[1]) < 0.9 ? [0, 1, 0] : [0, 0, -1];
    this.vertical = vertical;
    this.facing = stance?.facing ?? unit(subtract(front, scale(vertical, dot(front, vertical))));
  }

  /** What is up in a picture along a direction: north, from straight above. @param {Vector} direction @returns {Vector} */
  upAlong(direction) {
    const steep = dot(direction, this.vertical);
    if (Math.abs(steep) > 1 - 1e-9) return scale(this.facing, steep > 0 ? -1 : 1);
    const sideways = unit(cross(direction, this.vertical));
    const up = cross(sideways, direction);
    // The vertical itself, if it is that: its numbers are round.
    return dot(up, this.vertical) > 1 - 1e-12 ? this.vertical : up;
  }

  /**
   * A camera that was chosen for a picture of another shape, in one of the canvas's: what was framed fills it. A camera whose place
   * somebody said goes back, as far as a narrower picture needs to show the whole.
   * @param {Camera} camera @returns {Camera}
   */
  #fitted(camera) {
    const [aspect, [width, height]] = [this.#aspect, this.scene.image?.size ?? CHOSEN_SIZE];
    if (this.#isFramed && this.outline.length) {
      // The program has framed all points, and not only the outermost.
      if (Math.abs((aspect * height) / width - 1) < 0.01) return camera;
      const { vertical } = camera;
      return { ...filledBy(camera, camera.direction, axes(camera)[1], this.outline, aspect), up: camera.up, vertical };
    }
    const most = Math.max(width / height / aspect, 1);
    const corners = [0, 1, 2, 3, 4, 5, 6, 7].map((k) => /** @type {Vector} */ ([0, 1, 2].map((axis) => this.framed[(k >> axis) & 1][axis])));
    const isInside = (/** @type {Camera} */ each) => corners.every((corner) => {
      const at = project(each, corner, aspect);
      return at !== null && Math.max(Math.abs(at[0]), Math.abs(at[1])) < 0.98;
    });
    for (let factor = 1; factor < most; factor *= 1.02) {
      const nearer = zoom(camera, factor, 0, 0, aspect);
      if (isInside(nearer)) return nearer;
    }
    return zoom(camera, most, 0, 0, aspect);
  }

  /** @param {ArrayBuffer} message */
  async #frame(message) {
    const frame = parse(message);
    if (frame.kind === PIECE) {
      this.#pieces.push(message.slice(message.byteLength - frame.body.byteLength));
      return;
    }
    const socket = this.#socket;
    const asked = this.#asked.get(frame.generation)?.asked;
    // A frame of what was wanted a moment ago is better than an older one; parts of it are not.
    const isWanted = (/** @type {import("./frames.js").Frame} */ { kind, generation }) =>
      kind === 1 ? !this.#converged : generation === this.#generation;
    await this.#painter.draw(frame, isWanted);
    if (frame.kind === PARTS && frame.generation === this.#generation) {
      this.#drawn = { camera: this.#camera, changes: this.#changes, columns: Infinity };
    }
    if (socket === this.#socket) this.#send({ type: "ack", frame: frame.frame });
    const milliseconds = asked === undefined ? null : performance.now() - asked;
    this.#tell("frame", { generation: frame.generation, width: frame.width, height: frame.height, milliseconds });
  }

  #resized() {
    const { clientWidth, clientHeight } = this.canvas;
    const room = Math.sqrt((ROOM * this.#mostPixels) / Math.max(clientWidth * clientHeight, 1));
    const ratio = Math.min(window.devicePixelRatio || 1, MOST_RATIO, room);
    const edge = (/** @type {number} */ length) => Math.min(Math.max(Math.round(length * ratio), 1), MOST_EDGE);
    const [width, height] = [edge(clientWidth), edge(clientHeight)];
    if (width === this.canvas.width && height === this.canvas.height && this.#generation > 0) return;
    const isHome = this.#camera !== null && this.#camera === this.#home?.camera;
    this.#painter.resize(width, height);
    // Who has not moved yet sees the whole, whatever the shape of the picture.
    if (isHome) this.#camera = this.home;
    this.#drawn = { camera: null, changes: null, columns: 0 };
    this.#changed();
  }

  /**
   * Takes a whole frame, which shows what was wanted some moments ago; draws it as it looks from where the camera is now if that is long
   * ago. Returns whether it has drawn it.
   * @param {import("./frames.js").Frame} frame @param {import("./frames.js").Depths} depths @param {ImageBitmap} picture
   */
  #takeWhole(frame, depths, picture) {
    const known = this.#asked.get(frame.generation);
    if (!known) return false;
    for (const generation of this.#asked.keys()) if (generation < frame.generation) this.#asked.delete(generation);
    this.#warp.take(known.camera, depths, picture, this.#aspect);
    this.#warpAsked = known.asked;
    this.#warped = 0;
    const drawn = this.#drawn;
    const isSame = known.camera === this.#camera && known.changes === this.#changes;
    // Nothing coarse takes the place of the same in more rays.
    if (isSame && drawn.camera === known.camera && drawn.changes === known.changes && frame.width <= drawn.columns) return true;
    // Nor does what is seen from elsewhere, once what is wanted is shown.
    if (!isSame && drawn.camera === this.#camera && drawn.changes === this.#changes && drawn.columns > 0) return true;
    if (!isSame && this.#reproject(drawn.camera === this.#camera)) return true;
    this.#drawn = { camera: known.camera, changes: known.changes, columns: frame.width };
    return false;
  }

  /** Draws the last picture as the camera sees it now, unless it is nearly of now, or is to be. Returns whether it has. @param {boolean} [isNew] */
  #reproject(isNew = false) {
    const now = performance.now();
    if (!this.#camera || now - this.#warped < BETWEEN_WARPS) return false;
    // What is seen from here already would only be blurred.
    if (!isNew && (now - this.#warpAsked < RECENT || this.#drawn.camera === this.#camera)) return false;
    this.#warped = now;
    const drawn = this.#warp.draw(this.#camera, this.#aspect);
    if (!drawn) return false;
    this.#painter.context.drawImage(drawn, 0, 0, this.canvas.width, this.canvas.height);
    this.#drawn = { camera: this.#camera, changes: null, columns: 0 };
    this.#tell("reprojected", {});
    return true;
  }

  get #aspect() {
    return this.canvas.width / this.canvas.height;
  }

  /** Something is to be seen differently: said at most once for each frame of the screen, and once more when it rests. */
  #changed() {
    this.#converged = false;
    if (!this.#camera || !this.scene) return;
    this.#tell("change", {});
    if (this.#pending === 0) {
      this.#pending = requestAnimationFrame(() => {
        this.#pending = 0;
        this.#reproject();
        this.#show(!this.#rests);
      });
    }
    this.#rests = false;
    clearTimeout(this.#restTimer);
    this.#restTimer = window.setTimeout(() => {
      this.#rests = true;
      // A change that the screen has not had time for yet will say that it is the last.
      if (this.#pending === 0) this.#show(false);
    }, REST);
  }

  /** @param {boolean} moving */
  #show(moving) {
    if (!this.#camera) return;
    this.#generation += 1;
    if (!this.#isOpen) this.#asked.clear();
    this.#asked.set(this.#generation, { camera: this.#camera, changes: this.#changes, asked: performance.now() });
    this.#send({ type: "show", generation: this.#generation, moving, ...this.shown });
  }

  /** @param {object} message */
  #send(message) {
    if (this.#isOpen) this.#socket?.send(JSON.stringify(message));
  }

  get #isOpen() {
    return this.#socket?.readyState === WebSocket.OPEN;
  }

  /** @param {string} name @param {object} detail */
  #tell(name, detail) {
    this.dispatchEvent(new CustomEvent(name, { detail }));
  }
}

/** Whether there are changes, and all of their numbers are finite. @param {any} value @returns {boolean} */
function isSaid(value) {
  if (value === null || value === undefined) return false;
  if (typeof value === "number") return Number.isFinite(value);
  return typeof value !== "object" || Object.values(value).every((each) => each === undefined || isSaid(each));
}

/** @type {import("./frames.js").Frame} */
const NOTHING = { kind: 0, generation: 0, frame: 0, width: 0, height: 0, rectangles: [], body: new Uint8Array(0) };
