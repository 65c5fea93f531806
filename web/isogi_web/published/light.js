/**
 * Light of a published page: texels and means of bricks, with quantized transfer. The format is
 * described in docs/card.md.
 */

import { halfOf, ones } from "../card/blocks.js";

/** @typedef {import("../card/blocks.js").Block} Block */

const MAGIC = 0x4c4f5349; // "ISOL"
const HEADER = 16; // bytes
const CHUNK = 8; // bytes of a chunk
const BRICK = 12; // bytes of a brick
const WORD = 4; // bytes of a normal

/**
 * Read a file of light. Each chunk becomes two blocks: normals without light, and transfer.
 * @param {ArrayBuffer} file
 * @param {readonly number[]} steps quantization step of each number
 * @returns {Block[]}
 * @throws {Error} if the file is damaged
 */
export function readLight(file, steps) {
  const view = new DataView(file);
  const whole = file.byteLength >= HEADER && view.getUint32(0, true) === MAGIC;
  const counts = [4, 8, 12].map((at) => (whole ? view.getUint32(at, true) : 0));
  const [chunks, bricks, records] = counts;
  const start = HEADER + CHUNK * chunks + BRICK * bricks;
  if (!whole || file.byteLength !== start + (WORD + 2 * steps.length) * records)
    throw new Error("The light of this page is damaged: load it again.");
  const table = new Uint16Array(rowsOf(new Uint8Array(file, HEADER, CHUNK * chunks), chunks));
  const listed = new Uint8Array(file, HEADER + CHUNK * chunks, BRICK * bricks);
  const rows = new Uint32Array(rowsOf(listed, bricks));
  const planes = planesOf(new Uint8Array(file, start), records);
  const blocks = [];
  let first = 0;
  let brick = 0;
  for (let c = 0; c < chunks; c++) {
    const [z, y, x, count] = table.subarray(4 * c, 4 * c + 4);
    const own = bricksOf(rows.subarray(3 * brick, 3 * (brick + count)));
    /** @type {[number, number, number]} */
    const index = [x, y, z];
    const facts = { at: `${z}.${y}.${x}`, index, version: "", first: 0, ...own };
    blocks.push(...decoded(facts, planes, first, steps));
    first += own.count;
    brick += count;
  }
  return blocks;
}

/**
 * Return a table that was stored byte by byte, row by row.
 * @param {Uint8Array} bytes first bytes of all rows, then all second bytes, and so on
 * @param {number} count rows
 * @returns {ArrayBuffer}
 */
function rowsOf(bytes, count) {
  const rows = new Uint8Array(bytes.length);
  const width = bytes.length / Math.max(count, 1);
  for (let k = 0; k < width; k++)
    for (let i = 0; i < count; i++) rows[width * i + k] = bytes[count * k + i];
  return rows.buffer;
}

/**
 * Cut a table into its bytes: byte k of all rows, for each k.
 * @param {Uint8Array} bytes
 * @param {number} count rows
 * @returns {Uint8Array[]}
 */
function planesOf(bytes, count) {
  const width = bytes.length / Math.max(count, 1);
  return Array.from({ length: width }, (_, k) => bytes.subarray(count * k, count * (k + 1)));
}

/**
 * Return the bricks of a chunk as blocks have them, and the number of their records: one for each
 * texel, and one for the mean of the brick.
 * @param {Uint32Array} rows 64 bits of the texels that are present (two words), and the place
 * @returns {{bricks: Uint32Array, count: number}}
 */
function bricksOf(rows) {
  const bricks = new Uint32Array((4 * rows.length) / 3);
  let count = 0;
  for (let i = 0; 3 * i < rows.length; i++) {
    const [low, high, place] = rows.subarray(3 * i, 3 * i + 3);
    bricks.set([low, high, count, place], 4 * i);
    count += ones(low) + ones(high) + 1;
  }
  return { bricks, count };
}

/**
 * Decode the records of a chunk into records without light, and the transfer of their texels.
 * @param {Omit<Block, "raw"|"records"|"layers">} facts fields that both blocks share
 * @param {Uint8Array[]} planes bytes of all records: four of the normal, two of each code
 * @param {number} first number of the chunk's first record
 * @param {readonly number[]} steps quantization step of each number
 * @returns {Block[]}
 */
function decoded(facts, planes, first, steps) {
  const { count } = facts;
  const [a, b, c, d] = planes;
  const words = new Uint32Array(count);
  const records = new Uint32Array(4 * count);
  // Assemble the normals, little-endian.
  for (let i = 0; i < count; i++) {
    const from = first + i;
    words[i] = a[from] | (b[from] << 8) | (c[from] << 16) | (d[from] << 24);
    records[4 * i + 3] = words[i];
  }
  // Decode each number of all texels. Codes are zigzag: 0, -1, 1, -2, … are stored as 0, 1, 2, 3, …
  const layers = new Uint16Array(4 * count * Math.ceil(steps.length / 4));
  steps.forEach((step, k) => {
    const [low, high] = planes.slice(WORD + 2 * k);
    const to = 4 * count * (k >> 2) + (k & 3);
    for (let i = 0; i < count; i++) {
      const code = low[first + i] | (high[first + i] << 8);
      layers[to + 4 * i] = halfOf(step * ((code >>> 1) ^ -(code & 1)));
    }
  });
  return [
    { ...facts, raw: false, records, layers: new Uint16Array() },
    { ...facts, raw: true, records: words, layers },
  ];
}
