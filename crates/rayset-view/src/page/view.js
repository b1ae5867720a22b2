// @ts-check
/**
 * The view itself, for any page: a canvas that shows a scene which `rayset view` serves.
 *
 *     const view = new RaysetView(canvas, { socket: "socket" });
 *     view.addEventListener("hello", () => { view.camera = orbit(view.camera, 0.5, 0); });
 *
 * Events: `hello` (a scene has been opened; `view.scene`, `view.bounds` and `view.camera` are known), `change` (the camera or
 * the changes are others), `frame`, `reprojected` (the last picture was drawn as the camera sees it now), `converged` (`detail.seconds`: the picture is complete), `problem` (`detail.what`),
 * `connection` (`detail.open`).
 */

import { cameraOf, zoom } from "./camera.js";
import { Painter, parse } from "./frames.js";
import { Warp } from "./warp.js";

/**
 * @typedef {import("./camera.js").Camera} Camera
 * @typedef {import("./camera.js").Vector} Vector
 * @typedef {{direction: Vector, intensity: number, shadow: boolean}} Sun
 * @typedef {{min: Vector, max: Vector}} Section
 * @typedef {{exposure?: number, sun?: Sun, section?: Section, transfer?: object}} Changes
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
/** Waits before the next attempt to connect, in milliseconds. */
const RETRIES = [250, 500, 1000, 2000, 4000];

export class RaysetView extends EventTarget {
  /** @type {any} the scene as it was opened */
  scene = null;
  /** @type {[Vector, Vector]} its least and largest coordinates */
  bounds = [[0, 0, 0], [0, 0, 0]];
  title = "";
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

  /** Everything that decides the picture, as the program is told. */
  get shown() {
    const { position, direction, up, fovy } = /** @type {Camera} */ (this.#camera);
    const size = [this.canvas.width, this.canvas.height];
    return { camera: { position, direction, up, fovy }, size, changes: this.#changes };
  }

  /** Asks for the scene file of what is seen. @returns {Promise<string>} */
  sceneFile() {
    return new Promise((resolve, reject) => {
      if (!this.#isOpen) return reject(new Error("not connected"));
      this.addEventListener("saved", (event) => resolve(/** @type {CustomEvent} */ (event).detail.scene), { once: true });
      this.#send({ type: "save", generation: this.#generation, moving: false, ...this.shown });
    });
  }

  /** Asks for an address that opens another page, once, in any browser. @returns {Promise<string>} */
  invitation() {
    return new Promise((resolve, reject) => {
      if (!this.#isOpen) return reject(new Error("not connected"));
      this.addEventListener("invited", (event) => {
        const address = new URL("./", this.#address);
        address.protocol = address.protocol === "wss:" ? "https:" : "http:";
        address.search = `token=${/** @type {CustomEvent} */ (event).detail.token}`;
        resolve(address.href);
      }, { once: true });
      this.#send({ type: "invite" });
    });
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
        if (message.generation === this.#generation) this.#tell("problem", { what: message.what });
        break;
      case "invited":
        this.#tell("invited", { token: message.token });
        break;
      case "saved":
        this.#tell("saved", { scene: message.scene });
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
    const socket = this.#socket;
    // A frame of what was wanted a moment ago is better than an older one; parts of it are not.
    const isWanted = (/** @type {import("./frames.js").Frame} */ { kind, generation }) =>
      kind === 1 ? !this.#converged : generation === this.#generation;
    await this.#painter.draw(frame, isWanted);
    if (socket === this.#socket) this.#send({ type: "ack", frame: frame.frame });
    this.#tell("frame", { generation: frame.generation, width: frame.width });
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

/** @type {import("./frames.js").Frame} */
const NOTHING = { kind: 0, generation: 0, frame: 0, width: 0, height: 0, rectangles: [], body: new Uint8Array(0) };
