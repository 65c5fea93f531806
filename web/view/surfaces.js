/** What surfaces beside let pass, as the frame's `surfaces` spells it, `0.4,off`; which labels are hidden, as `hide` does, `3,4`. */

/** @typedef {{shown: boolean, clear: number}} Shown a surface: whether it is there, and the share of rays that passes */

/** @typedef {Pick<import("../net/schemas.js").Label, "value"|"shown">} Known a label of the scene, and whether that shows it */

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
  return parts.length === count && parts.every((part) => part === HIDDEN || /^(0|1|0?\.\d+|[01]\.0*)$/.test(part));
}

/**
 * What a text says of the scene's surfaces; their own where it says nothing. A hidden one keeps its own share.
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
  return hidden.every((value) => labels.some((label) => label.value === value)) && labels.some(({ value }) => !hidden.includes(value));
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
