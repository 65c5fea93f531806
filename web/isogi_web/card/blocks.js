/**
 * Blocks of texels as the server sends them: the bricks of a chunk, and the records of their
 * texels. The format is described in docs/card.md.
 */

const MAGIC = 0x424f5349; // "ISOB"
const HEADER = 32; // bytes
const BRICK_WORDS = 4; // words of 32 bits
const RECORD_WORDS = 4;

/**
 * @typedef {object} Block
 * @property {string} at the chunk, z.y.x
 * @property {[number, number, number]} index of the chunk, x, y, z
 * @property {string} version
 * @property {boolean} raw true if it holds raw transfer, false if it holds folded light
 * @property {Uint32Array} bricks four words per brick: 64 bits of its texels that are present (two
 *   words), number of its first record, and its place in the chunk
 * @property {number} count number of records
 * @property {number} first number of its first record in the run
 * @property {Uint32Array} records four words per record of folded light; one word, the normal, per
 *   record of raw transfer
 * @property {Uint16Array} layers half floats of raw transfer, layer by layer
 * @property {boolean} [grainy] true if light of this transfer needs the noise filter
 */

/**
 * Read the blocks of an answer.
 * @param {ArrayBuffer} answer
 * @returns {Block[]}
 * @throws {Error} if the answer is damaged
 */
export function readBlocks(answer) {
  const blocks = [];
  const view = new DataView(answer);
  for (let start = 0; start < answer.byteLength; start += view.getUint32(start + 4, true)) {
    // Check the magic number and the length before reading on: a damaged length could loop forever.
    const whole =
      start + HEADER <= answer.byteLength && view.getUint32(start, true) === MAGIC
        ? view.getUint32(start + 4, true)
        : 0;
    if (whole < HEADER || start + whole > answer.byteLength)
      throw new Error("The light that the server sent is damaged: reload the page.");
    blocks.push(readBlock(answer, view, start, whole));
  }
  return blocks;
}

/**
 * Read the block that begins at byte `start`.
 * @param {ArrayBuffer} answer
 * @param {DataView} view
 * @param {number} start first byte
 * @param {number} whole length in bytes
 * @returns {Block}
 */
function readBlock(answer, view, start, whole) {
  const [z, y, x, kind] = [8, 10, 12, 14].map((at) => view.getUint16(start + at, true));
  const bricks = view.getUint32(start + 16, true);
  const count = view.getUint32(start + 20, true);
  const first = start + HEADER + 16 * bricks;
  const version = Array.from(new Uint8Array(answer, start + 24, 8), (byte) =>
    byte.toString(16).padStart(2, "0"),
  ).join("");
  const raw = kind === 1;
  // Layers begin at a multiple of 8 bytes: behind an odd number of words is a word of padding.
  const layers = first + 4 * (count + (count & 1));
  return {
    at: `${z}.${y}.${x}`,
    index: [x, y, z],
    version,
    raw,
    bricks: new Uint32Array(answer, start + HEADER, BRICK_WORDS * bricks),
    count,
    first: 0,
    records: new Uint32Array(answer, first, (raw ? 1 : RECORD_WORDS) * count),
    layers: raw
      ? new Uint16Array(answer, layers, Math.floor((start + whole - layers) / 2))
      : new Uint16Array(),
  };
}

const FLOAT = new Float32Array(1);
const BITS = new Uint32Array(FLOAT.buffer);

/**
 * Return the bits of the half float nearest to a number; larger numbers become the greatest finite
 * half.
 * @param {number} x
 * @returns {number}
 */
export function halfOf(x) {
  FLOAT[0] = x;
  const [bits] = BITS;
  const sign = (bits >>> 16) & 0x8000;
  const exponent = ((bits >>> 23) & 255) - 112;
  // Subnormal halves count steps of 2^-24.
  if (exponent <= 0) return sign | Math.round(Math.abs(x) * 2 ** 24);

  // Keep ten bits of the fraction, and round by the next bit: a carry into the exponent is correct.
  return (
    sign | Math.min(((exponent << 10) | ((bits >>> 13) & 0x3ff)) + ((bits >>> 12) & 1), 0x7bff)
  );
}

/** Count the bits that are set in a word. @param {number} word @returns {number} */
export function ones(word) {
  // Add bits in pairs, then fours, then bytes; the multiplication adds the four bytes.
  const pairs = word - ((word >>> 1) & 0x55555555);
  const fours = (pairs & 0x33333333) + ((pairs >>> 2) & 0x33333333);
  return Math.imul((fours + (fours >>> 4)) & 0x0f0f0f0f, 0x01010101) >>> 24;
}
