/** What the surfaces beside the one that slides let pass, as the frame's `surfaces` spells it: `0.4,off`. */

/** @typedef {{shown: boolean, clear: number}} Shown a surface: whether it is there, and the share of rays that passes */

const HIDDEN = "off";

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
