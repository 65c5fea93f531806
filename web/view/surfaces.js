/**
 * What a frame's `surfaces` lets pass, `0.4,off`, which labels its `hide` hides, `3,4`, and its
 * `material`, `glass,index=1.3`.
 */

import { WHITE, hexOf, linear } from "./albedo.js";

/**
 * @typedef {{shown: boolean, clear: number}} Shown a surface: whether it is there, and the share of
 *   rays that passes
 */

/**
 * @typedef {Pick<import("../documents.js").Label, "value"|"shown">} Known a label of the scene, and
 *   whether that shows it
 */

/** @typedef {import("../documents.js").Material} Material */

/** @typedef {{material: string, materials: Material[]}} Choice the scene's own material, and all */

/**
 * @typedef {{kind: string, numbers: Record<string, number[]>}} Made what a surface is made of, with
 *   all numbers of that
 */

const HIDDEN = "off";
const NONE = "none"; // of the labels is hidden

/**
 * Whether a text says for each of some surfaces what it lets pass.
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
 * What a text says of the scene's surfaces; their own where it says nothing. A hidden one keeps its
 * own share.
 * @param {string} text
 * @param {{clear: number}[]} surfaces the scene's
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
 * The text that says it; "" where all are as the scene has them.
 * @param {Shown[]} shown
 * @param {{clear: number}[]} surfaces the scene's
 * @returns {string}
 */
export function writeSurfaces(shown, surfaces) {
  if (shown.every(({ shown: there, clear }, k) => there && clear === surfaces[k].clear)) return "";
  return shown.map(({ shown: there, clear }) => (there ? String(clear) : HIDDEN)).join(",");
}

/**
 * Whether a text says which of some labels are hidden, and leaves one that is shown.
 * @param {unknown} text
 * @param {Known[]} labels the scene's
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
 * The values of the labels that a text hides; those of the scene's own where it says nothing.
 * @param {string} text
 * @param {Known[]} labels the scene's
 * @returns {number[]}
 */
export function readHidden(text, labels) {
  return text ? valuesIn(text) : labels.filter(({ shown }) => !shown).map(({ value }) => value);
}

/**
 * The text that hides some labels; "" where they are those that the scene hides.
 * @param {number[]} hidden their values
 * @param {Known[]} labels the scene's
 * @returns {string}
 */
export function writeHidden(hidden, labels) {
  if (labels.every(({ value, shown }) => shown !== hidden.includes(value))) return "";
  return [...hidden].sort((a, b) => a - b).join(",") || NONE;
}

/** @param {string} text */
function valuesIn(text) {
  return text === NONE ? [] : text.split(",").map((part) => (part.trim() ? Number(part) : NaN));
}

/**
 * Whether a text says a material that the scene may be of, and numbers of it.
 * @param {unknown} text
 * @param {Material[]} materials all of the scene's
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
 * What a text says the surface is made of; the scene's own where it says nothing, as do numbers
 * that it leaves out.
 * @param {string} text
 * @param {Choice} scene
 * @returns {Made}
 */
export function readMaterial(text, { material, materials }) {
  const { kind, numbers } = parsed(isMaterial(text, materials) ? text : material);
  return { kind, numbers: { ...usual(kind, materials), ...numbers } };
}

/**
 * The text that says it; "" where it is the scene's own.
 * @param {Made} made
 * @param {Choice} scene
 * @returns {string}
 */
export function writeMaterial({ kind, numbers }, { material, materials }) {
  const own = usual(kind, materials);
  const others = Object.entries(numbers).filter(
    ([name, given]) => spelled(given) !== spelled(own[name] ?? []),
  );
  if (!others.length && kind === parsed(material).kind) return "";
  return [kind, ...others.map(([name, given]) => `${name}=${spelled(given)}`)].join(",");
}

/**
 * Knobs that say nothing of a surface of another material than the scene's: what it reflects, and,
 * where light is
 * scattered inside, how that turns.
 * @param {string} text
 * @returns {string[]}
 */
export function idleKnobs(text) {
  if (!text) return [];
  return parsed(text).kind === "subsurface"
    ? ["albedo", "tint", "yaw", "pitch", "roll"]
    : ["albedo", "tint"];
}

/**
 * The numbers of a material where nothing else is said.
 * @type {(kind: string, materials: Material[]) => Made["numbers"]}
 */
function usual(kind, materials) {
  const numbers = Object.entries(materials.find((each) => each.kind === kind)?.numbers ?? {});
  return Object.fromEntries(numbers.map(([name, given]) => [name, [given].flat()]));
}

/** Three equal numbers are one. @param {number[]} numbers */
function spelled(numbers) {
  return (new Set(numbers).size === 1 ? numbers.slice(0, 1) : numbers).join(",");
}

/** @param {string} text @returns {Made} */
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

// so deep light is looked at that e^-DEEP is left of the colour that is absorbed most
const DEEP = 3;

/**
 * The colour of white light that went deep into what absorbs it, as bright as can be; white where
 * all is absorbed alike.
 * @param {number[]} absorption one number, or one for each colour
 * @returns {string}
 */
export function tintOf(absorption) {
  const [most, least] = [Math.max(...absorption), Math.min(...absorption)];
  const [red, green = red, blue = red] = absorption;
  return most > least
    ? hexOf([red, green, blue].map((each) => Math.exp((DEEP * (least - each)) / most)))
    : WHITE;
}

/**
 * How much of each colour what has this tint absorbs, of what it absorbs most: the inverse of
 * `tintOf`.
 * @param {string} tint
 * @returns {number[]}
 */
export function absorbedShares(tint) {
  const shares = linear(tint);
  const most = Math.max(...shares);
  const depths = shares.map((share) => (most > 0 ? Math.min(Math.log(most / share), DEEP) : 0));
  const deepest = Math.max(...depths);
  return depths.map((depth) => 1 - (deepest - depth) / DEEP);
}
