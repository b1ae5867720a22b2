// @ts-check
/** Standard views, and those that a person keeps. */

import { lookFrom, STANDARD } from "./gestures.js";
import { button, buttons, element, panel } from "./widgets.js";

/** @typedef {import("./view.js").RaysetView} RaysetView */

const MOST_KEPT = 50;

/** @param {RaysetView} view @param {() => void} begin @param {string} scene by which kept views are known again */
export function viewsPanel(view, begin, scene) {
  const act = (/** @type {() => void} */ change) => () => (begin(), change());
  const home = button("Whole", act(() => (view.camera = view.home)));
  home.title = "See the scene whole (H)";
  const along = STANDARD.map(([name, direction]) => button(name, act(() => lookFrom(view, direction)), `Look from ${name}`));

  const key = `rayset-views-${scene}`;
  const list = element("div");
  /** @returns {{name: string, state: any}[]} */
  const kept = () => {
    try {
      return JSON.parse(localStorage.getItem(key) ?? "[]");
    } catch {
      return [];
    }
  };
  const set = (/** @type {{name: string, state: any}[]} */ views) => {
    try {
      localStorage.setItem(key, JSON.stringify(views));
    } catch {
      // There is no room, or the browser keeps nothing: the views stay as they were.
    }
    show();
  };
  const show = () => list.replaceChildren(...kept().map(({ name, state }, k) => buttons([
    button(name, act(() => (view.state = state)), `Go to ${name}`),
    button("×", () => set(kept().filter((_, i) => i !== k)), `Forget ${name}`),
  ])));
  const name = /** @type {HTMLInputElement} */ (element("input", { type: "text", maxlength: "60", placeholder: "its name", "aria-label": "Name of the view to keep" }));
  const keep = button("Keep this view", () => {
    const views = kept();
    set([...views.slice(-(MOST_KEPT - 1)), { name: name.value.trim() || `View ${views.length + 1}`, state: view.state }]);
    name.value = "";
  });
  show();
  return panel("View", [buttons([home, ...along]), element("div", { class: "row" }, [name, keep]), list], true);
}
