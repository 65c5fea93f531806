/** Where a published page begins: the camera that fits the stage, and the view that a link names. */

import { readAddress, writeAddress } from "../net/address.js";

/** @typedef {import("./files.js").Fit} Fit */
/** @typedef {import("./files.js").Published} Published */
/** @typedef {import("../view/model.js").Knobs} Knobs */
/** @typedef {import("../view/model.js").ViewModel} ViewModel */

const PAUSE_MS = 150; // browsers limit how often an address is written
const LEFT_OUT = ["scene", "shading", "background"]; // of addresses: a page has one of each
const PLACE = ["distance", "target"];

/**
 * The camera that sees the surface whole in a stage: that of the widest fit that is no wider than
 * the stage; in a stage that is narrower than all, from further away.
 * @param {Fit[]} fits from narrow to wide, one at least
 * @param {number} aspect width over height of the stage
 * @returns {Pick<Fit, "distance"|"target">}
 */
export function fitFor(fits, aspect) {
  const { distance, target, aspect: of } = fits.findLast((fit) => fit.aspect <= aspect) ?? fits[0];
  return { distance: distance * Math.max(1, of / aspect), target };
}

/**
 * The fits of a page: of a camera that was placed, the one of a square picture.
 * @param {Published["scene"]} scene
 * @returns {Fit[]}
 */
export function fitsOf({ fits, start }) {
  const { distance, target } = start;
  return fits.length ? fits : [{ aspect: 1, distance, target }];
}

/**
 * Fit the first camera to the stage, and the view where it has that camera.
 * @param {Published["scene"]} scene
 * @param {Fit[]} fits
 * @param {ViewModel} view
 * @param {{width: number, height: number}} size of the stage
 */
export function fitTo(scene, fits, view, { width, height }) {
  const fitted = isFitted(view);
  const fit = fitFor(fits, Math.max(width, 1) / Math.max(height, 1));
  Object.assign(scene.start, fit);
  if (fitted) view.set(fit, true);
}

/** Whether a view has the first camera's distance and target. @param {ViewModel} view */
function isFitted({ values, defaults }) {
  return PLACE.every(
    (name) => textOf(values, name) === textOf(defaults, name),
  );
}

/** @param {Knobs} values @param {string} name */
function textOf(values, name) {
  const value = /** @type {Record<string, unknown>} */ (/** @type {unknown} */ (values))[name];
  return JSON.stringify(value, (_, x) => (typeof x === "number" ? Number(x.toPrecision(6)) : x));
}

/**
 * The knobs that the page's address names.
 * @param {string} hash the part of the address from `#` on
 * @returns {Partial<Knobs>}
 */
export function readLink(hash) {
  return readAddress(hash.replace(/^#/, "?")).start;
}

/**
 * The part of an address that names a view, from `#` on. A camera that fits the stage is left out:
 * it fits that of the one who opens the link.
 * @param {Published["scene"]} scene
 * @param {ViewModel} view
 * @returns {string}
 */
export function linkOf(scene, view) {
  const query = new URLSearchParams(writeAddress(scene, view.values));
  LEFT_OUT.forEach((name) => query.delete(name));
  if (isFitted(view)) PLACE.forEach((name) => query.delete(name));
  return `#${query}`;
}

/**
 * Keep the address up with the view, and the view with an address that somebody writes.
 * @param {Published["scene"]} scene
 * @param {ViewModel} view
 */
export function followLink(scene, view) {
  let timer = 0;
  view.subscribe((_, follows) => {
    if (follows) return; // the stage has another size, and the view is the same
    clearTimeout(timer);
    timer = setTimeout(() => history.replaceState(null, "", linkOf(scene, view)), PAUSE_MS);
  });
  addEventListener("hashchange", () => view.set({ ...view.defaults, ...readLink(location.hash) }));
}
