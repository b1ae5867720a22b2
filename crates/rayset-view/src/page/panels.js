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
 */
export function build(into, view, begin, overlay, scene) {
  into.replaceChildren(
    viewsPanel(view, begin, scene),
    ...lookPanel(view, begin),
    lightPanel(view, begin),
    cutsPanel(view, begin, overlay),
    picksPanel(view, begin, overlay),
    outPanel(view),
    enginePanel(view),
  );
  for (const input of into.querySelectorAll("input[type=range], input[type=color]")) {
    let last = -Infinity;
    input.addEventListener("pointerdown", begin);
    input.addEventListener("keydown", (event) => {
      if (!/^(Arrow|Page|Home|End)/.test(/** @type {KeyboardEvent} */ (event).key)) return;
      if (performance.now() - last > TOGETHER) begin();
      last = performance.now();
    });
  }
}
