/**
 * The view that the page shows: one plain object of knobs, limited to the values that the scene
 * allows.
 */

import { isTint, startAlbedo } from "./albedo.js";
import { PROJECTIONS, limitTarget } from "./camera.js";
import { niceStep, showNumber } from "./format.js";
import { limitCrossHair, limitMeasures, limitNotes } from "./measures.js";
import { arePlanes } from "./planes.js";
import { RULERS } from "./rulers.js";
import { areHidden, areSurfaces, isMaterial } from "./surfaces.js";

/** @typedef {import("./rotation.js").Vec3} Vec3 */
/** @typedef {import("../net/schemas.js").Scene} Scene */

/**
 * @typedef {Partial<Record<NumberKnob, number>> & Choices} Knobs everything that a visitor may
 *   choose of a view; knobs that the scene does not have are left out
 *
 * @typedef {object} Choices
 * @property {number} isovalue in the units of the file
 * @property {number} azimuth degrees
 * @property {number} elevation degrees
 * @property {number} distance of the eye from the target, in radii of the volume
 * @property {number} fov vertical field of view, degrees
 * @property {number} yaw of the light, degrees
 * @property {number} pitch of the light, degrees
 * @property {number} roll of the light, degrees
 * @property {number} exposure
 * @property {number} [albedo] only if the scene lets views choose it
 * @property {string} [tint] `#rrggbb`, colour that the albedo scales
 * @property {string} [shine] kind of shine, only if the scene has one
 * @property {Vec3|null} target point that the camera orbits, world units; null for the volume's
 *   centre
 * @property {string} projection one of PROJECTIONS
 * @property {string} shading
 * @property {string} overlay one of OVERLAYS
 * @property {string} compare the difference of the right side, as `readDifference` reads it, such as
 *   `phong`, `isovalue:90`, `time:7` or `scene:engine`; "" for no right side
 * @property {string} background one of BACKGROUNDS
 * @property {string} rulers one of RULERS: "on" if a scale bar and the axes are shown
 * @property {import("./measures.js").Measure[]} measures distances and angles in the world
 * @property {import("./measures.js").Notes} notes texts beside measures
 * @property {import("./measures.js").CrossHair|null} slices point in which the slices next to the
 *   picture cross; null for no slices
 * @property {string} environment the id of one of the scene's environments; "" for the scene's
 *   light
 * @property {string} planes planes that take matter away, as `planes.js` reads them; "" for none
 * @property {boolean} opened true if light comes in through planes along axes
 * @property {string} surfaces state of the pinned surfaces, as `surfaces.js` reads it; "" for the
 *   scene's defaults
 * @property {string} hide hidden labels, as `surfaces.js` reads them; "" for the scene's defaults
 * @property {string} material material of the surface, as `surfaces.js` reads it; "" for the
 *   scene's material
 */

/** Unit of each knob that is a number, in the order in which the address bar has the knobs. */
export const UNITS = {
  isovalue: "isovalue",
  azimuth: "degrees",
  elevation: "degrees",
  distance: "radii",
  fov: "degrees",
  yaw: "degrees",
  pitch: "degrees",
  roll: "degrees",
  albedo: "share",
  roughness: "share",
  strength: "share",
  glow: "share",
  time: "step",
  smooth: "voxels",
  exposure: "stops",
};

/** @typedef {keyof typeof UNITS} NumberKnob */

/** Knobs that are numbers, in that order. */
export const NUMBERS = /** @type {NumberKnob[]} */ (Object.keys(UNITS));

/**
 * @typedef {object} Difference what is different on the right side; all else is undefined
 * @property {string} [shading]
 * @property {number} [isovalue]
 * @property {number} [time]
 * @property {string} [scene] the id of another scene
 */

/** Knobs that are numbers, by which the two sides may differ. @type {("isovalue"|"time")[]} */
export const COMPARED_NUMBERS = ["isovalue", "time"];

/** Marks that may be drawn over the picture. */
export const OVERLAYS = ["none", "provisional", "error"];

/** Backgrounds of the picture: that of the page, or always the same. */
export const BACKGROUNDS = ["page", "dark", "light"];

/** Steps of smoothing per voxel: few, as each step is another volume with separate light. */
export const SMOOTH_STEPS = 4;

const FULL_TURN = new Set(["azimuth", "yaw", "roll"]); // angles that wrap around
const LOGARITHMIC = new Set(["distance", "exposure"]); // knobs with a logarithmic slider

/**
 * Ranges of knobs if the scene gives none.
 * @type {Partial<Record<NumberKnob, [number, number]>>}
 */
const FALLBACK = {
  azimuth: [-180, 180],
  elevation: [-90, 90],
  distance: [0.2, 20],
  fov: [5, 100],
  yaw: [-180, 180],
  pitch: [-90, 90],
  roll: [-180, 180],
  smooth: [0, 3],
};

/**
 * Return the range of a knob's slider. The server may allow more than is handy on a slider.
 * @param {Scene} scene
 * @param {NumberKnob} name
 * @returns {{min: number, max: number, log: boolean}}
 */
export function sliderRange(scene, name) {
  const { min, max } = allowed(scene, name);
  if (FULL_TURN.has(name)) return { ...turn(min, max), log: false };
  const [low, high] = handy(scene, name) ?? [min, max];
  return { min: Math.max(min, low), max: Math.min(max, high), log: LOGARITHMIC.has(name) };
}

/**
 * Read the text of a difference.
 * @param {Pick<Scene, "id"|"shadings"|"ranges"|"volume">} scene the scene on the left
 * @param {string|undefined} text
 * @returns {Difference|null} null if the scene cannot be compared so
 */
export function readDifference(scene, text = "") {
  if (scene.shadings.includes(text)) return { shading: text };
  const [, kind = "", value = ""] = /^(isovalue|time|scene):(.+)$/.exec(text) ?? [];
  if (kind === "scene") return value === scene.id ? null : { scene: value };
  const number = COMPARED_NUMBERS.find((each) => each === kind);
  const range = number && comparedRange(scene, number);
  const inside = range && Number(value) >= range.min && Number(value) <= range.max;
  return inside ? { [number]: Number(value) } : null;
}

/**
 * Return the range of a number by which sides may differ; null if the scene has no such knob.
 * @param {Pick<Scene, "ranges"|"volume">} scene
 * @param {"isovalue"|"time"} name
 * @returns {{min: number, max: number}|null}
 */
export function comparedRange({ ranges, volume }, name) {
  const [low, high] = volume.value_range;
  const range = ranges[name] ?? (name === "isovalue" ? { min: low, max: high } : null);
  return range && range.max > range.min ? range : null;
}

/** Holds the view, limits every change to the values that the scene allows, and calls listeners. */
export class ViewModel {
  #scene;
  /** @type {Knobs} */
  #values;
  /** @type {Set<(values: Knobs, follows: boolean) => void>} */
  #listeners = new Set();

  /**
   * @param {Scene} scene
   * @param {Partial<Knobs>} start first knobs; missing and invalid ones take the scene's defaults
   */
  constructor(scene, start = {}) {
    this.#scene = scene;
    this.#values = this.#limited(start, this.defaults);
  }

  /** Return all knobs at the start of the scene. @returns {Knobs} */
  get defaults() {
    const { start } = this.#scene;
    const defaults = { ...this.#scene.defaults, ...start };
    // Numbers of the scene's defaults and of its first camera; everything else is off or empty.
    const numbers = NUMBERS.filter((name) => Number.isFinite(defaults[name])).map((name) => [
      name,
      defaults[name],
    ]);
    const shading = defaults.shading ?? this.#scene.shadings[0];
    const shine = defaults.shine === undefined ? {} : { shine: defaults.shine };
    const projection = this.#scene.defaults.projection ?? PROJECTIONS[0];
    return {
      ...Object.fromEntries(numbers),
      ...startAlbedo(this.#scene),
      ...shine,
      target: start.target,
      projection,
      shading,
      overlay: "none",
      compare: "",
      background: BACKGROUNDS.find((each) => each === start.background) ?? "page",
      environment: "",
      rulers: "on",
      measures: [],
      notes: {},
      slices: null,
      planes: "",
      opened: this.#scene.cuts,
      surfaces: "",
      hide: "",
      material: "",
    };
  }

  /** Return a copy of the current knobs. @returns {Knobs} */
  get values() {
    return { ...this.#values };
  }

  /**
   * Change some knobs. Listeners are called only if something has changed.
   * @param {Partial<Knobs>} patch
   * @param {boolean} [follows] true if another change causes this one, so that it is no new view in
   *   the history
   */
  set(patch, follows = false) {
    const next = this.#limited(patch, this.#values);
    const names = /** @type {(keyof Knobs)[]} */ (Object.keys(next));
    if (names.every((name) => JSON.stringify(next[name]) === JSON.stringify(this.#values[name])))
      return;
    this.#values = next;
    this.#listeners.forEach((listener) => listener(this.values, follows));
  }

  /** Go back to the start of the scene; measures and slices are kept. */
  reset() {
    const { measures, notes, slices } = this.#values;
    this.set({ ...this.defaults, measures, notes, slices });
  }

  /**
   * Call `listener(values, follows)` after every change; see `set`.
   * @param {(values: Knobs, follows: boolean) => void} listener
   */
  subscribe(listener) {
    this.#listeners.add(listener);
  }

  /**
   * Call `listener(values)` after every change of a part of the view.
   * @param {(values: Knobs) => unknown} part returns the part, which is compared as JSON
   * @param {(values: Knobs) => void} listener
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

  /**
   * Return the knobs after a change, limited to the values that the scene allows.
   * @param {Partial<Knobs>} wanted the change
   * @param {Knobs} fallback knobs that replace missing and invalid ones
   * @returns {Knobs}
   */
  #limited(wanted, fallback) {
    // Names and texts: those that the scene does not offer keep their former value.
    const limited = { ...fallback, ...this.#choices(wanted, fallback) };
    limited.target = limitTarget(
      this.#scene,
      wanted.target === undefined ? fallback.target : wanted.target,
    );
    limited.planes =
      wanted.planes === "" || arePlanes(wanted.planes) ? wanted.planes : fallback.planes;
    limited.opened = this.#scene.cuts && (wanted.opened ?? fallback.opened);
    const fits =
      wanted.surfaces === "" || areSurfaces(wanted.surfaces, this.#scene.surfaces?.length ?? 0);
    limited.surfaces = fits ? /** @type {string} */ (wanted.surfaces) : fallback.surfaces;
    const hidden = wanted.hide === "" || areHidden(wanted.hide, this.#scene.colours?.labels ?? []);
    limited.hide = hidden ? /** @type {string} */ (wanted.hide) : fallback.hide;
    const made = wanted.material === "" || isMaterial(wanted.material, this.#scene.materials ?? []);
    limited.material = made ? /** @type {string} */ (wanted.material) : fallback.material;
    limited.measures = limitMeasures(wanted.measures ?? fallback.measures);
    limited.notes = limitNotes(wanted.notes ?? fallback.notes, limited.measures);
    limited.slices = limitCrossHair(
      this.#scene.volume,
      wanted.slices === undefined ? fallback.slices : wanted.slices,
    );
    if (fallback.shine)
      limited.shine = this.#scene.shines.find((each) => each === wanted.shine) ?? fallback.shine;
    if (fallback.tint)
      limited.tint = isTint(wanted.tint) ? wanted.tint.toLowerCase() : fallback.tint;

    // Numbers: round them to their sliders, and limit them to the scene's ranges.
    for (const name of NUMBERS.filter((each) => each in fallback)) {
      const value = /** @type {number} */ (
        Number.isFinite(wanted[name]) ? wanted[name] : fallback[name]
      );
      // A value that equals the default on the slider becomes the default, unrounded: the server
      // then draws the same picture as without this knob.
      const usual = /** @type {number} */ (this.defaults[name]);
      const isDefault = inShort(this.#scene, name, value) === inShort(this.#scene, name, usual);
      limited[name] = isDefault
        ? usual
        : limit(rounded(value, name), name, allowed(this.#scene, name));
    }
    return limited;
  }

  /**
   * Return the knobs that are one of several names. A shading is not compared with itself: it is
   * compared with the one before instead.
   * @param {Partial<Knobs>} wanted
   * @param {Knobs} fallback
   */
  #choices(wanted, fallback) {
    /**
     * @type {(name: "shading"|"overlay"|"background"|"environment"|"rulers"|"projection",
     *   offered: string[]) => string}
     */
    const chosen = (name, offered) =>
      offered.find((each) => each === wanted[name]) ?? fallback[name];
    const { shadings, environments = [] } = this.#scene;
    // Keep the former name if the scene does not offer the new one.
    const shading = chosen("shading", shadings);
    const { compare: asked = fallback.compare } = wanted;
    const known = asked === "" || readDifference(this.#scene, asked);
    const compare = known ? asked : fallback.compare;
    const other = shading === fallback.shading ? "" : fallback.shading;
    const background = chosen("background", BACKGROUNDS);
    const environment = chosen("environment", ["", ...environments.map(({ id }) => id)]);
    return {
      shading,
      background,
      environment,
      rulers: chosen("rulers", RULERS),
      projection: chosen("projection", PROJECTIONS),
      overlay: chosen("overlay", OVERLAYS),
      compare: compare === shading ? other : compare,
    };
  }
}

/**
 * Return the range that the scene allows for a knob.
 * @param {Scene} scene
 * @param {NumberKnob} name
 * @returns {{min: number, max: number}}
 */
function allowed(scene, name) {
  const range = scene.ranges?.[name];
  if (range && Number.isFinite(range.min) && Number.isFinite(range.max)) return range;
  const [min, max] = FALLBACK[name] ?? handy(scene, name) ?? scene.volume.value_range;
  return { min, max };
}

/**
 * Return a range that is handy on a slider, if one is known.
 * @param {Scene} scene
 * @param {NumberKnob} name
 * @returns {[number, number]|undefined}
 */
function handy(scene, name) {
  if (name !== "exposure") return FALLBACK[name];
  return [scene.defaults.exposure / 16, scene.defaults.exposure * 16];
}

/**
 * Round a knob's value to the digits that its slider can tell apart, and one more.
 * @param {Scene} scene
 * @param {NumberKnob} name
 * @param {number} value
 * @returns {number}
 */
export function inShort(scene, name, value) {
  const { min, max } = allowed(scene, name);
  return name === "isovalue" && max > min
    ? Number(showNumber(value, niceStep(max - min)))
    : rounded(value, name);
}

/**
 * Round a knob's value: finely enough for any hand, and so short that the address bar holds the
 * view exactly.
 * @param {number} value
 * @param {NumberKnob} name
 */
function rounded(value, name) {
  if (name === "isovalue") return value;
  if (name === "time") return Math.round(value);
  if (name === "smooth") return Math.round(value * SMOOTH_STEPS) / SMOOTH_STEPS;
  return LOGARITHMIC.has(name) ? Number(value.toPrecision(4)) : Math.round(value * 100) / 100;
}

/**
 * Return the range of an angle that wraps around: 360 degrees at most.
 * @param {number} min
 * @param {number} max
 */
function turn(min, max) {
  const low = Math.max(min, -180);
  return { min: low, max: Math.min(max, low + 360) };
}

/**
 * Limit a knob's value to a range; angles that wrap around are moved by full turns.
 * @param {number} value
 * @param {NumberKnob} name
 * @param {{min: number, max: number}} range
 */
function limit(value, name, { min, max }) {
  if (FULL_TURN.has(name)) {
    const low = turn(min, max).min;
    const wrapped = value === low + 360 ? value : low + ((((value - low) % 360) + 360) % 360);
    return Math.min(max, rounded(wrapped, name));
  }
  return Math.min(max, Math.max(min, value));
}
