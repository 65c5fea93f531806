/**
 * The texts of a frame's parameters `surfaces` (what pinned surfaces let pass, `0.4,off`), `hide`
 * (labels, `3,4`) and `material` (`glass,index=1.3`).
 */

import { WHITE, hexOf, linear } from "./albedo.js";

/**
 * @typedef {{shown: boolean, clear: number}} Shown a pinned surface: true if it is shown, and the
 *   share of rays that passes it
 */

/**
 * @typedef {Pick<import("../documents.js").Label, "value"|"shown">} Known a label of the scene;
 *   true if it is shown by default
 */

/** @typedef {import("../documents.js").Material} Material */

/** @typedef {{material: string, materials: Material[]}} Choice the scene's material, and all */

/**
 * @typedef {{kind: string, numbers: Record<string, number[]>}} Made a material with all of its
 *   numbers
 */

const HIDDEN = "off"; // state of a hidden surface
const NONE = "none"; // text that hides no label

/**
 * Return true if a text gives the state of `count` surfaces.
 * @param {unknown} text
 * @param {number} count of surfaces
 * @returns {text is string}
 */
export function areSurfaces(text, count) {
  if (typeof text !== "string" || !count) return false;
  const parts = text.split(",");
  return (
    parts.length === count &&
    parts.every((part) => part === HIDDEN || /^(0|1|0?\.\d+|[01]\.0*)$/.test(part))
  );
}

/**
 * Read the state of pinned surfaces; the scene's defaults if the text is not valid. A hidden
 * surface keeps the scene's share.
 * @param {string} text
 * @param {{clear: number}[]} surfaces surfaces of the scene
 * @returns {Shown[]}
 */
export function readSurfaces(text, surfaces) {
  const parts = areSurfaces(text, surfaces.length) ? text.split(",") : [];
  return surfaces.map(({ clear }, k) => {
    const part = parts[k] ?? "";
    return { shown: part !== HIDDEN, clear: part && part !== HIDDEN ? Number(part) : clear };
  });
}

/**
 * Write the state of pinned surfaces; "" if it equals the scene's defaults.
 * @param {Shown[]} shown
 * @param {{clear: number}[]} surfaces surfaces of the scene
 * @returns {string}
 */
export function writeSurfaces(shown, surfaces) {
  if (shown.every(({ shown: there, clear }, k) => there && clear === surfaces[k].clear)) return "";
  return shown.map(({ shown: there, clear }) => (there ? String(clear) : HIDDEN)).join(",");
}

/**
 * Return true if a text lists labels of the scene, and leaves at least one that is shown.
 * @param {unknown} text
 * @param {Known[]} labels labels of the scene
 * @returns {text is string}
 */
export function areHidden(text, labels) {
  if (typeof text !== "string" || !labels.length) return false;
  const hidden = valuesIn(text);
  return (
    hidden.every((value) => labels.some((label) => label.value === value)) &&
    labels.some(({ value }) => !hidden.includes(value))
  );
}

/**
 * Return the values of the labels that a text hides; those that the scene hides if the text is
 * empty.
 * @param {string} text
 * @param {Known[]} labels labels of the scene
 * @returns {number[]}
 */
export function readHidden(text, labels) {
  return text ? valuesIn(text) : labels.filter(({ shown }) => !shown).map(({ value }) => value);
}

/**
 * Write the labels that are hidden; "" if they equal the scene's defaults.
 * @param {number[]} hidden values of labels
 * @param {Known[]} labels labels of the scene
 * @returns {string}
 */
export function writeHidden(hidden, labels) {
  if (labels.every(({ value, shown }) => shown !== hidden.includes(value))) return "";
  return [...hidden].sort((a, b) => a - b).join(",") || NONE;
}

/** Read the values of a list. @param {string} text */
function valuesIn(text) {
  return text === NONE ? [] : text.split(",").map((part) => (part.trim() ? Number(part) : NaN));
}

/**
 * Return true if a text spells a material that the scene allows, with numbers that the material
 * has.
 * @param {unknown} text
 * @param {Material[]} materials all materials of the scene
 * @returns {text is string}
 */
export function isMaterial(text, materials) {
  const made = typeof text === "string" ? parsed(text) : null;
  const known = materials.find(({ kind, refused }) => !refused && kind === made?.kind);
  if (!made || !known) return false;
  return Object.entries(made.numbers).every(
    ([name, given]) => name in known.numbers && given.every(Number.isFinite),
  );
}

/**
 * Read a material; the scene's material if the text is not valid. Numbers that the text leaves out
 * take their defaults.
 * @param {string} text
 * @param {Choice} scene
 * @returns {Made}
 */
export function readMaterial(text, { material, materials }) {
  const { kind, numbers } = parsed(isMaterial(text, materials) ? text : material);
  return { kind, numbers: { ...usual(kind, materials), ...numbers } };
}

/**
 * Write a material with the numbers that differ from their defaults; "" if it is the scene's
 * material.
 * @param {Made} made
 * @param {Choice} scene
 * @returns {string}
 */
export function writeMaterial({ kind, numbers }, { material, materials }) {
  const defaults = usual(kind, materials);
  const others = Object.entries(numbers).filter(
    ([name, given]) => spelled(given) !== spelled(defaults[name] ?? []),
  );
  if (!others.length && kind === parsed(material).kind) return "";
  return [kind, ...others.map(([name, given]) => `${name}=${spelled(given)}`)].join(",");
}

/**
 * Return the knobs that have no effect on a surface of another material than the scene's: albedo
 * and tint, and the light's rotation if light is scattered inside.
 * @param {string} text spells the material; "" for the scene's
 * @returns {string[]}
 */
export function idleKnobs(text) {
  if (!text) return [];
  return parsed(text).kind === "subsurface"
    ? ["albedo", "tint", "yaw", "pitch", "roll"]
    : ["albedo", "tint"];
}

/**
 * Return the defaults of a material's numbers.
 * @type {(kind: string, materials: Material[]) => Made["numbers"]}
 */
function usual(kind, materials) {
  const numbers = Object.entries(materials.find((each) => each.kind === kind)?.numbers ?? {});
  return Object.fromEntries(numbers.map(([name, given]) => [name, [given].flat()]));
}

/** Write numbers; three equal ones become one. @param {number[]} numbers */
function spelled(numbers) {
  return (new Set(numbers).size === 1 ? numbers.slice(0, 1) : numbers).join(",");
}

/**
 * Split the text of a material into its kind and its numbers; a part without a name continues the
 * number before.
 * @param {string} text
 * @returns {Made}
 */
function parsed(text) {
  const [kind, ...parts] = text.split(",");
  /** @type {Made["numbers"]} */
  const numbers = {};
  let last = "";
  for (const part of parts) {
    const at = part.indexOf("=");
    if (at > 0) last = part.slice(0, at);
    const value = part.slice(at + 1);
    (numbers[last] ??= []).push(value.trim() ? Number(value) : NaN);
  }
  return { kind, numbers };
}

/** Optical depth, in the colour that is absorbed most, at which the tint of a material is seen. */
const DEEP = 3;

/**
 * Return the colour of white light after it passed an absorbing material, as bright as possible;
 * white if all colours are absorbed equally.
 * @param {number[]} absorption one number, or one per colour
 * @returns {string}
 */
export function tintOf(absorption) {
  const [most, least] = [Math.max(...absorption), Math.min(...absorption)];
  const [red, green = red, blue = red] = absorption;
  // Attenuate white light by Beer and Lambert's law, scaled so that the clearest colour is 1.
  return most > least
    ? hexOf([red, green, blue].map((each) => Math.exp((DEEP * (least - each)) / most)))
    : WHITE;
}

/**
 * Return the absorption of each colour relative to the largest, for a material of this tint: the
 * inverse of `tintOf`.
 * @param {string} tint
 * @returns {number[]}
 */
export function absorbedShares(tint) {
  const shares = linear(tint);
  const most = Math.max(...shares);
  // The optical depth of each colour relative to the brightest, DEEP at most.
  const depths = shares.map((share) => (most > 0 ? Math.min(Math.log(most / share), DEEP) : 0));
  const deepest = Math.max(...depths);
  return depths.map((depth) => 1 - (deepest - depth) / DEEP);
}
