// @ts-check
/** Cuts: a box along the axes, and solids of any place, size and turn. They are nodes of the scene that is saved. */

import { add, dot, pivot, scale, subtract, turned, unit } from "./camera.js";
import { button, buttons, checkbox, color, element, following, panel, slider } from "./widgets.js";

/** @typedef {import("./view.js").RaysetView} RaysetView */
/** @typedef {import("./view.js").Cutter} Cutter */
/** @typedef {import("./camera.js").Vector} Vector */
/** @typedef {import("./overlay.js").Overlay} Overlay */
/** @typedef {import("./overlay.js").Handle} Handle */

const AXES = ["x", "y", "z"];
const NAMES = { box: "Box", ellipsoid: "Ball", cylinder: "Cylinder" };
/** The thinnest that a section or a solid gets, in parts of the scene. */
const THINNEST = 0.005;
const MOST_CUTTERS = 16;

/** @param {RaysetView} view @param {() => void} begin @param {Overlay} overlay */
export function cutsPanel(view, begin, overlay) {
  const [low, high] = view.bounds;
  const filling = filled(view, begin);
  const box = sectionBox(view, begin);
  const solids = cutters(view, begin);
  overlay.set("section", () => sectionDrawing(view));
  overlay.set("cutters", () => {
    const drawings = (view.changes.cutters ?? []).map((cutter, k) => cutterDrawing(view, cutter, k));
    return { lines: drawings.flatMap(({ lines }) => lines), handles: drawings.flatMap(({ handles }) => handles) };
  });
  const hasExtent = [0, 1, 2].every((axis) => high[axis] > low[axis]);
  return panel("Cuts", hasExtent ? [box, solids, ...filling] : [element("p", {}, ["A flat scene cannot be cut."])]);
}

/** Whether cuts are filled. @param {RaysetView} view @param {() => void} begin */
function filled(view, begin) {
  const shown = color("Fill colour", "#b8553a", (value) => view.changes.cap && set(value));
  const set = (/** @type {string | undefined} */ cap) => {
    const { cap: _, ...others } = view.changes;
    view.changes = cap ? { ...others, cap } : others;
  };
  const on = checkbox("Fill cuts", false, (checked) => (begin(), set(checked ? shown.input.value : undefined)));
  on.row.title = "Close what cuts lay open: what a surface encloses looks solid";
  const follow = () => {
    on.input.checked = Boolean(view.changes.cap);
    if (view.changes.cap) shown.input.value = view.changes.cap;
    shown.row.hidden = !view.changes.cap;
  };
  following(view, follow);
  return [on.row, shown.row];
}

/** @param {RaysetView} view @param {() => void} begin */
function sectionBox(view, begin) {
  const [low, high] = view.bounds;
  const part = [[0, 1], [0, 1], [0, 1]];
  let on = false;
  const at = (/** @type {number} */ axis, /** @type {number} */ v) => (v === 1 ? high[axis] : low[axis] + v * (high[axis] - low[axis]));
  const apply = () => {
    const { section: _, ...others } = view.changes;
    if (!on) return void (view.changes = others);
    const corner = (/** @type {number} */ k) => /** @type {Vector} */ ([0, 1, 2].map((axis) => at(axis, part[axis][k])));
    view.changes = { ...others, section: { min: corner(0), max: corner(1) } };
  };
  const check = checkbox("Section box", false, (checked) => (begin(), (on = checked), apply()));
  check.row.title = "Show only what lies inside a box along the axes";
  const sliders = AXES.flatMap((name, axis) => [0, 1].map((end) => {
    // A thousandth of the scene is told apart, however far from the origin it lies.
    const digits = Math.min(Math.max(3 - Math.floor(Math.log10(high[axis] - low[axis] || 1)), 0), 12);
    const text = (/** @type {number} */ v) => at(axis, v).toFixed(digits);
    return slider(`${name} ${end ? "to" : "from"}`, [0, 1, THINNEST], end, (v) => {
      part[axis][end] = end ? Math.max(v, part[axis][0] + THINNEST) : Math.min(v, part[axis][1] - THINNEST);
      on = true;
      apply();
    }, text);
  }));
  const follow = () => {
    const box = view.changes.section;
    check.input.checked = on = Boolean(box);
    // Without a box, the sliders keep what it was.
    if (!box) return;
    for (let axis = 0; axis < 3; axis++) {
      [box.min, box.max].forEach((corner, end) => {
        const size = high[axis] - low[axis] || 1;
        part[axis][end] = Math.min(Math.max((corner[axis] - low[axis]) / size, 0), 1);
        sliders[2 * axis + end].set(part[axis][end]);
      });
    }
  };
  following(view, follow);
  const unit = view.unit ? [element("p", { class: "caption" }, [`Coordinates in ${view.unit}`])] : [];
  return element("div", {}, [check.row, ...sliders.map(({ row }) => row), ...unit]);
}

/** The box on the picture, with a handle on each of its faces. @param {RaysetView} view */
function sectionDrawing(view) {
  const box = view.changes.section;
  if (!box) return {};
  const [low, high] = view.bounds;
  const middle = scale(add(box.min, box.max), 0.5);
  /** @type {Handle[]} */
  const handles = AXES.flatMap((name, axis) => [0, 1].map((end) => {
    /** @type {Vector} */
    const at = [...middle];
    at[axis] = (end ? box.max : box.min)[axis];
    /** @type {Vector} */
    const along = [0, 0, 0];
    along[axis] = 1;
    const moved = (/** @type {Vector} */ by) => {
      const now = view.changes.section;
      if (!now) return;
      const least = THINNEST * (high[axis] - low[axis]);
      /** @type {[Vector, Vector]} */
      const ends = [[...now.min], [...now.max]];
      const wanted = Math.min(Math.max(ends[end][axis] + by[axis], low[axis]), high[axis]);
      ends[end][axis] = end ? Math.max(wanted, ends[0][axis] + least) : Math.min(wanted, ends[1][axis] - least);
      view.changes = { ...view.changes, section: { min: ends[0], max: ends[1] } };
    };
    return { name: `Section box, ${name} ${end ? "to" : "from"}`, at, axis: along, moved };
  }));
  return { lines: boxLines(middle, scale(subtract(box.max, box.min), 0.5), [[1, 0, 0], [0, 1, 0], [0, 0, 1]]), handles };
}

/** @param {RaysetView} view @param {() => void} begin */
function cutters(view, begin) {
  const list = element("div");
  const set = (/** @type {Cutter[]} */ all) => {
    const { cutters: _, ...others } = view.changes;
    view.changes = all.length ? { ...others, cutters: all } : others;
  };
  const adds = /** @type {(keyof typeof NAMES)[]} */ (["box", "ellipsoid", "cylinder"]).map((form) =>
    button(`Add a ${NAMES[form].toLowerCase()}`, () => {
      const all = view.changes.cutters ?? [];
      if (!view.camera || all.length >= MOST_CUTTERS) return;
      begin();
      const [low, high] = view.bounds;
      const edge = Math.max(...subtract(high, low)) / 3;
      // On the near side of what is looked at, so that it cuts something that is seen.
      const center = subtract(pivot(view.camera), scale(view.camera.direction, edge / 2));
      const inside = /** @type {Vector} */ (center.map((v, axis) => Math.min(Math.max(v, low[axis]), high[axis])));
      set([...all, { form, center: inside, size: [edge, edge, edge], turns: [], keep: false }]);
    }));
  /** The controls of each, and what they were built for. @type {{form: string, row: HTMLElement, set: (cutter: Cutter) => void}[]} */
  let built = [];
  const rebuild = () => {
    const all = view.changes.cutters ?? [];
    const isSame = all.length === built.length && all.every(({ form }, k) => form === built[k].form);
    if (!isSame) {
      built = all.map((cutter, k) => ({ form: cutter.form, ...solid(view, begin, cutter, k, set) }));
      list.replaceChildren(...built.map(({ row }) => row));
    }
    all.forEach((cutter, k) => built[k].set(cutter));
  };
  following(view, rebuild);
  adds.forEach((add) => (add.title = "Cut away what is inside of it; handles in the picture move and stretch it"));
  return element("div", {}, [buttons(adds), list]);
}

/** The controls of one solid. @param {RaysetView} view @param {() => void} begin @param {Cutter} cutter @param {number} k @param {(all: Cutter[]) => void} set */
function solid(view, begin, cutter, k, set) {
  const change = (/** @type {Partial<Cutter>} */ part) =>
    set((view.changes.cutters ?? []).map((each, i) => (i === k ? { ...each, ...part } : each)));
  const up = view.home?.up ?? [0, 1, 0];
  const side = sideways(up);
  const angles = () => {
    const turns = view.changes.cutters?.[k]?.turns ?? [];
    return { tilt: turns[0]?.degrees ?? 0, turn: turns[1]?.degrees ?? 0 };
  };
  const turnTo = (/** @type {{tilt: number, turn: number}} */ { tilt, turn }) =>
    change({ turns: tilt || turn ? [{ axis: side, degrees: tilt }, { axis: up, degrees: turn }] : [] });
  const degrees = (/** @type {number} */ v) => `${Math.round(v)}°`;
  const name = `${NAMES[cutter.form]} ${k + 1}`;
  const keep = checkbox("Keep what is inside", cutter.keep ?? false, (on) => (begin(), change({ keep: on })));
  const turn = slider("Turn", [-180, 180, 1], angles().turn, (v) => turnTo({ ...angles(), turn: v }), degrees);
  const tilt = slider("Tilt", [-90, 90, 1], angles().tilt, (v) => turnTo({ ...angles(), tilt: v }), degrees);
  keep.row.title = "Show only what is inside of it, and cut away all else";
  turn.row.title = "Turn it about the vertical";
  tilt.row.title = "Tilt it out of the vertical";
  const remove = button("Remove", () => (begin(), set((view.changes.cutters ?? []).filter((_, i) => i !== k))), `Remove ${name}`);
  const row = element("fieldset", {}, [element("legend", {}, [name]), keep.row, turn.row, tilt.row, buttons([remove])]);
  const show = (/** @type {Cutter} */ now) => {
    keep.input.checked = Boolean(now.keep);
    tilt.set(now.turns?.[0]?.degrees ?? 0);
    turn.set(now.turns?.[1]?.degrees ?? 0);
  };
  return { row, set: show };
}

/** A direction at right angles to what is up, along an axis of the world if up is. @param {Vector} up @returns {Vector} */
function sideways(up) {
  const least = [0, 1, 2].reduce((best, k) => (Math.abs(up[k]) < Math.abs(up[best]) ? k : best), 0);
  /** @type {Vector} */
  const axis = [0, 0, 0];
  axis[least] = 1;
  return unit(subtract(axis, scale(up, dot(axis, up))));
}

/** A solid's own axes in the world. @param {Cutter} cutter @returns {Vector[]} */
function axesOf(cutter) {
  /** @type {Vector[]} */
  const own = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
  return own.map((axis) => (cutter.turns ?? []).reduce((v, each) => turned(v, unit(each.axis), (each.degrees * Math.PI) / 180), axis));
}

/** A solid on the picture, with a handle that moves it, and one for each of its sizes. @param {RaysetView} view @param {Cutter} cutter @param {number} k */
function cutterDrawing(view, cutter, k) {
  const [low, high] = view.bounds;
  const least = THINNEST * Math.max(...subtract(high, low));
  const axes = axesOf(cutter);
  const name = `${NAMES[cutter.form]} ${k + 1}`;
  const change = (/** @type {(now: Cutter) => Cutter} */ how) => {
    view.changes = { ...view.changes, cutters: (view.changes.cutters ?? []).map((each, i) => (i === k ? how(each) : each)) };
  };
  /** @type {Handle[]} */
  const handles = [{ name: `${name}, place`, at: cutter.center, axis: null,
    moved: (by) => change((now) => ({ ...now, center: add(now.center, by) })) }];
  axes.forEach((axis, which) => handles.push({
    name: `${name}, size along ${AXES[which]}`,
    at: add(cutter.center, scale(axis, cutter.size[which] / 2)),
    axis,
    // The opposite side moves as far the other way.
    moved: (by) => change((now) => {
      /** @type {Vector} */
      const size = [...now.size];
      size[which] = Math.max(size[which] + 2 * dot(by, axis), least);
      return { ...now, size };
    }),
  }));
  const half = scale(cutter.size, 0.5);
  const lines = cutter.form === "box" ? boxLines(cutter.center, half, axes)
    : cutter.form === "cylinder" ? [...rings(cutter.center, half, axes, [[0, 2]], [-1, 1]), ...sides(cutter.center, half, axes)]
      : rings(cutter.center, half, axes, [[0, 1], [1, 2], [0, 2]], [0]);
  return { lines, handles };
}

/** A place in a solid's own coordinates, halves of its sizes. @param {Vector} center @param {Vector} half @param {Vector[]} axes @param {number[]} own */
const placed = (center, half, axes, own) =>
  own.reduce((at, v, k) => add(at, scale(axes[k], v * half[k])), center);

/** @param {Vector} center @param {Vector} half @param {Vector[]} axes @returns {[Vector, Vector][]} */
function boxLines(center, half, axes) {
  /** @type {[Vector, Vector][]} */
  const lines = [];
  for (let axis = 0; axis < 3; axis++) {
    for (const [u, v] of [[-1, -1], [-1, 1], [1, -1], [1, 1]]) {
      const ends = [-1, 1].map((w) => {
        const own = [0, 0, 0];
        [own[axis], own[(axis + 1) % 3], own[(axis + 2) % 3]] = [w, u, v];
        return placed(center, half, axes, own);
      });
      lines.push([ends[0], ends[1]]);
    }
  }
  return lines;
}

/**
 * Ellipses in planes of two axes, at places along the third.
 * @param {Vector} center @param {Vector} half @param {Vector[]} axes @param {number[][]} planes @param {number[]} along
 * @returns {[Vector, Vector][]}
 */
function rings(center, half, axes, planes, along) {
  const PIECES = 48;
  return planes.flatMap(([u, v]) => along.flatMap((w) => {
    const at = (/** @type {number} */ k) => {
      const own = [w, w, w];
      [own[u], own[v]] = [Math.cos((2 * Math.PI * k) / PIECES), Math.sin((2 * Math.PI * k) / PIECES)];
      return placed(center, half, axes, own);
    };
    return [...Array(PIECES).keys()].map((k) => /** @type {[Vector, Vector]} */ ([at(k), at(k + 1)]));
  }));
}

/** The sides of a cylinder. @param {Vector} center @param {Vector} half @param {Vector[]} axes @returns {[Vector, Vector][]} */
const sides = (center, half, axes) => [[1, 0], [0, 1], [-1, 0], [0, -1]].map(([x, z]) =>
  [placed(center, half, axes, [x, -1, z]), placed(center, half, axes, [x, 1, z])]);
