/** All that a card needs to draw a scene: the object `scene` of `GET /v1/scenes/{scene}/card`; see docs/card.md. */

/** @typedef {[number, number, number]} Vec3 */

/**
 * @typedef {object} CardDocument
 * @property {{size: Vec3, spacing: Vec3, rotation: [Vec3, Vec3, Vec3], origin: Vec3, offset: number, smooth: boolean}} grid
 * @property {{offset: number, scale: number}} values value of the file = offset + scale · voxel
 * @property {{type: "uint8"|"uint16"|"float32", gain: number, base: number, hole: number|null, slabs: {first: number, last: number, href: string}[]}} volume
 *   voxel = base + gain · code; codes that are the hole have no value
 * @property {{size: Vec3, density: Vec3, chunk: number}} lattice
 * @property {{channels: number, columns: number, straight: number, ratios: boolean, whole: boolean, turns: boolean}} plan
 * @property {Lights} light
 * @property {{key: Vec3, sun: Vec3, ambient: Vec3}} lambert
 * @property {{gain: number, toe: number, shoulder: number}} tone
 */

/**
 * @typedef {object} Lights before they are turned, in the box
 * @property {number} unit the radiance that light is counted in
 * @property {{order: number, light: number[][]}[]} terms harmonics of each colour
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
