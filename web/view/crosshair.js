/**
 * The cross hair of the slices next to the picture: its voxel, and the values that are black and
 * white in the slices.
 */

import { dot, vector } from "./rotation.js";

/** @typedef {import("./rotation.js").Vec3} Vec3 */
/** @typedef {[number, number]} Greys the values that are black and white, ascending */
/**
 * @typedef {{voxel: Vec3, greys: Greys|null}} CrossHair voxel indices, x first; null in `greys`
 *   stands for the volume's defaults
 */

/**
 * Write a cross hair for the address: `x,y,z` or `x,y,z,black,white`.
 * @param {CrossHair} crossHair
 * @returns {string}
 */
export function writeCrossHair({ voxel, greys }) {
  return [...voxel, ...(greys ?? [])].join(",");
}

/**
 * Read a cross hair from the address; null if the text is none.
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
 * Move a cross hair to the nearest voxel of the volume; null remains null.
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
 * Return the point of the world at voxel indices, which may have fractions.
 * @param {{affine: number[][]}} volume
 * @param {Vec3} voxel
 * @returns {Vec3}
 */
export function worldOf({ affine }, voxel) {
  return vector((i) => dot(/** @type {Vec3} */ (affine[i].slice(0, 3)), voxel) + affine[i][3]);
}
