// @ts-check
/** The page: one view, its panels, and what it remembers. */

import { listen } from "./gestures.js";
import { History } from "./history.js";
import { Overlay } from "./overlay.js";
import { build } from "./panels.js";
import { RaysetView } from "./view.js";
import { element } from "./widgets.js";

const KEPT = "rayset-view";
/** What a page hands to one that it opens. */
const HANDED = "rayset-handed";
/** Milliseconds after which nobody takes it. */
const HANDING = 60_000;

/** @template {HTMLElement} T @param {string} id @returns {T} */
const by = (id) => /** @type {T} */ (document.getElementById(id));

const view = new RaysetView(/** @type {HTMLCanvasElement} */ (by("picture")), { socket: "socket" });
const status = by("status");

const history = new History(view, "rayset-history");
const begin = () => history.begin();
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

/** Takes what another page has handed to this one, if it is of the same scene. @param {string} scene @returns {string | null} */
const handed = (scene) => {
  try {
    const text = localStorage.getItem(HANDED);
    const { opened, at } = JSON.parse(text ?? "{}");
    if (opened !== scene || !(Date.now() - at < HANDING)) return null;
    localStorage.removeItem(HANDED);
    return text;
  } catch {
    return null;
  }
};
/** Hands what is seen to a page that is about to be opened. */
const hand = () => {
  try {
    localStorage.setItem(HANDED, JSON.stringify({ opened, at: Date.now(), ...view.state }));
  } catch {
    // The browser keeps nothing: the page begins anew.
  }
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
  else restore(handed(scene));
  history.open(scene);
  build(by("panels"), view, begin, overlay, scene, history, hand);
});
view.addEventListener("opening", (event) => {
  const { what, part } = /** @type {CustomEvent} */ (event).detail;
  status.textContent = `${what}: ${Math.floor(100 * part)} %`;
});
/** Remembers what is seen, once it rests, or when the page goes. */
let keeping = 0;
const keep = () => {
  if (!opened) return;
  sessionStorage.setItem(KEPT, JSON.stringify({ opened, ...view.state }));
  history.keep(opened);
};
window.addEventListener("pagehide", keep);
/** Whether the program hears what this page wants. */
let isConnected = false;
view.addEventListener("change", () => {
  if (isConnected && status.textContent !== "tracing") status.textContent = "tracing";
  clearTimeout(keeping);
  keeping = window.setTimeout(keep, 200);
});
/** What the program remarked, and that the screen has more pixels than the picture. */
const remark = () => {
  const { picture, screen, wanted } = view.sharpness;
  const memory = wanted && `--memory ${Math.ceil(wanted / 2 ** 20 / 16) * 16}MiB`;
  const blur = memory ? [`the picture has ${picture.join("×")} pixels, enlarged to ${screen.join("×")}: ${memory} gives a sharper one`] : [];
  const remarks = [...view.remarks, ...(view.legend?.remarks ?? []), ...blur];
  by("remarks").replaceChildren(...remarks.map((each) => element("li", {}, [each])));
};
// Before there is a picture, because they take a part of the page; and again when its size is settled.
for (const name of ["hello", "legend", "converged"]) view.addEventListener(name, remark);
view.addEventListener("converged", (event) => {
  status.textContent = `complete, ${/** @type {CustomEvent} */ (event).detail.seconds.toFixed(1)} s`;
});
view.addEventListener("problem", (event) => {
  status.textContent = /** @type {CustomEvent} */ (event).detail.what;
});
view.addEventListener("connection", (event) => {
  const { open, what } = /** @type {CustomEvent} */ (event).detail;
  isConnected = open;
  if (!open) status.textContent = `not connected${what ? `: ${what}` : ""}; trying again`;
});

listen(view, begin);
document.addEventListener("keydown", (event) => {
  // In a field where one types, it is the typing that is taken back.
  const types = event.target instanceof HTMLTextAreaElement || (event.target instanceof HTMLInputElement && /^(text|number)$/.test(event.target.type));
  if (!(event.ctrlKey || event.metaKey) || types) return;
  const key = event.key.toLowerCase();
  if (key !== "z" && key !== "y") return;
  event.preventDefault();
  if (key === "y" || event.shiftKey) history.redo();
  else history.undo();
});
const fold = by("fold");
fold.addEventListener("click", () => {
  const folded = document.querySelector("aside")?.classList.toggle("folded") ?? false;
  fold.setAttribute("aria-expanded", String(!folded));
});

// For tests, and for whoever is curious.
Object.assign(window, { rayset: { view } });
