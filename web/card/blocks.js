/** Blocks of texels as the server sends them: the bricks of a chunk, and the records of their texels. See docs/card.md. */

const MAGIC = 0x424f5349; // "ISOB"
const HEADER = 32, BRICK_WORDS = 4, RECORD_WORDS = 4;

/**
 * @typedef {object} Block
 * @property {string} at the chunk, z.y.x
 * @property {[number, number, number]} index of the chunk, x, y, z
 * @property {string} version
 * @property {boolean} raw whether it holds raw transfer, and no folded light
 * @property {Uint32Array} bricks words of each: which texels are there (two), its first record, and its place
 * @property {number} count of records
 * @property {number} first of them in its run: where they lie on the card
 * @property {Uint32Array} records words of folded ones; of raw ones their normals
 * @property {Uint16Array} layers halves of raw transfer, layer by layer
 */

/** The blocks of an answer. @param {ArrayBuffer} answer @returns {Block[]} @throws {Error} where they are damaged */
export function readBlocks(answer) {
  const blocks = [], view = new DataView(answer);
  for (let start = 0; start < answer.byteLength; start += view.getUint32(start + 4, true)) {
    const whole = start + HEADER <= answer.byteLength && view.getUint32(start, true) === MAGIC ? view.getUint32(start + 4, true) : 0;
    if (whole < HEADER || start + whole > answer.byteLength) throw new Error("The light that the server sent is damaged: reload the page.");
    blocks.push(readBlock(answer, view, start, whole));
  }
  return blocks;
}

/** @param {ArrayBuffer} answer @param {DataView} view @param {number} start @param {number} whole bytes @returns {Block} */
function readBlock(answer, view, start, whole) {
  const [z, y, x, kind] = [8, 10, 12, 14].map((at) => view.getUint16(start + at, true));
  const bricks = view.getUint32(start + 16, true), count = view.getUint32(start + 20, true), first = start + HEADER + 16 * bricks;
  const version = Array.from(new Uint8Array(answer, start + 24, 8), (byte) => byte.toString(16).padStart(2, "0")).join("");
  const raw = kind === 1, layers = first + 4 * (count + (count & 1));
  return {
    at: `${z}.${y}.${x}`,
    index: [x, y, z],
    version,
    raw,
    bricks: new Uint32Array(answer, start + HEADER, BRICK_WORDS * bricks),
    count,
    first: 0,
    records: new Uint32Array(answer, first, (raw ? 1 : RECORD_WORDS) * count),
    layers: raw ? new Uint16Array(answer, layers, Math.floor((start + whole - layers) / 2)) : new Uint16Array(),
  };
}

/** Bits that are set in a word. @param {number} word @returns {number} */
export function ones(word) {
  const pairs = word - ((word >>> 1) & 0x55555555), fours = (pairs & 0x33333333) + ((pairs >>> 2) & 0x33333333);
  return Math.imul((fours + (fours >>> 4)) & 0x0f0f0f0f, 0x01010101) >>> 24;
}
