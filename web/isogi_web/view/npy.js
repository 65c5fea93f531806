/**
 * Rows of numbers in NumPy's format `npy`, version 1.0: ten bytes whose last two hold the length of
 * the header, the header as a Python dictionary, and the numbers. Source: numpy.lib.format.
 */

/** @typedef {Uint8Array|Uint16Array|Int16Array|Float32Array|Float64Array} Numbers */
/**
 * @typedef {{values: Numbers, width: number, height: number}} Rows numbers row by row, the upper
 *   row first
 */

const LENGTH_AT = 8; // place of the header's length, bytes
const HEADER_AT = LENGTH_AT + 2; // place of the header, bytes

/**
 * Arrays for the kinds of numbers that the server sends.
 * @type {Record<string, new (buffer: ArrayBuffer) => Numbers>}
 */
const KINDS = {
  "|u1": Uint8Array,
  "<u2": Uint16Array,
  "<i2": Int16Array,
  "<f4": Float32Array,
  "<f8": Float64Array,
};

/**
 * Read an `npy` file with two dimensions: rows and columns.
 * @param {ArrayBuffer} file
 * @returns {Rows}
 * @throws {TypeError} if it holds anything else
 */
export function readRows(file) {
  const start = HEADER_AT + new DataView(file).getUint16(LENGTH_AT, true);
  const header = new TextDecoder("latin1").decode(file.slice(HEADER_AT, start));
  const [, kind, rows, columns] =
    /'descr': '(.+?)', 'fortran_order': False, 'shape': \((\d+), (\d+)\)/.exec(header) ?? [];
  if (!KINDS[kind]) throw new TypeError(`The file has no rows of numbers: ${header}`);
  return {
    values: new KINDS[kind](file.slice(start)),
    width: Number(columns),
    height: Number(rows),
  };
}

/**
 * Write rows of single floats for `readRows`; the signature is left out, as that does not check it.
 * @param {Float32Array} values row by row
 * @param {number} width numbers of a row
 * @param {number} height number of rows
 * @returns {ArrayBuffer}
 */
export function writeRows(values, width, height) {
  // Pad the header with spaces, so that the numbers begin at a multiple of four bytes.
  const shape = `'descr': '<f4', 'fortran_order': False, 'shape': (${height}, ${width})`;
  const length = 4 * Math.ceil((HEADER_AT + shape.length + 4) / 4) - HEADER_AT;
  const header = `{${shape}, }`.padEnd(length);
  const file = new ArrayBuffer(HEADER_AT + header.length + values.byteLength);
  new DataView(file).setUint16(LENGTH_AT, header.length, true);
  new Uint8Array(file, HEADER_AT, header.length).set(new TextEncoder().encode(header));
  new Float32Array(file, HEADER_AT + header.length).set(values);
  return file;
}
