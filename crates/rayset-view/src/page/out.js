// @ts-check
/** What leaves the page: scenes, pictures, the command that makes them, and addresses of further pages. */

import { button, buttons, download, element, number, panel } from "./widgets.js";

/** @typedef {import("./view.js").RaysetView} RaysetView */

/** @param {RaysetView} view @param {() => void} hand hands what is seen to a page that is about to be opened */
export function outPanel(view, hand) {
  const status = element("p", { class: "caption", role: "status" });
  const guarded = (/** @type {() => Promise<void>} */ act) => () => act().catch((error) => (status.textContent = error.message));
  const save = button("Save scene", guarded(async () => download(new Blob([await view.sceneFile()], { type: "application/json" }), "scene.json")));
  const another = button("New window", guarded(async () => {
    const address = await view.invitation();
    hand();
    window.open(address, "_blank", "noopener");
  }));
  save.title = "Download a scene file, from which `rayset render` makes this picture";
  another.title = "Open a second page, which begins with what this one shows";
  return panel("Export", [buttons([save, another]), ...picture(view, status), status, ...command(view)]);
}

/** A picture of any size. @param {RaysetView} view @param {HTMLElement} status */
function picture(view, status) {
  const [width, height] = ["width in pixels", "height in pixels"].map((label) => number(label, () => {}));
  for (const { input } of [width, height]) Object.assign(input, { min: "1", max: "16384", step: "1" });
  const progress = /** @type {HTMLProgressElement} */ (element("progress", { max: "1", value: "0", "aria-label": "The picture that is being saved" }));
  progress.hidden = true;
  const size = element("div", { class: "row" }, [element("span", {}, ["Size, pixels"]), width.input, element("span", {}, ["×"]), height.input]);
  size.title = "Width and height of the picture that is saved; those of the picture on the page if nothing is written";
  const cancel = button("Cancel", () => view.cancelPicture());
  cancel.hidden = true;
  const save = button("Save picture", async () => {
    const wanted = [width, height].map(({ input }) => Math.round(input.valueAsNumber));
    const [w, h] = [wanted[0] || view.canvas.width, wanted[1] || view.canvas.height];
    progress.hidden = cancel.hidden = false;
    /** @type {HTMLButtonElement} */ (save).disabled = true;
    status.textContent = "";
    try {
      const blob = await view.picture([w, h], (part) => (progress.value = part));
      download(blob, "picture.png");
    } catch (error) {
      status.textContent = /** @type {Error} */ (error).message;
    }
    /** @type {HTMLButtonElement} */ (save).disabled = false;
    progress.hidden = cancel.hidden = true;
    progress.value = 0;
  });
  save.title = "Render the picture in this size and download it as PNG";
  const showSize = () => {
    [width, height].forEach(({ input }, k) => (input.placeholder = `${k ? view.canvas.height : view.canvas.width}`));
  };
  // Both only as they are at rest: nobody reads them while the picture moves.
  view.addEventListener("converged", showSize);
  showSize();
  return [size, buttons([save, cancel]), progress];
}

/** What is said of a command while the picture is another. */
const LATER = "The command follows when the picture is complete.";

/** The command that renders what is seen. @param {RaysetView} view */
function command(view) {
  const text = /** @type {HTMLTextAreaElement} */ (element("textarea", { readonly: "", rows: "4", "aria-label": "Command that renders this picture" }));
  const copy = button("Copy command", () => {
    text.select();
    // Beyond this machine, browsers let pages without TLS copy only what is selected.
    if (navigator.clipboard) navigator.clipboard.writeText(text.value).catch(() => document.execCommand("copy"));
    else document.execCommand("copy");
  });
  const hint = element("p", { class: "caption" });
  const follow = async () => {
    /** @type {string | null} */
    let said;
    try {
      said = await view.command();
    } catch {
      // Not connected, or asked again: another answer follows.
      return;
    }
    if (!view.isConverged) return;
    text.value = said ?? "rayset render scene.json -o picture.png";
    hint.textContent = said ? "This command renders the picture, byte for byte." : "No options of the command say this. Save the scene first: the command renders it, byte for byte.";
  };
  // Only at rest: nobody reads it while the picture moves.
  view.addEventListener("converged", follow);
  // Until then it is of another picture.
  view.addEventListener("change", () => {
    if (hint.textContent !== LATER) hint.textContent = LATER;
  });
  if (view.isConverged) follow();
  return [text, hint, buttons([copy])];
}
