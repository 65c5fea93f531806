/**
 * The values on a slice: read from an `npy` file, turned as the screen shows them, painted grey,
 * and kept for a while.
 */

/** @typedef {import("../view/crosshair.js").Greys} Greys */
/** @typedef {import("./geometry.js").Axis} Axis */
/** @typedef {import("./geometry.js").Lie} Lie */
/** @typedef {import("../view/rotation.js").Vec3} Vec3 */
/** @typedef {Uint8Array|Uint16Array|Int16Array|Float32Array|Float64Array} Numbers */
/**
 * @typedef {{values: Numbers, width: number, height: number}} Values row by row, the upper one
 *   first; NaN in holes
 */
/**
 * @typedef {(axis: Axis, at: number, voxels: string) => Promise<ArrayBuffer|null>} Read
 *   gives a slice's `npy` file
 */

/** @type {Record<string, new (buffer: ArrayBuffer) => Numbers>} */
const KINDS = {
  "|u1": Uint8Array,
  "<u2": Uint16Array,
  "<i2": Int16Array,
  "<f4": Float32Array,
  "<f8": Float64Array,
};
const LENGTH_AT = 8; // where an npy file has the length of its header, in bytes
// of the voxels: so many may be blacker than black, and so many whiter than white
const RARE = 0.002;
const KEPT_BYTES = 1 << 26; // of slices
const OPAQUE = 0xff000000;
const GREY = 0x010101;

/**
 * The values in an `npy` file of rows and columns.
 * @param {ArrayBuffer} file
 * @returns {Values}
 * @throws {TypeError} where it holds anything else
 */
export function readValues(file) {
  const start = LENGTH_AT + 2 + new DataView(file).getUint16(LENGTH_AT, true);
  const header = new TextDecoder("latin1").decode(file.slice(LENGTH_AT + 2, start));
  const [, kind, rows, columns] =
    /'descr': '(.+?)', 'fortran_order': False, 'shape': \((\d+), (\d+)\)/.exec(header) ?? [];
  if (!KINDS[kind]) throw new TypeError(`no values of a slice: ${header}`);
  return {
    values: new KINDS[kind](file.slice(start)),
    width: Number(columns),
    height: Number(rows),
  };
}

/**
 * Values as they lie on the screen. The server has columns along the first of the two axes, and
 * rows down the second.
 * @param {Values} sent
 * @param {Pick<Lie, "right"|"up">} lie
 * @returns {Values}
 */
export function turned({ values, width, height }, { right, up }) {
  if (right.sign > 0 && up.sign > 0 && right.axis < up.axis) return { values, width, height };
  const across = right.axis > up.axis;
  const [wide, high] = across ? [height, width] : [width, height];
  // from one value to the next along the right and the upper axis
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
 * The values that are black and white at first: the ends of a histogram, without the few voxels
 * that lie far out.
 * @param {{counts: number[], edges: number[]}} histogram
 * @returns {Greys}
 */
export function usualGreys({ counts, edges }) {
  const few = RARE * counts.reduce((sum, count) => sum + count, 0);
  const beyond = (/** @type {number[]} */ row) => {
    let [bins, voxels] = [0, row[0]];
    while (voxels <= few && bins < row.length - 1) voxels += row[++bins];
    return bins;
  };
  return [edges[beyond(counts)], edges[counts.length - beyond(counts.toReversed())]];
}

/**
 * Pixels of values, RGBA: black at the first of the greys and below, and in holes; white at the
 * second and above.
 * @param {Values} slice
 * @param {Greys} greys
 * @returns {Uint8ClampedArray<ArrayBuffer>}
 */
export function pixelsOf({ values }, [black, white]) {
  const pixels = new Uint32Array(values.length);
  const scale = 255 / (white - black);
  for (let i = 0; i < values.length; i += 1) {
    const grey = (values[i] - black) * scale + 0.5;
    pixels[i] = OPAQUE + GREY * (grey >= 255 ? 255 : grey > 0 ? Math.floor(grey) : 0);
  }
  return new Uint8ClampedArray(pixels.buffer);
}

/**
 * Which of a scene's voxels a view shows, as parameters: the step of a series in time, and how far
 * they are smoothed.
 * @param {{time?: number, smooth?: number}} values knobs of the view
 * @returns {string}
 */
export function voxelsOf({ time, smooth }) {
  const given = Object.entries({ time, smooth }).filter(([, value]) => value !== undefined);
  return new URLSearchParams(given.map(([name, value]) => [name, String(value)])).toString();
}

/**
 * Slices that were read, until others need their room: going back and forth asks the server for
 * none twice.
 */
export class Shelf {
  #read;
  /** @type {Map<string, Values>} */
  #kept = new Map(); // those read last are the last ones
  #bytes = 0;

  /** @param {Read} read */
  constructor(read) {
    this.#read = read;
  }

  /**
   * A slice as it lies on the screen; null where the server does not answer.
   * @param {Lie} lie
   * @param {number} at voxel index
   * @param {string} voxels which of the scene's voxels, see `voxelsOf`
   * @returns {Promise<Values|null>}
   */
  async find(lie, at, voxels) {
    const name = [lie.axis, at, voxels].join(" ");
    const kept = this.#kept.get(name);
    if (kept) return this.#keep(name, kept);
    const file = await this.#read(lie.axis, at, voxels);
    return file && this.#keep(name, turned(readValues(file), lie));
  }

  /** @param {string} name @param {Values} slice */
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
