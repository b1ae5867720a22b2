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
 * is complete), `problem` (`detail.what`), `connection` (`detail.open`).
 */

import { cameraOf, zoom } from "./camera.js";
import { Painter, parse, PIECE } from "./frames.js";
import { Warp } from "./warp.js";

/**
 * @typedef {import("./camera.js").Camera} Camera
 * @typedef {import("./camera.js").Vector} Vector
 * @typedef {{direction: Vector, intensity: number, shadow: boolean}} Sun
 * @typedef {{min: Vector, max: Vector}} Section
 * @typedef {{form: "box" | "ellipsoid" | "cylinder", center: Vector, size: Vector, turns?: {axis: Vector, degrees: number}[], keep?: boolean}} Cutter
 *   takes away what is inside of it, or all else
 * @typedef {{look?: string, color?: string, colorBy?: string, colormap?: string, valueRange?: [number, number], log?: boolean, radiusScale?: number, opacity?: [number, number][]}} Style
 *   options of `rayset render`
 * @typedef {{exposure?: number, sun?: Sun, section?: Section, cutters?: Cutter[], cap?: string, style?: Style}} Changes
 *   what is other than in the scene that was opened; `cap`: the colour that fills cuts
 * @typedef {{low: number, high: number, logarithmic: boolean, counts: number[]}} Histogram
 * @typedef {{name: string, unit: string, range: [number, number], histogram: Histogram | null}} Attribute
 * @typedef {{looks: string[], attributes: Attribute[], palettes: [string, string[]][], style: Style}} Choices
 * @typedef {{look: string, line: string, isLit: boolean, exposure: number, transferFunction: any, densities: Histogram | null, remarks: string[], command: string | null}} Legend
 * @typedef {{question: number, position: Vector | null, point: {position: Vector, stored: Vector, values: [string, number, string][]} | null}} Picked
 * @typedef {{name: string, bytes: number, hits: number, misses: number, reads: number, bytesRead: number, bytesUnique: number, evictions: number, waitedSeconds: number}} KindReport
 * @typedef {{budget: number, kinds: KindReport[], regions: [Vector, Vector][] | null, resident: number[]}} Report
 * @typedef {{size?: [number, number], scene?: any}} Scene
 */

/** A picture moves as long as changes follow each other faster than this, in milliseconds. */
const REST = 120;
/** A picture that was asked for less than so many milliseconds ago is drawn as it is. */
const RECENT = 80;
/** Milliseconds between two drawings of the last picture: the program needs the processor, too. */
const BETWEEN_WARPS = 25;
/** Width over height of the picture that the program chooses a camera for. */
const CHOSEN_ASPECT = 16 / 9;
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
  title = "";
  /** @type {Choices | null} looks to choose among; `null` for a scene that says itself what it looks like */
  choices = null;
  /** @type {Legend | null} what the picture shows in which colours */
  legend = null;
  /** @type {Camera | null} where it is best seen from */
  home = null;

  /** @type {Camera | null} */
  #camera = null;
  /** @type {Changes} */
  #changes = {};
  #generation = 0;
  #converged = false;
  #restTimer = 0;
  #rests = false;
  #pending = 0;
  #failures = 0;
  #mostPixels = Infinity;
  #closed = false;
  /** @type {WebSocket | null} */
  #socket = null;
  /** @type {Map<number, {camera: Camera, asked: number}>} generations whose pictures may still come, and when they were asked for */
  #asked = new Map();
  /** The last whole frame, for as long as nothing better has come. */
  #warp = new Warp();
  /** When that frame was asked for. */
  #warpAsked = 0;
  /** When it was last drawn for another camera. */
  #warped = 0;
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

  /** @returns {Camera | null} */
  get camera() {
    return this.#camera;
  }

  set camera(camera) {
    // What has flown out of the numbers stays where it was.
    if (!camera || ![...camera.position, ...camera.direction, camera.distance].every(Number.isFinite)) return;
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

  /** The command that renders what is seen, if options say it; else a scene has to be saved first. */
  get command() {
    const command = this.legend?.command;
    if (!command || !this.#camera) return null;
    const { position, direction, fovy } = this.#camera;
    const three = (/** @type {Vector} */ v) => v.join(",");
    return `${command} --position=${three(position)} --direction=${three(direction)} --fovy=${fovy} ` +
      `--size=${this.canvas.width}x${this.canvas.height} -o picture.png`;
  }

  /** Everything that decides the picture, as the program is told. */
  get shown() {
    const { position, direction, up, fovy } = /** @type {Camera} */ (this.#camera);
    const size = [this.canvas.width, this.canvas.height];
    return { camera: { position, direction, up, fovy }, size, changes: this.#changes };
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
      this.#tell("connection", { open: false });
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
        this.choices = message.choices;
        this.#mostPixels = message.mostPixels;
        this.#resized();
        this.home = this.#fitted(cameraOf(message.camera, message.bounds));
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
      case "invited":
      case "saved":
      case "engine":
        this.#answered(message.type, message);
        break;
    }
  }

  /**
   * A camera that was chosen for a picture of 16 to 9, as far back as a narrower one needs.
   * @param {Camera} camera @returns {Camera}
   */
  #fitted(camera) {
    const aspect = this.canvas.width / this.canvas.height;
    return zoom(camera, Math.max(CHOSEN_ASPECT / aspect, 1), 0, 0, aspect);
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
    if (socket === this.#socket) this.#send({ type: "ack", frame: frame.frame });
    const milliseconds = asked === undefined ? null : performance.now() - asked;
    this.#tell("frame", { generation: frame.generation, width: frame.width, height: frame.height, milliseconds });
  }

  #resized() {
    const { clientWidth, clientHeight } = this.canvas;
    const room = Math.sqrt((0.99 * this.#mostPixels) / Math.max(clientWidth * clientHeight, 1));
    const ratio = Math.min(window.devicePixelRatio || 1, 2, room);
    const edge = (/** @type {number} */ length) => Math.min(Math.max(Math.round(length * ratio), 1), MOST_EDGE);
    const [width, height] = [edge(clientWidth), edge(clientHeight)];
    if (width === this.canvas.width && height === this.canvas.height && this.#generation > 0) return;
    this.#painter.resize(width, height);
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
    return frame.generation !== this.#generation && this.#reproject();
  }

  /** Draws the last picture as the camera sees it now, unless it is nearly of now. Returns whether it has. */
  #reproject() {
    const now = performance.now();
    if (!this.#camera || now - this.#warpAsked < RECENT || now - this.#warped < BETWEEN_WARPS) return false;
    this.#warped = now;
    const drawn = this.#warp.draw(this.#camera, this.#aspect);
    if (!drawn) return false;
    this.#painter.context.drawImage(drawn, 0, 0, this.canvas.width, this.canvas.height);
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
    this.#asked.set(this.#generation, { camera: this.#camera, asked: performance.now() });
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
