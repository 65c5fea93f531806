import assert from "node:assert/strict";
import { test } from "node:test";
import { readLight } from "../../../web/isogi_web/published/light.js";
import { unpackSlabs, unpackVoxels } from "../../../web/isogi_web/published/voxels.js";

/** The number that a half stands for. */
function numberOf(half) {
  const [sign, exponent, part] = [half & 0x8000 ? -1 : 1, (half >> 10) & 31, half & 1023];
  return sign * (exponent ? (1 + part / 1024) * 2 ** (exponent - 15) : part * 2 ** -24);
}

/** Rows of numbers of some bytes each, byte by byte. */
function planes(rows) {
  const bytes = rows.map((row) => row.flatMap(([x, size]) => Array.from({ length: size }, (_, k) => Math.floor(x / 256 ** k) % 256)));
  return (bytes[0] ?? []).flatMap((_, k) => bytes.map((row) => row[k]));
}

/** A file of light: chunks [z, y, x, bricks], bricks [low, high, place], records [word, codes]. */
function lightFile(chunks, bricks, records) {
  const zigzag = (code) => (code < 0 ? -2 * code - 1 : 2 * code);
  const counts = [chunks, bricks, records].flatMap(({ length }) => [length & 255, length >> 8, 0, 0]);
  return new Uint8Array([
    ...[0x49, 0x53, 0x4f, 0x4c], ...counts,
    ...planes(chunks.map((row) => row.map((x) => [x, 2]))),
    ...planes(bricks.map((row) => row.map((x) => [x, 4]))),
    ...planes(records.map(([word, codes]) => [[word, 4], ...codes.map((code) => [zigzag(code), 2])])),
  ]).buffer;
}

const STEPS = [0.5, 0.25, 0, 2, 1];
const CHUNKS = [[4, 5, 6, 1], [1, 2, 300, 2]];
const BRICKS = [[0b101, 0, 7], [0, 0x80000000, 0x010203], [0, 0, 9]];
const RECORDS = [
  [0x12345678, [3, 1, 0, 2, -700]], [0x80008001, [-4, 0, 0, 2, 5]], [0xfedcba98, [300, -1, 0, 2, 6]],
  [1, [1, 2, 3, 4, 5]], [2, [-1, -2, -3, -4, -5]],
  [3, [9, 8, 7, 6, 5]],
];

test("light in few bits becomes normals without light, and halves", () => {
  const blocks = readLight(lightFile(CHUNKS, BRICKS, RECORDS), STEPS);
  assert.deepEqual(blocks.map(({ at, raw, count }) => [at, raw, count]), [["4.5.6", false, 3], ["4.5.6", true, 3], ["1.2.300", false, 3], ["1.2.300", true, 3]]);
  assert.deepEqual(blocks[2].index, [300, 2, 1]);
  assert.deepEqual([...blocks[0].bricks], [5, 0, 0, 7]);
  assert.deepEqual([...blocks[3].bricks], [0, 0x80000000, 0, 0x010203, 0, 0, 2, 9], "a brick begins behind the mean of the one before");
  [0, 3].forEach((first, n) => {
    const [folded, raw] = blocks.slice(2 * n), own = RECORDS.slice(first, first + 3);
    assert.deepEqual([...folded.records], own.flatMap(([word]) => [0, 0, 0, word]));
    assert.equal(raw.layers.length, 4 * 3 * 2);
    own.forEach(([, codes], i) => codes.forEach((code, k) =>
      assert.equal(numberOf(raw.layers[4 * 3 * (k >> 2) + 4 * i + (k & 3)]), STEPS[k] * code)));
  });
});

test("a file of light that is cut off is refused", () => {
  const file = lightFile(CHUNKS, BRICKS, RECORDS);
  for (const wrong of [file.slice(0, -1), file.slice(0, 10), new ArrayBuffer(0), new Uint8Array([...new Uint8Array(file)].fill(0, 0, 1)).buffer])
    assert.throws(() => readLight(wrong, STEPS), /damaged/);
  assert.deepEqual(readLight(lightFile([], [], []), STEPS), []);
});

test("voxels are their predictions plus steps, others those of their side", () => {
  // Two columns of three layers are stated, with the ends 10 and 20; all others follow their side.
  const size = [3, 1, 3], marks = [0b001, 0b010, 0];
  // The steps: 25 from 0; then 25 - 0, 12 - 25 and -1 from medians of what is before.
  const code = (x) => (x < 0 ? -2 * x - 1 : 2 * x);
  const steps = [25, -25, 12, -1, 30];
  const file = new Uint8Array([10, 20, ...marks, ...steps.map(code)]).buffer;
  const codes = new Uint8Array(unpackVoxels(file, "uint8", size));
  // Layer 0: 25 is stated, then the others are beyond 10. Layer 1: 25, of 25 above, less 25.
  assert.deepEqual([...codes.slice(0, 3)], [25, 20, 20]);
  assert.equal(codes[3], 0);
  // Neighbours along x and z are 0 and 20, xz is 25: of 0, 0, 20, 0, -5, 20, -5 the median is 0.
  assert.deepEqual([...codes.slice(4, 6)], [12, 20]);
  // From 0 above: the median of 0, 0, 0, … is 0, and -1 wraps around.
  assert.equal(codes[6], 255);
  // Of 255, 0, 12, 255, 267, 12, 267: 255, plus 30 is 285.
  assert.deepEqual([...codes.slice(7)], [29, 20]);
});

test("slabs of the volume are unpacked, and others stay", () => {
  const document = { grid: { size: [2, 1, 3] }, volume: { type: "uint16", slabs: [{ first: 0, last: 2 }, { first: 2, last: 3 }] } };
  const ends = [1, 2, 3, 2], others = new ArrayBuffer(5); // 513 and 515
  const slabs = [[...ends, 0, 0], [...ends, 1, 0, 4, 0]].map((bytes) => new Uint8Array(bytes).buffer);
  const [first, last, colours] = unpackSlabs(document, [...slabs, others]);
  assert.deepEqual([...new Uint16Array(first)], [513, 513, 513, 513]);
  assert.deepEqual([...new Uint16Array(last)], [2, 513]);
  assert.equal(colours, others);
});
