/**
 * The values on a slice: read from an `npy` file, oriented as on the screen, painted grey, and kept
 * for a while.
 */

import { readRows } from "../view/npy.js";

/** @typedef {import("../view/measures.js").Greys} Greys */
/** @typedef {import("./geometry.js").Axis} Axis */
/** @typedef {import("./geometry.js").Lie} Lie */
/** @typedef {import("../view/rotation.js").Vec3} Vec3 */
/** @typedef {import("../view/npy.js").Rows} Values values of a slice; NaN in holes */
/**
 * @typedef {(axis: Axis, at: number, voxels: string) => Promise<ArrayBuffer|null>} Read returns the
 *   `npy` file of a slice
 */

/** Share of voxels that may lie below black, and share that may lie above white. */
const RARE = 0.002;
const KEPT_BYTES = 1 << 26; // bytes of slices that are kept
const OPAQUE = 0xff000000; // alpha of a pixel as a little-endian word
const GREY = 0x010101; // one level of grey in r, g and b

/**
 * Reorder values as they lie on the screen. The server sends columns along the first of the two
 * axes, and rows down the second.
 * @param {Values} sent
 * @param {Pick<Lie, "right"|"up">} lie
 * @returns {Values}
 */
export function turned({ values, width, height }, { right, up }) {
  if (right.sign > 0 && up.sign > 0 && right.axis < up.axis) return { values, width, height };
  // Transpose if the slice's right axis is the second one; then read backwards along axes that
  // point the other way.
  const across = right.axis > up.axis;
  const [wide, high] = across ? [height, width] : [width, height];
  // Steps from one value to the next along the right and the upper axis.
  const steps = across ? [-width, 1] : [1, -width];
  const origin = (height - 1) * width;
  const result = new /** @type {any} */ (values.constructor)(values.length);
  for (let y = 0, i = 0; y < high; y += 1) {
    const upwards = up.sign > 0 ? high - 1 - y : y;
    for (let x = 0; x < wide; x += 1, i += 1) {
      result[i] =
        values[origin + steps[0] * (right.sign > 0 ? x : wide - 1 - x) + steps[1] * upwards];
    }
  }
  return { values: result, width: wide, height: high };
}

/**
 * Return the values that are black and white at first: the ends of a histogram without the few
 * voxels that lie far out.
 * @param {{counts: number[], edges: number[]}} histogram
 * @returns {Greys}
 */
export function usualGreys({ counts, edges }) {
  const few = RARE * counts.reduce((sum, count) => sum + count, 0);
  // Count bins from an end of the histogram until they hold more than the few voxels.
  const beyond = (/** @type {number[]} */ row) => {
    let bins = 0;
    let voxels = row[0];
    while (voxels <= few && bins < row.length - 1) voxels += row[++bins];
    return bins;
  };
  return [edges[beyond(counts)], edges[counts.length - beyond(counts.toReversed())]];
}

/**
 * Paint values grey: black at the first of the greys and below, and in holes; white at the second
 * and above.
 * @param {Values} slice
 * @param {Greys} greys
 * @returns {Uint8ClampedArray<ArrayBuffer>} RGBA
 */
export function pixelsOf({ values }, [black, white]) {
  const pixels = new Uint32Array(values.length);
  const scale = 255 / (white - black);
  for (let i = 0; i < values.length; i += 1) {
    // NaN fails both comparisons, so that holes are black.
    const grey = (values[i] - black) * scale + 0.5;
    let level = 0;
    if (grey >= 255) level = 255;
    else if (grey > 0) level = Math.floor(grey);
    pixels[i] = OPAQUE + GREY * level;
  }
  return new Uint8ClampedArray(pixels.buffer);
}

/**
 * Return the parameters that select the voxels of a view: the step of a time series, and the
 * smoothing.
 * @param {{time?: number, smooth?: number}} values knobs of the view
 * @returns {string}
 */
export function voxelsOf({ time, smooth }) {
  const given = Object.entries({ time, smooth }).filter(([, value]) => value !== undefined);
  return new URLSearchParams(given.map(([name, value]) => [name, String(value)])).toString();
}

/** Keeps the slices that were read last, so that going back and forth requests none twice. */
export class SliceCache {
  #read;
  /** @type {Map<string, Values>} */
  #kept = new Map(); // in the order of their last use
  #bytes = 0;

  /** @param {Read} read */
  constructor(read) {
    this.#read = read;
  }

  /**
   * Return a slice as it lies on the screen; null if the server does not answer.
   * @param {Lie} lie
   * @param {number} at voxel index
   * @param {string} voxels parameters that select the voxels, see `voxelsOf`
   * @returns {Promise<Values|null>}
   */
  async find(lie, at, voxels) {
    const name = [lie.axis, at, voxels].join(" ");
    const kept = this.#kept.get(name);
    if (kept) return this.#keep(name, kept);
    const file = await this.#read(lie.axis, at, voxels);
    return file && this.#keep(name, turned(readRows(file), lie));
  }

  /**
   * Keep a slice as the newest, and drop the oldest ones beyond the limit.
   * @param {string} name
   * @param {Values} slice
   */
  #keep(name, slice) {
    if (!this.#kept.delete(name)) this.#bytes += slice.values.byteLength;
    this.#kept.set(name, slice);
    for (const [oldest, { values }] of this.#kept) {
      if (this.#bytes <= KEPT_BYTES || oldest === name) break;
      this.#kept.delete(oldest);
      this.#bytes -= values.byteLength;
    }
    return slice;
  }
}
