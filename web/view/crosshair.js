/**
 * The cross hair of the slices beside the picture: its voxel, and the values that are black and
 * white in them.
 */

import { dot, vector } from "./rotation.js";

/** @typedef {import("./rotation.js").Vec3} Vec3 */
/** @typedef {[number, number]} Greys the values that are black and white, ascending */
/**
 * @typedef {{voxel: Vec3, greys: Greys|null}} CrossHair voxel indices, x first; of no `greys` the
 *   volume's own
 */

/**
 * A cross hair as the address has it, `x,y,z` or `x,y,z,black,white`.
 * @param {CrossHair} crossHair
 * @returns {string}
 */
export function writeCrossHair({ voxel, greys }) {
  return [...voxel, ...(greys ?? [])].join(",");
}

/**
 * A cross hair that an address has; null where it is none.
 * @param {string} text
 * @returns {CrossHair|null}
 */
export function readCrossHair(text) {
  const numbers = text.split(",").map((number) => (number.trim() ? Number(number) : NaN));
  const [x, y, z, black, white] = numbers;
  if (![3, 5].includes(numbers.length) || !numbers.every(Number.isFinite)) return null;
  if (numbers.length === 3) return { voxel: [x, y, z], greys: null };
  return black < white ? { voxel: [x, y, z], greys: [black, white] } : null;
}

/**
 * A cross hair at the voxel nearest to the one that is wanted; null where none is wanted.
 * @param {{size: Vec3}} volume
 * @param {CrossHair|null} wanted
 * @returns {CrossHair|null}
 */
export function limitCrossHair({ size }, wanted) {
  if (!wanted) return null;
  const voxel = vector((i) => Math.min(size[i] - 1, Math.max(0, Math.round(wanted.voxel[i]))));
  return { voxel, greys: wanted.greys };
}

/**
 * The world's point at voxel indices, with fractions too.
 * @param {{affine: number[][]}} volume
 * @param {Vec3} voxel
 * @returns {Vec3}
 */
export function worldOf({ affine }, voxel) {
  return vector((i) => dot(/** @type {Vec3} */ (affine[i].slice(0, 3)), voxel) + affine[i][3]);
}
