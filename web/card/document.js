/**
 * All that a card needs to draw a scene: the object `scene` of `GET /v1/scenes/{scene}/card`; see
 * docs/card.md.
 */

/** @typedef {[number, number, number]} Vec3 */
/** @typedef {import("../documents.js").CardScene} CardDocument */
/** @typedef {import("../documents.js").CardLight} Lights before they are turned, in the box */

/**
 * An isovalue of the file's units as a code, as kernels compare it: solid is what is greater.
 * @param {CardDocument} document
 * @param {number} isovalue
 * @returns {number}
 */
export function codeOf({ values, volume }, isovalue) {
  const voxel = Math.fround((isovalue - values.offset) / values.scale);
  return Math.fround((voxel - volume.base) / volume.gain);
}

/** The most that a face of a window reflects: PAPER in isogi_core/frame/framing.py. */
const PAPER = 0.8;

/**
 * Uniforms of the faces of a window: the greys of codes, and the light of the brightest.
 * @param {CardDocument} document
 * @returns {{greys: [number, number], paper: number}}
 */
export function facesOf({ values, volume, exposure }) {
  const { core } = values;
  const span = Math.max(core[1] - core[0], Number.MIN_VALUE);
  const zero = values.offset + values.scale * volume.base - core[0];
  return { greys: [(values.scale * volume.gain) / span, zero / span], paper: PAPER / exposure };
}
