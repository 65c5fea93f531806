/**
 * Blocks of texels as the server sends them: the bricks of a chunk, and the records of their
 * texels. See docs/card.md.
 */

const MAGIC = 0x424f5349; // "ISOB"
const HEADER = 32;
const BRICK_WORDS = 4;
const RECORD_WORDS = 4;

/**
 * @typedef {object} Block
 * @property {string} at the chunk, z.y.x
 * @property {[number, number, number]} index of the chunk, x, y, z
 * @property {string} version
 * @property {boolean} raw whether it holds raw transfer, and no folded light
 * @property {Uint32Array} bricks words of each: which texels are there (two), its first record, and
 *   its place
 * @property {number} count of records
 * @property {number} first of them in its run: where they lie on the card
 * @property {Uint32Array} records words of folded ones; of raw ones their normals
 * @property {Uint16Array} layers halves of raw transfer, layer by layer
 * @property {boolean} [grainy] whether light of the transfer is to be filtered for its noise
 */

const CODED = 2; // kind of a block in few bits

/**
 * The blocks of an answer; transfer in few bits becomes two, of which the one has normals alone.
 * @param {ArrayBuffer} answer
 * @param {readonly number[]} [steps] of its codes, where it is in few bits
 * @returns {Block[]}
 * @throws {Error} where they are damaged
 */
export function readBlocks(answer, steps = []) {
  const blocks = [];
  const view = new DataView(answer);
  for (let start = 0; start < answer.byteLength; start += view.getUint32(start + 4, true)) {
    const whole =
      start + HEADER <= answer.byteLength && view.getUint32(start, true) === MAGIC
        ? view.getUint32(start + 4, true)
        : 0;
    if (whole < HEADER || start + whole > answer.byteLength)
      throw new Error("The light that the server sent is damaged: reload the page.");
    blocks.push(...readBlock(answer, view, start, whole, steps));
  }
  return blocks;
}

/**
 * @param {ArrayBuffer} answer
 * @param {DataView} view
 * @param {number} start
 * @param {number} whole bytes
 * @param {readonly number[]} steps
 * @returns {Block[]}
 */
function readBlock(answer, view, start, whole, steps) {
  const [z, y, x, kind] = [8, 10, 12, 14].map((at) => view.getUint16(start + at, true));
  const bricks = view.getUint32(start + 16, true);
  const count = view.getUint32(start + 20, true);
  const first = start + HEADER + 16 * bricks;
  const version = Array.from(new Uint8Array(answer, start + 24, 8), (byte) =>
    byte.toString(16).padStart(2, "0"),
  ).join("");
  const raw = kind === 1;
  const layers = first + 4 * (count + (count & 1));
  /** @type {Omit<Block, "raw"|"records"|"layers">} */
  const facts = {
    at: `${z}.${y}.${x}`,
    index: [x, y, z],
    version,
    bricks: new Uint32Array(answer, start + HEADER, BRICK_WORDS * bricks),
    count,
    first: 0,
  };
  if (kind === CODED)
    return decoded(facts, new Uint8Array(answer, first, start + whole - first), steps);
  const records = new Uint32Array(answer, first, (raw ? 1 : RECORD_WORDS) * count);
  return [
    {
      ...facts,
      raw,
      records,
      layers: raw
        ? new Uint16Array(answer, layers, Math.floor((start + whole - layers) / 2))
        : new Uint16Array(),
    },
  ];
}

/**
 * Records without light, and the transfer of their texels: bytes of words and of codes, each place
 * of all of them side by
 * side, become words and halves.
 * @param {Omit<Block, "raw"|"records"|"layers">} facts
 * @param {Uint8Array} bytes
 * @param {readonly number[]} steps
 * @returns {Block[]}
 */
function decoded(facts, bytes, steps) {
  const { count } = facts;
  const words = new Uint32Array(count);
  const records = new Uint32Array(RECORD_WORDS * count);
  for (let i = 0; i < count; i++) {
    words[i] =
      bytes[i] |
      (bytes[count + i] << 8) |
      (bytes[2 * count + i] << 16) |
      (bytes[3 * count + i] << 24);
    records[RECORD_WORDS * i + 3] = words[i];
  }
  const layers = new Uint16Array(4 * count * Math.ceil(steps.length / 4));
  steps.forEach((step, k) => {
    const low = (4 + k) * count;
    const high = low + steps.length * count;
    const to = 4 * count * (k >> 2) + (k & 3);
    for (let i = 0; i < count; i++) {
      const code = bytes[low + i] | (bytes[high + i] << 8);
      layers[to + 4 * i] = halfOf(step * ((code >>> 1) ^ -(code & 1)));
    }
  });
  return [
    { ...facts, raw: false, records, layers: new Uint16Array() },
    { ...facts, raw: true, records: words, layers },
  ];
}

const FLOAT = new Float32Array(1);
const BITS = new Uint32Array(FLOAT.buffer);

/**
 * The bits of the half float that is nearest to a number, at most the greatest half.
 * @param {number} x
 * @returns {number}
 */
export function halfOf(x) {
  FLOAT[0] = x;
  const [bits] = BITS;
  const sign = (bits >>> 16) & 0x8000;
  const exponent = ((bits >>> 23) & 255) - 112;
  if (exponent <= 0) return sign | Math.round(Math.abs(x) * 2 ** 24);
  return (
    sign | Math.min(((exponent << 10) | ((bits >>> 13) & 0x3ff)) + ((bits >>> 12) & 1), 0x7bff)
  );
}

/** Bits that are set in a word. @param {number} word @returns {number} */
export function ones(word) {
  const pairs = word - ((word >>> 1) & 0x55555555);
  const fours = (pairs & 0x33333333) + ((pairs >>> 2) & 0x33333333);
  return Math.imul((fours + (fours >>> 4)) & 0x0f0f0f0f, 0x01010101) >>> 24;
}
