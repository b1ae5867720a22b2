// @ts-check
/** The page: one view, its panels, and what it remembers. */

import { listen } from "./gestures.js";
import { Overlay } from "./overlay.js";
import { build } from "./panels.js";
import { RaysetView } from "./view.js";

/** Most changes that can be taken back. */
const MOST_UNDO = 200;
const KEPT = "rayset-view";

/** @template {HTMLElement} T @param {string} id @returns {T} */
const by = (id) => /** @type {T} */ (document.getElementById(id));

const view = new RaysetView(/** @type {HTMLCanvasElement} */ (by("picture")), { socket: "socket" });
const status = by("status");

/** @type {string[]} states before changes, the latest last */
const undo = [];
const begin = () => {
  const state = JSON.stringify(view.state);
  // What changed nothing is not worth taking back.
  if (undo.at(-1) !== state) undo.push(state);
  if (undo.length > MOST_UNDO) undo.shift();
};
/** Enough of a text to know it again (FNV-1a). @param {string} text */
const hash = (text) => {
  let sum = 0x811c9dc5;
  for (let at = 0; at < text.length; at++) sum = Math.imul(sum ^ text.charCodeAt(at), 0x01000193);
  return (sum >>> 0).toString(16) + text.length;
};
const restore = (/** @type {string | null | undefined} */ text) => {
  if (!text) return;
  view.state = JSON.parse(text);
};

const overlay = new Overlay(view, /** @type {any} */ (by("overlay")), begin);

/** What the panels were built for. */
let opened = "";
view.addEventListener("hello", () => {
  by("title").textContent = document.title = view.title;
  const scene = hash(JSON.stringify(view.scene));
  if (opened === scene) return;
  // Panels know the scene that they were built for; with another, the page begins anew.
  if (opened) return location.reload();
  opened = scene;
  // A page that is loaded again goes on where it was, if it is the same scene.
  const kept = sessionStorage.getItem(KEPT);
  if (kept && JSON.parse(kept).opened === scene) restore(kept);
  build(by("panels"), view, begin, overlay, scene);
});
view.addEventListener("opening", (event) => {
  const { what, part } = /** @type {CustomEvent} */ (event).detail;
  status.textContent = `${what}: ${Math.floor(100 * part)} %`;
});
/** Remembers what is seen, once it rests, or when the page goes. */
let keeping = 0;
const keep = () => opened && sessionStorage.setItem(KEPT, JSON.stringify({ opened, ...view.state }));
window.addEventListener("pagehide", keep);
view.addEventListener("change", () => {
  if (status.textContent !== "tracing") status.textContent = "tracing";
  clearTimeout(keeping);
  keeping = window.setTimeout(keep, 200);
});
view.addEventListener("converged", (event) => {
  const seconds = /** @type {CustomEvent} */ (event).detail.seconds;
  const remarks = (view.legend?.remarks ?? []).map((remark) => `; ${remark}`).join("");
  status.textContent = `complete, ${seconds.toFixed(1)} s${remarks}`;
});
view.addEventListener("problem", (event) => {
  status.textContent = /** @type {CustomEvent} */ (event).detail.what;
});
view.addEventListener("connection", (event) => {
  if (!(/** @type {CustomEvent} */ (event).detail.open)) status.textContent = "not connected; trying again";
});

listen(view, begin);
document.addEventListener("keydown", (event) => {
  // In a field where one types, it is the typing that is taken back.
  const types = event.target instanceof HTMLTextAreaElement || (event.target instanceof HTMLInputElement && /^(text|number)$/.test(event.target.type));
  if ((event.ctrlKey || event.metaKey) && !event.shiftKey && !types && event.key.toLowerCase() === "z") {
    event.preventDefault();
    const now = JSON.stringify(view.state);
    while (undo.at(-1) === now) undo.pop();
    restore(undo.pop());
  }
});
const fold = by("fold");
fold.addEventListener("click", () => {
  const folded = document.querySelector("aside")?.classList.toggle("folded") ?? false;
  fold.setAttribute("aria-expanded", String(!folded));
});

// For tests, and for whoever is curious.
Object.assign(window, { rayset: { view } });
