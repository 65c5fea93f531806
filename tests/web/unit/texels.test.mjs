import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import { Refusal } from "../../../web/isogi_web/card/device.js";
import { Texels } from "../../../web/isogi_web/card/texels.js";

const QUADRIC = new Array(27).fill(0);
const LAYER = 4 * 16 * 16; // words of a layer of bricks

let bricks; // texture of bricks, as the card has it
let filled; // layers of bricks that were sent, [first, number]

/** A context that keeps the bricks, the one texture of three dimensions. */
const gl = new Proxy({}, {
  get: (_, name) => {
    if (name === "texSubImage3D") return (...given) => fill(given);
    return /^[a-z]/.test(name) ? () => ({}) : name;
  },
});

/** Note what is sent of the bricks. */
function fill([target, , , , z, , , depth, , , data]) {
  if (target !== "TEXTURE_3D") return;
  filled.push([z, depth]);
  bricks.set(data.subarray(0, LAYER * depth), LAYER * z);
}

/** Texels of a scene of 16 bricks along each axis, with some surfaces. */
function makeTexels(count, size = [64, 64, 64]) {
  const surfaces = count > 1 ? new Array(count).fill({}) : null;
  const document = { lattice: { size, chunk: 16 }, plan: { channels: 1, columns: 1, turns: false }, surfaces };
  return new Texels({ gl, most2d: 4096, most3d: 2048, layers: 256 }, document, 0);
}

/** An answer of one block, whose only brick holds one texel: the first brick of chunk z, 1, 1. */
function answerAt(z) {
  const words = new Uint32Array([0x424f5349, 80, 0, 0, 1, 2, 7, 7, 1, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2]);
  new Uint16Array(words.buffer, 8, 4).set([z, 1, 1, 0]);
  return words.buffer;
}

beforeEach(() => {
  [bricks, filled] = [new Uint32Array(LAYER * 128), []];
});

test("an answer sends the layers of bricks that it changes", () => {
  const texels = makeTexels(1);
  assert.deepEqual(filled, [[0, 16]], "all layers are sent at first");
  filled.length = 0;
  texels.take(answerAt(2), "straight", QUADRIC);
  assert.deepEqual(filled, [[4, 9]], "from four before brick 8 to four behind it");
  assert.deepEqual(bricks.subarray(0, texels.table.length), texels.table);
});

test("bricks of one side change no layers of another", () => {
  const texels = makeTexels(4);
  assert.deepEqual(filled, [[0, 128]]);
  filled.length = 0;
  texels.take(answerAt(4 * 5), "straight", QUADRIC);
  assert.deepEqual(filled, [[80, 5]]);
  assert.deepEqual(bricks, texels.table);
});

test("light is coarse until texels take the place of all means", () => {
  const texels = makeTexels(1);
  const means = (z) => ({
    at: `${z}.1.1`, index: [1, 1, z], version: "", raw: false, bricks: new Uint32Array([0, 0, 0, 0]), count: 1, first: 0,
    records: new Uint32Array(4), layers: new Uint16Array(),
  });
  texels.put([means(2), means(3)], "", QUADRIC);
  assert.ok(texels.coarse);
  texels.take(answerAt(2), "straight", QUADRIC);
  assert.ok(texels.coarse);
  texels.take(answerAt(3), "straight", QUADRIC);
  assert.ok(!texels.coarse);
});

test("an index that takes too much memory is refused", () => {
  assert.throws(() => makeTexels(4, [1024, 1024, 512]), (error) => error instanceof Refusal && /256 MB/.test(error.message));
});
