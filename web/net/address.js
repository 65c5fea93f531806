/** The view in the address bar: read on load, written shortly after a change, so a link shows the same picture. */

import { startAlbedo } from "../view/albedo.js";
import { NUMBERS } from "../view/model.js";

/** @typedef {import("../view/model.js").Knobs} Knobs */
/** @typedef {import("../view/model.js").ViewModel} ViewModel */
/** @typedef {import("./schemas.js").Scene} Scene */

const CHOICES = ["shading", "overlay", "compare", "tint"];
const PAUSE_MS = 150;

/**
 * Read knobs from an address. What is no number is left out; the view then takes the scene's default.
 * @param {string} search the part of the address from `?` on
 * @returns {{scene: string|null, start: Partial<Knobs>}}
 */
export function readAddress(search) {
  const query = new URLSearchParams(search);
  const numbers = NUMBERS.filter((name) => query.get(name)?.trim()).map((name) => [name, Number(query.get(name))]);
  const start = Object.fromEntries(numbers.filter(([, value]) => Number.isFinite(value)));
  const target = query.get("target");
  if (target !== null) start.target = target.split(",").map(Number);
  for (const name of CHOICES.filter((each) => query.has(each))) start[name] = query.get(name);
  return { scene: query.get("scene"), start };
}

/**
 * The address query of a view. The names are those of the frame request.
 * @param {Pick<Scene, "id"|"albedo"|"albedos">} scene
 * @param {Knobs} values knobs of the view
 * @returns {string}
 */
export function writeAddress(scene, values) {
  const query = new URLSearchParams({ scene: scene.id });
  for (const name of NUMBERS.filter((each) => each in values)) query.set(name, String(values[name]));
  if (values.target) query.set("target", values.target.join(","));
  if (values.tint !== undefined && values.tint !== startAlbedo(scene).tint) query.set("tint", values.tint);
  query.set("shading", values.shading);
  if (values.overlay !== "none") query.set("overlay", values.overlay);
  if (values.compare) query.set("compare", values.compare);
  return `?${query}`;
}

/**
 * Keep the address bar up with the view; browsers limit how often, so it waits for a short pause.
 * @param {Scene} scene
 * @param {ViewModel} view
 * @returns {() => string} writes what is due, at once, and gives the whole address
 */
export function followAddress(scene, view) {
  let timer = 0;
  const write = () => {
    clearTimeout(timer);
    history.replaceState(null, "", writeAddress(scene, view.values));
    return location.href;
  };
  view.subscribe(() => {
    clearTimeout(timer);
    timer = setTimeout(write, PAUSE_MS);
  });
  return write;
}
