// @ts-check
/** The panels beside the picture: each is built once, and follows the view. */

import { cutsPanel } from "./cuts.js";
import { enginePanel } from "./engine.js";
import { lightPanel } from "./light.js";
import { lookPanel } from "./look.js";
import { outPanel } from "./out.js";
import { picksPanel } from "./picks.js";
import { viewsPanel } from "./views.js";

/** @typedef {import("./view.js").RaysetView} RaysetView */
/** @typedef {import("./overlay.js").Overlay} Overlay */

/** Changes by keys that follow each other faster than this, in milliseconds, are taken back together. */
const TOGETHER = 1000;

/**
 * Fills the panels of a view.
 * @param {HTMLElement} into @param {RaysetView} view @param {() => void} begin called before a change that may be taken back
 * @param {Overlay} overlay @param {string} scene by which the scene is known again
 * @param {import("./history.js").History} history @param {() => void} hand hands what is seen to a page that is about to be opened
 */
export function build(into, view, begin, overlay, scene, history, hand) {
  into.replaceChildren(
    viewsPanel(view, begin, scene, history),
    ...lookPanel(view, begin),
    lightPanel(view, begin),
    cutsPanel(view, begin, overlay),
    picksPanel(view, begin, overlay),
    outPanel(view, hand),
    enginePanel(view),
  );
  const slides = (/** @type {Event} */ { target }) => target instanceof HTMLInputElement && /^(range|color)$/.test(target.type);
  into.addEventListener("pointerdown", (event) => slides(event) && begin());
  /** @type {EventTarget | null} */
  let moved = null;
  let last = -Infinity;
  into.addEventListener("keydown", (event) => {
    if (!slides(event) || !/^(Arrow|Page|Home|End)/.test(event.key)) return;
    if (event.target !== moved || performance.now() - last > TOGETHER) begin();
    [moved, last] = [event.target, performance.now()];
  });
}
