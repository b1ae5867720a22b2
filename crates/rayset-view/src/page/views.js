// @ts-check
/** Standard views, and those that a person keeps. */

import { lookFrom, setOrthographic, STANDARD } from "./gestures.js";
import { button, buttons, checkbox, element, panel } from "./widgets.js";

/** @typedef {import("./view.js").RaysetView} RaysetView */

const MOST_KEPT = 50;

/**
 * @param {RaysetView} view @param {() => void} begin @param {string} scene by which kept views are known again
 * @param {import("./history.js").History} history
 */
export function viewsPanel(view, begin, scene, history) {
  const act = (/** @type {() => void} */ change) => () => (begin(), change());
  const home = button("Show all", act(() => (view.camera = view.home)));
  home.title = "Go back to where the whole scene is seen (H)";
  const along = STANDARD.map(([name, direction]) => button(name, act(() => lookFrom(view, direction)), `Look from ${name}`));

  const [undo, redo] = /** @type {HTMLButtonElement[]} */ ([button("Undo", () => history.undo()), button("Redo", () => history.redo())]);
  [undo.title, redo.title] = ["Undo the last change (Ctrl+Z)", "Redo the change that was undone (Ctrl+Shift+Z)"];
  const parallel = checkbox("Orthographic", false, (on) => (begin(), setOrthographic(view, on)));
  parallel.row.title = "Parallel rays: what is far away is as large as what is near";
  const follow = () => {
    parallel.input.checked = Boolean(view.camera?.height);
    [undo.disabled, redo.disabled] = [!history.canUndo, !history.canRedo];
  };
  view.addEventListener("change", follow);
  history.addEventListener("change", follow);
  follow();

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
    button("×", () => set(kept().filter((_, i) => i !== k)), `Delete ${name}`),
  ])));
  const name = /** @type {HTMLInputElement} */ (element("input", { type: "text", maxlength: "60", placeholder: "Name of the view", "aria-label": "Name of the view to keep" }));
  const keep = button("Keep view", () => {
    const views = kept();
    set([...views.slice(-(MOST_KEPT - 1)), { name: name.value.trim() || `View ${views.length + 1}`, state: view.state }]);
    name.value = "";
  });
  keep.title = "Keep the camera and all settings under this name, in this browser";
  show();
  return panel("View", [buttons([home, ...along]), parallel.row, buttons([undo, redo]), element("div", { class: "row" }, [name, keep]), list], true);
}
