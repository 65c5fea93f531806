/** All that a card needs to draw a scene: the object `scene` of `GET /v1/scenes/{scene}/card`; see docs/card.md. */

/** @typedef {[number, number, number]} Vec3 */

/**
 * @typedef {object} CardDocument
 * @property {{size: Vec3, spacing: Vec3, rotation: [Vec3, Vec3, Vec3], origin: Vec3, offset: number, smooth: boolean}} grid
 * @property {{offset: number, scale: number, core: [number, number]}} values value of the file = offset + scale · voxel;
 *   those of the core's ends are black and white on faces of a window
 * @property {{type: "uint8"|"uint16"|"float32", gain: number, base: number, hole: number|null, slabs: {first: number, last: number, href: string}[]}} volume
 *   voxel = base + gain · code; codes that are the hole have no value
 * @property {{size: Vec3, density: Vec3, chunk: number}} lattice
 * @property {{channels: number, columns: number, straight: number, ratios: boolean, whole: boolean, turns: boolean}} plan
 * @property {Lights} light
 * @property {{key: Vec3, sun: Vec3, ambient: Vec3}} lambert
 * @property {number} exposure the scene's own
 * @property {number} target relative error of final light
 * @property {number} expected relative error that the plan expects besides
 * @property {{gain: number, toe: number, shoulder: number}} tone
 */

/**
 * @typedef {object} Lights before they are turned, in the box
 * @property {number} unit the radiance that light is counted in
 * @property {{order: number, light: number[][], square: number[]}[]} terms harmonics of each colour, and of their luminance squared
 * @property {number[][]} sky harmonics of unshadowed light, of each colour
 * @property {Vec3} least
 * @property {{towards: Vec3, edges: [Vec3, Vec3], shine: Vec3}[]} lobes
 */

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
  const { core } = values, span = Math.max(core[1] - core[0], Number.MIN_VALUE), zero = values.offset + values.scale * volume.base - core[0];
  return { greys: [(values.scale * volume.gain) / span, zero / span], paper: PAPER / exposure };
}
