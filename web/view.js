/** The view that the page shows: one plain object of knobs, kept within what the scene allows. */

import { limitTarget } from "./camera.js";
import { isTint, surfaceOf } from "./surface.js";

/** Knobs that are numbers, in the order in which the address bar has them. */
export const NUMBERS = [
  "isovalue", "azimuth", "elevation", "distance", "fov", "yaw", "pitch", "roll", "albedo", "exposure",
];

/** Marks that may lie over the picture. */
export const OVERLAYS = ["none", "provisional", "error"];

const FULL_TURN = new Set(["azimuth", "yaw", "roll"]);
const LOGARITHMIC = new Set(["distance", "exposure"]);
const FALLBACK = {
  azimuth: [-180, 180], elevation: [-90, 90], distance: [0.2, 20], fov: [5, 100],
  yaw: [-180, 180], pitch: [-90, 90], roll: [-180, 180],
};

/**
 * What the slider of a knob spans. The server may allow more than is handy on a slider.
 * @param {object} scene answer of `readScene`
 * @param {string} name one of NUMBERS
 * @returns {{min: number, max: number, log: boolean}}
 */
export function sliderRange(scene, name) {
  const { min, max } = allowed(scene, name);
  if (FULL_TURN.has(name)) return { ...turn(min, max), log: false };
  const [low, high] = handy(scene, name) ?? [min, max];
  return { min: Math.max(min, low), max: Math.min(max, high), log: LOGARITHMIC.has(name) };
}

/**
 * A step that reads well, 1, 2 or 5 times a power of ten, and cuts a span into no more than so many parts.
 * @param {number} span
 * @param {number} [parts] as many positions as a slider has, unless told
 * @returns {number}
 */
export function niceStep(span, parts = 500) {
  const rough = span / parts;
  const power = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 5, 10].map((factor) => factor * power).find((step) => step >= rough * 0.999);
}

/**
 * A number with the digits that `step` can tell apart, and no more; any magnitude.
 * @param {number} value
 * @param {number} step
 * @returns {string}
 */
export function showNumber(value, step) {
  if (Math.abs(value) <= step * 1e-6) return "0";
  const digits = Math.ceil(Math.log10(Math.abs(value) / step) + 1e-9) + 2;
  return String(Number(value.toPrecision(Math.min(17, Math.max(1, digits)))));
}

/** Holds the view, limits every change to what the scene allows, and tells who listens. */
export class ViewModel {
  #scene;
  #values;
  #listeners = new Set();

  /**
   * @param {object} scene answer of `readScene`
   * @param {object} start knobs to start from; what is missing or has no meaning takes the scene's default
   */
  constructor(scene, start = {}) {
    this.#scene = scene;
    this.#values = this.#limited(start, this.defaults);
  }

  /** Where the scene starts: all knobs. */
  get defaults() {
    const { defaults } = this.#scene;
    const numbers = NUMBERS.filter((name) => Number.isFinite(defaults[name])).map((name) => [name, defaults[name]]);
    const shading = defaults.shading ?? this.#scene.shadings[0];
    return { ...Object.fromEntries(numbers), ...surfaceOf(this.#scene), target: null, shading, overlay: "none", compare: "" };
  }

  /** The knobs as they are now (a copy). */
  get values() {
    return { ...this.#values };
  }

  /**
   * Change some knobs; listeners hear of it only when something did change.
   * @param {object} patch
   */
  set(patch) {
    const next = this.#limited(patch, this.#values);
    if (Object.keys(next).every((name) => String(next[name]) === String(this.#values[name]))) return;
    this.#values = next;
    this.#listeners.forEach((listener) => listener(this.values));
  }

  /** Go back to where the scene starts. */
  reset() {
    this.set(this.defaults);
  }

  /**
   * Call `listener(values)` after every change.
   * @param {(values: object) => void} listener
   */
  subscribe(listener) {
    this.#listeners.add(listener);
  }

  /**
   * Call `listener(values)` after every change of a part of the view.
   * @param {(values: object) => object|string} part
   * @param {(values: object) => void} listener
   */
  watch(part, listener) {
    let seen = JSON.stringify(part(this.#values));
    this.subscribe((values) => {
      const now = JSON.stringify(part(values));
      if (now === seen) return;
      seen = now;
      listener(values);
    });
  }

  #limited(wanted, fallback) {
    const { shadings } = this.#scene;
    const chosen = (name, offered) => (offered.includes(wanted[name]) ? wanted[name] : fallback[name]);
    const limited = {
      shading: chosen("shading", shadings), overlay: chosen("overlay", OVERLAYS), compare: chosen("compare", ["", ...shadings]),
    };
    limited.target = limitTarget(this.#scene, wanted.target === undefined ? fallback.target : wanted.target);
    if (limited.compare === limited.shading) limited.compare = limited.shading === fallback.shading ? "" : fallback.shading;
    if (fallback.tint) limited.tint = isTint(wanted.tint) ? wanted.tint.toLowerCase() : fallback.tint;
    for (const name of NUMBERS.filter((each) => each in fallback)) {
      const value = Number.isFinite(wanted[name]) ? wanted[name] : fallback[name];
      const own = value === this.defaults[name]; // not rounded: the server's picture without this knob
      limited[name] = own ? value : limit(rounded(value, name), name, allowed(this.#scene, name));
    }
    return limited;
  }
}

function allowed(scene, name) {
  const range = scene.ranges?.[name];
  if (Number.isFinite(range?.min) && Number.isFinite(range?.max)) return range;
  const [min, max] = FALLBACK[name] ?? handy(scene, name) ?? scene.volume.value_range;
  return { min, max };
}

function handy(scene, name) {
  if (name !== "exposure") return FALLBACK[name];
  return [scene.defaults.exposure / 16, scene.defaults.exposure * 16];
}

/** Fine enough for any hand, and short enough that the address bar holds the view exactly. */
function rounded(value, name) {
  if (name === "isovalue") return value;
  return LOGARITHMIC.has(name) ? Number(value.toPrecision(4)) : Math.round(value * 100) / 100;
}

function turn(min, max) {
  const low = Math.max(min, -180);
  return { min: low, max: Math.min(max, low + 360) };
}

function limit(value, name, { min, max }) {
  if (FULL_TURN.has(name)) {
    const low = turn(min, max).min;
    const wrapped = value === low + 360 ? value : low + ((((value - low) % 360) + 360) % 360);
    return Math.min(max, rounded(wrapped, name));
  }
  return Math.min(max, Math.max(min, value));
}
