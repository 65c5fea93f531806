/**
 * All that a card needs to draw a scene: the object `scene` of `GET /v1/scenes/{scene}/card`,
 * described in docs/card.md.
 */

/** @typedef {[number, number, number]} Vec3 */
/** @typedef {import("../documents.js").CardScene} CardDocument */
/** @typedef {import("../documents.js").CardLight} Lights before they are turned, in the box */

/**
 * Convert an isovalue to a code of the card's volume.
 *
 * Each step rounds to single precision, as kernels do, so that page and server call the same voxels
 * solid: those above the isovalue.
 *
 * @param {CardDocument} document
 * @param {number} isovalue in the file's units
 * @returns {number}
 */
export function codeOf({ values, volume }, isovalue) {
  const voxel = Math.fround((isovalue - values.offset) / values.scale);
  return Math.fround((voxel - volume.base) / volume.gain);
}

/** Shadings that a card draws without light of texels. */
const LOCAL = ["lambert", "lambert_shadow", "lambert_fog", "phong", "phong_shadow"];

/** Return true if a card draws this shading without light of texels. @param {string} shading */
export const isLocal = (shading) => LOCAL.includes(shading);

/** Return true if a card draws this shading. @param {string} shading */
export const isDrawn = (shading) => shading === "gi" || isLocal(shading);

/**
 * Return the addresses of all slabs of a scene, in the order in which a card takes them: those of
 * the volume, then those of its colours, then its surroundings if it mirrors them.
 * @param {CardDocument} document
 * @returns {string[]}
 */
export function slabsOf({ volume, colours, shine }) {
  const mirrored = shine ? [shine.surroundings] : [];
  return [...volume.slabs, ...(colours?.slabs ?? []), ...mirrored].map(({ href }) => href);
}

/** Albedo of the brightest face of a window: PAPER in isogi_core/frame/framing.py. */
const PAPER = 0.8;

/**
 * Return the uniforms that paint the faces of a window.
 * @param {CardDocument} document
 * @returns {{greys: [number, number], paper: number}} factor and offset that turn a code into a
 *   grey, and the light of the brightest grey
 */
export function facesOf({ values, volume, exposure }) {
  const { core } = values;
  // Greys span the core of the volume's values, and not outliers; a constant volume must not divide
  // by 0.
  const span = Math.max(core[1] - core[0], Number.MIN_VALUE);
  const zero = values.offset + values.scale * volume.base - core[0];
  return { greys: [(values.scale * volume.gain) / span, zero / span], paper: PAPER / exposure };
}
