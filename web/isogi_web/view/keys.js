/** Keys, as changes of the view. The help in index.html lists the same keys. */

import { AXIS_VIEWS, pan } from "./camera.js";
import { niceStep, showNumber } from "./format.js";
import { dragObject } from "./gestures.js";
import { OVERLAYS, sliderRange } from "./model.js";
import { dragLight } from "./rotation.js";

/** @typedef {import("./model.js").ViewModel} ViewModel */
/** @typedef {import("../net/schemas.js").Scene} Scene */

const OBJECT_STEP = 5; // degrees
const LIGHT_STEP = 10; // degrees
const ZOOM_STEP = 1.12; // factor of the distance
const PAN_STEP = 0.05; // heights of the picture
const ISOVALUE_STEPS = 100; // steps through the slider's range, by { and }

/**
 * The direction of each arrow: right and down.
 * @type {Record<string, [number, number]>}
 */
export const ARROWS = {
  ArrowLeft: [-1, 0],
  ArrowRight: [1, 0],
  ArrowUp: [0, -1],
  ArrowDown: [0, 1],
};

/**
 * The direction in which keys of the isovalue slider go to the next stop: 1 is up.
 * @type {Record<string, 1|-1>}
 */
export const PAGES = { PageUp: 1, PageDown: -1 };

/** The direction in which letters move the picture. @type {Record<string, [number, number]>} */
const MOVES = { a: [-1, 0], d: [1, 0], w: [0, -1], s: [0, 1] };

/**
 * Listen to keys, unless another control needs them.
 * @param {Scene} scene
 * @param {ViewModel} view
 * @param {{toggleHelp: () => void, keys: Record<string, () => void>}} options `keys` are further
 *   actions, by lower-case letters
 */
export function attachKeys(scene, view, { toggleHelp, keys }) {
  // Letters act with and without the shift key, except those that differ by it.
  const capitals = Object.entries(keys).map(([key, action]) => [key.toUpperCase(), action]);
  /** @type {Record<string, () => void>} */
  const actions = {
    ...keyActions(scene, view, toggleHelp),
    ...keys,
    ...Object.fromEntries(capitals),
  };
  document.addEventListener("keydown", (event) => {
    const { target } = event;
    if (
      !(target instanceof Element) ||
      event.ctrlKey ||
      event.metaKey ||
      event.altKey ||
      takesText(target)
    )
      return;
    const action =
      event.key in ARROWS ? arrow(view, event, target, scene.turns) : actions[event.key];
    if (!action) return;
    event.preventDefault();
    action();
  });
}

/**
 * Return the action of each key, except for arrows, which depend on the focus.
 * @param {Scene} scene
 * @param {Pick<ViewModel, "values"|"set"|"reset">} view
 * @param {() => void} toggleHelp
 * @returns {Record<string, () => void>}
 */
export function keyActions(scene, view, toggleHelp) {
  const { min, max } = sliderRange(scene, "isovalue");
  // Steps of the isovalue are a hundredth of the slider, or go from stop to stop.
  const step = (max - min) / ISOVALUE_STEPS;
  /** @param {number} by */
  const shiftIsovalue = (by) =>
    view.set({ isovalue: Number(showNumber(view.values.isovalue + by, niceStep(step))) });
  /** @param {1|-1} way */
  const goToStop = (way) =>
    view.set({ isovalue: nextStop(scene.stops, view.values.isovalue, way) });
  /** @type {(right: number, down: number) => void} */
  const move = (right, down) =>
    view.set(pan(scene, view.values, right * PAN_STEP, down * PAN_STEP));
  /** @type {Record<string, () => void>} */
  const actions = {
    "+": () => view.set({ distance: view.values.distance / ZOOM_STEP }),
    "-": () => view.set({ distance: view.values.distance * ZOOM_STEP }),
    "[": () => goToStop(-1),
    "]": () => goToStop(1),
    "{": () => shiftIsovalue(-step),
    "}": () => shiftIsovalue(step),
    0: () => view.reset(),
    o: () => view.set({ overlay: next(OVERLAYS, view.values.overlay) }),
    "?": toggleHelp,
    ...Object.fromEntries(Object.entries(MOVES).map(([key, way]) => [key, () => move(...way)])),
    ...Object.fromEntries(
      Object.entries(AXIS_VIEWS).map(([axis, angles]) => [axisKey(axis), () => view.set(angles)]),
    ),
  };
  // Keys of the same meaning on other keyboards, and capital letters.
  actions["="] = actions["+"];
  actions["−"] = actions._ = actions["-"];
  for (const key of ["o", ...Object.keys(MOVES)]) actions[key.toUpperCase()] = actions[key];
  return actions;
}

/**
 * Return the next stop of the isovalue slider; the isovalue itself if there is none beyond it.
 * @param {number[]} stops ascending
 * @param {number} isovalue
 * @param {1|-1} way up or down
 * @returns {number}
 */
export function nextStop(stops, isovalue, way) {
  const next =
    way > 0 ? stops.find((stop) => stop > isovalue) : stops.findLast((stop) => stop < isovalue);
  return next ?? isovalue;
}

/**
 * Return the action of an arrow; null if the focus is not on the stage, or if the light cannot be
 * rotated.
 * @param {ViewModel} view
 * @param {KeyboardEvent} event
 * @param {Element} target
 * @param {boolean} lightTurns
 */
function arrow(view, event, target, lightTurns) {
  if (!target.closest("#stage") && target !== document.body) return null;
  const [right, down] = ARROWS[event.key];
  if (!event.shiftKey)
    return () => view.set(dragObject(view.values, right * OBJECT_STEP, down * OBJECT_STEP));
  return lightTurns
    ? () => view.set(dragLight(view.values, right * LIGHT_STEP, down * LIGHT_STEP))
    : null;
}

/**
 * Return the key of an axis view: x looks from plus x, and X, with shift, from minus x.
 * @param {string} name of the axis view
 */
function axisKey([sign, axis]) {
  return sign === "+" ? axis : axis.toUpperCase();
}

/**
 * Return the item after `one`, in a circle.
 * @template T
 * @param {T[]} all
 * @param {T} one
 */
function next(all, one) {
  return all[(all.indexOf(one) + 1) % all.length];
}

/** Return true if an element takes keys as text. @param {Element} target */
function takesText(target) {
  return target.matches("select, textarea, input:not([type=range], [type=checkbox])");
}
