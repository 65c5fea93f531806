/**
 * The first view of a published page: the camera that fits the stage, and the view that a link
 * names.
 */

import { readAddress, writeAddress } from "../net/address.js";

/** @typedef {import("./files.js").Fit} Fit */
/** @typedef {import("./files.js").Published} Published */
/** @typedef {import("../view/model.js").Knobs} Knobs */
/** @typedef {import("../view/model.js").ViewModel} ViewModel */

const PAUSE_MS = 150; // pause before the address is written: browsers limit how often pages may
const LEFT_OUT = ["scene", "shading", "background"]; // parameters with one value in the page
const PLACE = ["distance", "target"]; // knobs that fit the camera to the stage

/**
 * Return the camera that sees the whole surface in a stage: that of the widest fit that the stage
 * can hold, or in a stage that is narrower than all of them, the narrowest one from further away.
 * @param {Fit[]} fits from narrow to wide, at least one
 * @param {number} aspect width over height of the stage
 * @returns {Pick<Fit, "distance"|"target">}
 */
export function fitFor(fits, aspect) {
  const { distance, target, aspect: of } = fits.findLast((fit) => fit.aspect <= aspect) ?? fits[0];
  return { distance: distance * Math.max(1, of / aspect), target };
}

/**
 * Return the fits of a page; a scene that places its camera has one fit, for a square.
 * @param {Published["scene"]} scene
 * @returns {Fit[]}
 */
export function fitsOf({ fits, start }) {
  const { distance, target } = start;
  return fits.length ? fits : [{ aspect: 1, distance, target }];
}

/**
 * Fit the first camera to the stage, and the view too if it has that camera.
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

/** Return true if a view has distance and target of the first camera. @param {ViewModel} view */
function isFitted({ values, defaults }) {
  return PLACE.every(
    (name) => textOf(values, name) === textOf(defaults, name),
  );
}

/**
 * Return a knob as a text of six digits, for comparison.
 * @param {Knobs} values
 * @param {string} name
 */
function textOf(values, name) {
  const value = /** @type {Record<string, unknown>} */ (/** @type {unknown} */ (values))[name];
  return JSON.stringify(value, (_, x) => (typeof x === "number" ? Number(x.toPrecision(6)) : x));
}

/**
 * Read the knobs that the page's address names.
 * @param {string} hash the part of the address from `#` on
 * @returns {Partial<Knobs>}
 */
export function readLink(hash) {
  return readAddress(hash.replace(/^#/, "?")).start;
}

/**
 * Write the part of an address that names a view, from `#` on. A camera that fits the stage is left
 * out, so that it fits the stage of the person who opens the link.
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
 * Keep the address up to date with the view, and the view with an address that the visitor enters.
 * @param {Published["scene"]} scene
 * @param {ViewModel} view
 */
export function followLink(scene, view) {
  let timer = 0;
  view.subscribe((_, follows) => {
    if (follows) return; // only the stage has changed its size
    clearTimeout(timer);
    timer = setTimeout(() => history.replaceState(null, "", linkOf(scene, view)), PAUSE_MS);
  });
  addEventListener("hashchange", () => view.set({ ...view.defaults, ...readLink(location.hash) }));
}
