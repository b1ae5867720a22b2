// @ts-check
/**
 * What is drawn over the picture: lines, marks and handles at places of the scene. Handles are moved with the pointer, or with the
 * arrow keys.
 */

import { add, axes, dot, halfHeight, project, scale, subtract } from "./camera.js";
import { shape } from "./widgets.js";

/** @typedef {import("./view.js").RaysetView} RaysetView */
/** @typedef {import("./camera.js").Vector} Vector */

/**
 * @typedef {object} Handle
 * @property {string} name unique; what it is called
 * @property {Vector} at
 * @property {Vector | null} axis along which it moves, of length 1; `null`: in the plane of the picture
 * @property {(by: Vector) => void} moved by how much, world space
 * @typedef {object} Drawing
 * @property {[Vector, Vector][]} [lines]
 * @property {{at: Vector, label: string}[]} [marks]
 * @property {Handle[]} [handles]
 */

/** What an arrow key moves a handle by, in parts of the picture's height. */
const KEY_STEP = 0.01;
/** @type {Record<string, [number, number]>} right and up */
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

export class Overlay {
  /** @type {Map<string, () => Drawing>} */
  #layers = new Map();
  /** @type {Map<string, {element: SVGElement, handle: Handle}>} */
  #handles = new Map();
  #pending = 0;
  #still = shape("g", { class: "still" });

  /** @param {RaysetView} view @param {SVGElement} svg over the view's canvas @param {() => void} begin called before a change */
  constructor(view, svg, begin) {
    this.view = view;
    this.svg = svg;
    this.begin = begin;
    svg.append(this.#still);
    view.addEventListener("change", () => this.redraw());
    new ResizeObserver(() => this.redraw()).observe(view.canvas);
  }

  /** Draws from now on what a function says, in the place of what had this name. @param {string} name @param {() => Drawing} draw */
  set(name, draw) {
    this.#layers.set(name, draw);
    this.redraw();
  }

  redraw() {
    this.#pending ||= requestAnimationFrame(() => {
      this.#pending = 0;
      this.#draw();
    });
  }

  /** A place of the scene in pixels of the page; `null` behind the eye. @param {Vector} point @returns {[number, number] | null} */
  #place(point) {
    const { camera, canvas } = this.view;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    const at = camera && project(camera, point, width / height);
    return at ? [((at[0] + 1) / 2) * width, ((1 - at[1]) / 2) * height] : null;
  }

  #draw() {
    const drawings = [...this.#layers.values()].map((draw) => draw());
    this.#still.replaceChildren();
    for (const { lines = [], marks = [] } of drawings) {
      for (const [from, to] of lines) this.#line(from, to);
      for (const { at, label } of marks) this.#mark(at, label);
    }
    const named = new Map(drawings.flatMap(({ handles = [] }) => handles).map((handle) => [handle.name, handle]));
    for (const [name, { element }] of this.#handles) {
      if (!named.has(name)) {
        element.remove();
        this.#handles.delete(name);
      }
    }
    for (const handle of named.values()) this.#handle(handle);
  }

  /** @param {Vector} from @param {Vector} to */
  #line(from, to) {
    const camera = this.view.camera;
    if (!camera) return;
    // The part before the eye.
    const ahead = (/** @type {Vector} */ p) => dot(subtract(p, camera.position), camera.direction) - 1e-3 * camera.distance;
    let [a, b] = [from, to];
    const [before, behind] = [ahead(a), ahead(b)];
    if (before <= 0 && behind <= 0) return;
    const cut = add(a, scale(subtract(b, a), before / (before - behind)));
    if (before <= 0) a = cut;
    if (behind <= 0) b = cut;
    const [p, q] = [this.#place(a), this.#place(b)];
    if (p && q) this.#still.append(shape("line", { x1: p[0], y1: p[1], x2: q[0], y2: q[1] }));
  }

  /** @param {Vector} at @param {string} label */
  #mark(at, label) {
    const place = this.#place(at);
    if (!place) return;
    const text = shape("text", { x: place[0] + 8, y: place[1] - 8 });
    text.textContent = label;
    this.#still.append(shape("circle", { cx: place[0], cy: place[1], r: 4 }), text);
  }

  /** @param {Handle} handle */
  #handle(handle) {
    const known = this.#handles.get(handle.name);
    const element = known?.element ?? this.#newHandle(handle.name);
    this.#handles.set(handle.name, { element, handle });
    const place = this.#place(handle.at);
    element.classList.toggle("out", !place);
    if (place) {
      element.setAttribute("cx", `${place[0]}`);
      element.setAttribute("cy", `${place[1]}`);
    }
  }

  /** @param {string} name */
  #newHandle(name) {
    const element = shape("circle", { class: "handle", r: 9, tabindex: 0, role: "button", "aria-label": `${name}: arrow keys move it` });
    /** @type {[number, number] | null} */
    let last = null;
    element.addEventListener("pointerdown", (event) => {
      event.preventDefault();
      element.focus();
      element.setPointerCapture(event.pointerId);
      this.begin();
      last = [event.clientX, event.clientY];
    });
    element.addEventListener("pointermove", (event) => {
      if (!last) return;
      this.#move(name, event.clientX - last[0], event.clientY - last[1]);
      last = [event.clientX, event.clientY];
    });
    for (const ended of /** @type {const} */ (["pointerup", "pointercancel"])) element.addEventListener(ended, () => (last = null));
    element.addEventListener("keydown", (event) => {
      const arrow = ARROWS[event.key];
      if (!arrow) return;
      event.preventDefault();
      if (!event.repeat) this.begin();
      const step = KEY_STEP * this.view.canvas.clientHeight;
      const axis = this.#handles.get(name)?.handle.axis;
      // Along an axis that points left on the page, the right arrow still moves right.
      if (axis) this.#moveAlong(name, arrow[0] + arrow[1], step);
      else this.#move(name, arrow[0] * step, -arrow[1] * step);
    });
    this.svg.append(element);
    return element;
  }

  /** Moves a handle along its axis by so many pixels of the page, to the right or up. @param {string} name @param {number} sign @param {number} step */
  #moveAlong(name, sign, step) {
    const handle = this.#handles.get(name)?.handle;
    if (!handle?.axis) return;
    const along = this.#onPage(handle.at, handle.axis);
    const length = Math.hypot(...along);
    if (length ** 2 <= this.#leastSquare(this.view.camera?.distance ?? 1)) return;
    const points = Math.abs(along[0]) > Math.abs(along[1]) ? along[0] : -along[1];
    handle.moved(scale(handle.axis, (sign * Math.sign(points || 1) * step) / length));
  }

  /** Moves a handle with the pointer. @param {string} name @param {number} x @param {number} y pixels of the page */
  #move(name, x, y) {
    const handle = this.#handles.get(name)?.handle;
    const { camera, canvas } = this.view;
    if (!handle || !camera) return;
    if (handle.axis) {
      const along = this.#onPage(handle.at, handle.axis);
      const square = along[0] ** 2 + along[1] ** 2;
      if (square > this.#leastSquare(camera.distance)) handle.moved(scale(handle.axis, (x * along[0] + y * along[1]) / square));
      return;
    }
    const depth = dot(subtract(handle.at, camera.position), camera.direction);
    const unit = (2 * halfHeight(camera, depth)) / canvas.clientHeight;
    const [sideways, above] = axes(camera);
    handle.moved(add(scale(sideways, x * unit), scale(above, -y * unit)));
  }

  /** Along an axis towards the eye, a pixel would be any length: at least a fiftieth of what is across. @param {number} distance */
  #leastSquare(distance) {
    return (this.view.canvas.clientHeight / distance / 50) ** 2;
  }

  /** What a unit along an axis is on the page, in pixels. @param {Vector} at @param {Vector} axis @returns {[number, number]} */
  #onPage(at, axis) {
    const small = 1e-3 * (this.view.camera?.distance ?? 1);
    const [p, q] = [this.#place(at), this.#place(add(at, scale(axis, small)))];
    return p && q ? [(q[0] - p[0]) / small, (q[1] - p[1]) / small] : [0, 0];
  }
}
