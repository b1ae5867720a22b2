// @ts-check
/** What can be taken back, and done again: states of a view, kept for as long as the browser's tab. */

/** @typedef {import("./view.js").RaysetView} RaysetView */

/** Most changes that can be taken back. */
const MOST = 200;
/** Most characters that are kept; a browser keeps five million. */
const MOST_KEPT = 1_000_000;

export class History extends EventTarget {
  /** States before changes, the latest last. @type {string[]} */
  #past = [];
  /** States that were taken back, the latest last. @type {string[]} */
  #future = [];
  /** What was shown when the last of them was taken back: they are done again from there alone. */
  #shown = "";

  /** @param {RaysetView} view @param {string} key under which the browser keeps it */
  constructor(view, key) {
    super();
    this.view = view;
    this.key = key;
  }

  get #now() {
    return JSON.stringify(this.view.state);
  }

  /** Goes on with what was kept of a scene. @param {string} scene */
  open(scene) {
    try {
      const kept = JSON.parse(sessionStorage.getItem(this.key) ?? "{}");
      if (kept.scene === scene) [this.#past, this.#future, this.#shown] = [kept.past, kept.future, this.#now];
    } catch {
      // Nothing was kept.
    }
    this.#tell();
  }

  /** @param {string} scene */
  keep(scene) {
    let [past, future] = [this.#past, this.#future];
    let text = JSON.stringify({ scene, past, future });
    while (text.length > MOST_KEPT && past.length + future.length > 0) {
      [past, future] = [past.slice(Math.ceil(past.length / 2)), []];
      text = JSON.stringify({ scene, past, future });
    }
    try {
      sessionStorage.setItem(this.key, text);
    } catch {
      // The browser keeps nothing.
    }
  }

  /** Called before a change. */
  begin() {
    const state = this.#now;
    // What changed nothing is not worth taking back.
    if (this.#past.at(-1) !== state) this.#past.push(state);
    if (this.#past.length > MOST) this.#past.shift();
    this.#tell();
  }

  get canUndo() {
    const now = this.#now;
    return this.#past.some((state) => state !== now);
  }

  get canRedo() {
    return this.#future.length > 0 && this.#now === this.#shown;
  }

  undo() {
    const now = this.#now;
    while (this.#past.at(-1) === now) this.#past.pop();
    const state = this.#past.pop();
    if (state === undefined) return;
    this.#future = this.canRedo ? [...this.#future, now] : [now];
    this.#show(state);
  }

  redo() {
    const [state, now] = [this.canRedo ? this.#future.pop() : undefined, this.#now];
    if (state === undefined) return;
    if (this.#past.at(-1) !== now) this.#past.push(now);
    this.#show(state);
  }

  /** @param {string} state */
  #show(state) {
    this.view.state = JSON.parse(state);
    this.#shown = this.#now;
    this.#tell();
  }

  #tell() {
    this.dispatchEvent(new Event("change"));
  }
}
