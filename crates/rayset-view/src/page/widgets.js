// @ts-check
/** What panels are made of. */

/**
 * @param {string} name @param {Record<string, string>} [attributes] @param {(Node | string)[]} [children]
 * @returns {HTMLElement}
 */
export function element(name, attributes = {}, children = []) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

/** An element of a drawing. @param {string} name @param {Record<string, string | number>} [attributes] @returns {SVGElement} */
export function shape(name, attributes = {}) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, `${value}`);
  return made;
}

/** @param {string} text @param {() => void} act @param {string} [label] what it is called where its text alone does not say */
export function button(text, act, label) {
  const made = element("button", { type: "button", ...(label ? { "aria-label": label, title: label } : {}) }, [text]);
  made.addEventListener("click", act);
  return made;
}

let numbers = 0;
const fresh = (/** @type {string} */ kind) => `${kind}-${numbers++}`;

/** @param {string} id @param {string} name @param {Node[]} controls */
const row = (id, name, controls) => element("div", { class: "row" }, [element("label", { for: id }, [name]), ...controls]);

/**
 * A slider in a row of its own.
 * @param {string} name @param {[number, number, number]} range least, largest, step @param {number} value
 * @param {(value: number) => void} changed @param {(value: number) => string} [text]
 */
export function slider(name, [min, max, step], value, changed, text = (v) => String(v)) {
  const id = fresh("slider");
  const input = /** @type {HTMLInputElement} */ (
    element("input", { id, type: "range", min: `${min}`, max: `${max}`, step: `${step}`, value: `${value}` })
  );
  const output = element("output", { for: id }, [text(value)]);
  input.addEventListener("input", () => {
    output.textContent = text(input.valueAsNumber);
    changed(input.valueAsNumber);
  });
  // A thumb that is held stays where the pointer is.
  let isHeld = false;
  input.addEventListener("pointerdown", () => (isHeld = true));
  for (const ended of ["pointerup", "pointercancel", "lostpointercapture"]) input.addEventListener(ended, () => (isHeld = false));
  const set = (/** @type {number} */ now) => {
    if (!isHeld) input.value = `${now}`;
    output.textContent = text(now);
  };
  return { row: row(id, name, [input, output]), input, set };
}

/** @param {string} name @param {boolean} value @param {(value: boolean) => void} changed */
export function checkbox(name, value, changed) {
  const id = fresh("check");
  const input = /** @type {HTMLInputElement} */ (element("input", { id, type: "checkbox" }));
  input.checked = value;
  input.addEventListener("change", () => changed(input.checked));
  return { row: row(id, name, [input]), input };
}

/**
 * @param {string} name @param {[string, string][]} options values and what they are called
 * @param {(value: string) => void} changed
 */
export function select(name, options, changed) {
  const id = fresh("select");
  const input = /** @type {HTMLSelectElement} */ (element("select", { id },
    options.map(([value, text]) => element("option", { value }, [text]))));
  input.addEventListener("change", () => changed(input.value));
  return { row: row(id, name, [input]), input };
}

/**
 * A number that is typed; `changed` hears of it once it is complete.
 * @param {string} label @param {(value: number) => void} changed
 */
export function number(label, changed) {
  const input = /** @type {HTMLInputElement} */ (element("input", { type: "number", step: "any", "aria-label": label }));
  input.addEventListener("change", () => Number.isFinite(input.valueAsNumber) && changed(input.valueAsNumber));
  const set = (/** @type {number | undefined} */ now) => {
    if (document.activeElement !== input) input.value = now === undefined ? "" : `${Number(now.toPrecision(7))}`;
  };
  return { input, set };
}

/** @param {string} name @param {string} value @param {(value: string) => void} changed */
export function color(name, value, changed) {
  const id = fresh("color");
  const input = /** @type {HTMLInputElement} */ (element("input", { id, type: "color", value }));
  input.addEventListener("input", () => changed(input.value));
  return { row: row(id, name, [input]), input };
}

/**
 * A panel that folds.
 * @param {string} title @param {Node[]} children @param {boolean} [isOpen]
 */
export function panel(title, children, isOpen = false) {
  const made = element("details", isOpen ? { open: "" } : {}, [element("summary", {}, [element("h2", {}, [title])]), ...children]);
  return /** @type {HTMLDetailsElement} */ (made);
}

/** @param {(Node | string)[]} children */
export const buttons = (children) => element("div", { class: "buttons" }, children);

/** A number as a person reads it: six digits. @param {number} value */
export function short(value) {
  if (value === 0 || !Number.isFinite(value)) return String(value);
  const size = Math.abs(value);
  return size >= 1e6 || size < 1e-4 ? value.toExponential(3) : String(Number(value.toPrecision(6)));
}

/** @param {number} count of bytes */
export function bytes(count) {
  const units = ["B", "KiB", "MiB", "GiB", "TiB"];
  const unit = Math.min(Math.floor(Math.log2(Math.max(count, 1)) / 10), units.length - 1);
  return `${Number((count / 1024 ** unit).toPrecision(3))} ${units[unit]}`;
}

/**
 * Calls a function now and whenever what a view shows changes, the camera aside: that moves with every frame.
 * @param {import("./view.js").RaysetView} view @param {() => void} follow
 */
export function following(view, follow) {
  let last = view.changes;
  view.addEventListener("change", () => {
    if (view.changes === last) return;
    last = view.changes;
    follow();
  });
  view.addEventListener("legend", follow);
  follow();
}

/** Gives a person a file. @param {Blob} blob @param {string} name */
export function download(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  // Browsers read it in their own time.
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}
