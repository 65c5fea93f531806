import assert from "node:assert/strict";
import { test } from "node:test";
import { halfOf, ones, readBlocks } from "../../../web/isogi_web/card/blocks.js";
import { EMPTY, brickShape, findRanges, markCells } from "../../../web/isogi_web/card/cells.js";
import { codeOf, facesOf, slabsOf } from "../../../web/isogi_web/card/document.js";
import { bandRotations, turned } from "../../../web/isogi_web/card/harmonics.js";
import { quadricOf, rotationMatrix, turnLight } from "../../../web/isogi_web/card/light.js";
import { SAMPLES, discOf, jitterOf } from "../../../web/isogi_web/card/picture.js";
import { joined } from "../../../web/isogi_web/card/programs.js";
import { pinhole, raysOf, windowOf } from "../../../web/isogi_web/card/rays.js";
import { surroundingsIn } from "../../../web/isogi_web/card/shine.js";
import { codesOf, joinMaps, uniformsOf } from "../../../web/isogi_web/card/surfaces.js";
import { fromAngles, turnVector } from "../../../web/isogi_web/view/rotation.js";
import { close } from "./fixtures.mjs";

/** Numbers that look random and are the same in every run. */
function* numbers(seed = 1) {
  for (let x = seed; ; x = (x * 48271) % 2147483647) yield x / 2147483647;
}

const TURN = fromAngles({ yaw: 70, pitch: -20, roll: 15 });
const GRID = { size: [21, 31, 11], spacing: [1, 0.5, 2], rotation: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], origin: [0, 0, 0], offset: 0.3, smooth: true };
const PLAIN = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];

test("shaders are joined, each file once", async () => {
  const files = { a: '#include "b"\n#include "c"\nA', b: '#include "c"\nB', c: "C" };
  assert.equal(await joined("a", async (name) => files[name]), "C\nB\n\nA");
});

test("an isovalue is compared as kernels compare it", () => {
  const document = { values: { offset: 10, scale: 256 }, volume: { gain: 1 / 256, base: 0 } };
  assert.equal(codeOf(document, 80), 70);
  assert.equal(codeOf({ ...document, values: { offset: 256, scale: -256 } }, 80), 176);
  assert.equal(codeOf(document, 10.1), Math.fround(256 * Math.fround((10.1 - 10) / 256)));
});

test("surroundings come after voxels and colours", () => {
  const [volume, colours] = ["a", "b"].map((href) => ({ slabs: [{ href }] })), shine = { surroundings: { href: "c" } };
  assert.deepEqual(slabsOf({ volume, colours, shine }), ["a", "b", "c"]);
  assert.deepEqual(slabsOf({ volume, colours: null, shine: null }), ["a"]);
  assert.deepEqual([...surroundingsIn({ shine }, [new ArrayBuffer(2), new Uint16Array([7, 8]).buffer])], [7, 8]);
  assert.equal(surroundingsIn({ shine: null }, [new ArrayBuffer(2)]).length, 0);
});

/** Cells of a volume with corners on both sides, or with some without value, cell by cell. */
function* activeCells(voxels, [nx, ny, nz], isovalue) {
  for (let z = 0; z < nz - 1; z++) for (let y = 0; y < ny - 1; y++) for (let x = 0; x < nx - 1; x++) {
    const corners = [0, 1, 2, 3, 4, 5, 6, 7].map((k) => voxels[((z + (k >> 2)) * ny + y + ((k >> 1) & 1)) * nx + x + (k & 1)]);
    const holed = corners.some(Number.isNaN) && !corners.every(Number.isNaN);
    if (holed || (corners.some((v) => v > isovalue) && corners.some((v) => v <= isovalue))) yield [x, y, z];
  }
}

test("the map marks what holds the isovalue or ends at holes", () => {
  const size = [14, 10, 11], random = numbers(), voxels = Float32Array.from({ length: 14 * 10 * 11 }, () => random.next().value ** 6);
  voxels[500] = voxels[501] = NaN;
  const shape = brickShape(size), { tops, cells, marked } = markCells(voxels, size, findRanges(voxels, size), 0.5);
  const found = [];
  tops.forEach((top, b) => {
    const at = [b % shape[0], Math.floor(b / shape[0]) % shape[1], Math.floor(b / shape[0] / shape[1])];
    for (let bit = 0; top < EMPTY && bit < 64; bit++) {
      if ((cells[2 * top + (bit >> 5)] >>> (bit & 31)) & 1) found.push([4 * at[0] + (bit & 3), 4 * at[1] + ((bit >> 2) & 3), 4 * at[2] + (bit >> 4)].join());
    }
  });
  const expected = [...activeCells(voxels, size, 0.5)].map((cell) => cell.join());
  assert.ok(expected.length > 50 && marked > 3);
  assert.deepEqual(found.sort(), expected.sort());
});

test("empty bricks know how far the next marked one is", () => {
  const size = [41, 33, 29], voxels = new Uint8Array(41 * 33 * 29), shape = brickShape(size);
  for (const [x, y, z] of [[9, 9, 9], [33, 20, 5], [10, 30, 26]]) voxels[(z * 33 + y) * 41 + x] = 200;
  const { tops } = markCells(voxels, size, findRanges(voxels, size), 100);
  const places = [...tops].map((_, b) => [b % shape[0], Math.floor(b / shape[0]) % shape[1], Math.floor(b / shape[0] / shape[1])]);
  const marked = places.filter((_, b) => tops[b] < EMPTY);
  assert.ok(marked.length >= 3);
  places.forEach((at, b) => {
    const nearest = Math.min(...marked.map((other) => Math.max(...other.map((x, i) => Math.abs(x - at[i])))));
    if (nearest > 0) assert.equal(tops[b] - EMPTY, nearest, `${at}`);
  });
});

/** Y_i of order 4 at a unit vector, written out. */
function basis([x, y, z]) {
  const p = Math.PI, s = Math.sqrt;
  return [
    s(1 / p) / 2, s(3 / (4 * p)) * y, s(3 / (4 * p)) * z, s(3 / (4 * p)) * x,
    s(15 / (4 * p)) * x * y, s(15 / (4 * p)) * y * z, s(5 / (16 * p)) * (3 * z * z - 1), s(15 / (4 * p)) * x * z, s(15 / (16 * p)) * (x * x - y * y),
    s(35 / (32 * p)) * y * (3 * x * x - y * y), s(105 / (4 * p)) * x * y * z, s(21 / (32 * p)) * y * (5 * z * z - 1), s(7 / (16 * p)) * z * (5 * z * z - 3),
    s(21 / (32 * p)) * x * (5 * z * z - 1), s(105 / (16 * p)) * z * (x * x - y * y), s(35 / (32 * p)) * x * (x * x - 3 * y * y),
  ];
}
const at = (harmonics, direction) => basis(direction).reduce((sum, y, i) => sum + y * (harmonics[i] ?? 0), 0);

test("turned harmonics are the turned function", () => {
  const random = numbers(7), light = Array.from({ length: 16 }, () => random.next().value - 0.5);
  const found = turned(bandRotations(4, rotationMatrix(TURN)), light);
  for (const direction of [[1, 0, 0], [0, 0.6, 0.8], [-0.48, 0.6, 0.64]]) close([at(found, turnVector(TURN, direction))], [at(light, direction)]);
});

test("high bands keep their energy when they are turned", () => {
  const random = numbers(3), light = Array.from({ length: 100 }, () => random.next().value - 0.5);
  const found = turned(bandRotations(10, rotationMatrix(TURN)), light), energy = (c, l) => c.slice(l * l, (l + 1) ** 2).reduce((sum, x) => sum + x * x, 0);
  close(Array.from({ length: 10 }, (_, l) => energy(found, l)), Array.from({ length: 10 }, (_, l) => energy(light, l)), 1e-12);
});

test("a quadric is the harmonics of order 3 as a polynomial", () => {
  const harmonics = [0.9, 0.2, -0.3, 0.1, 0.05, -0.2, 0.3, 0.1, -0.15], [x, y, z] = [-0.48, 0.6, 0.64];
  const value = [1, y, z, x, x * y, y * z, z * z, x * z, x * x - y * y].reduce((sum, p, i) => sum + p * quadricOf(harmonics)[i], 0);
  close([value], [at(harmonics, [x, y, z])]);
});

test("light is turned in the box that the volume lies in", () => {
  const rotation = rotationMatrix(fromAngles({ yaw: 30, pitch: 10, roll: -50 }));
  const lobe = { towards: [0.6, 0, 0.8], edges: [[0, 0.1, 0], [0.08, 0, -0.06]], shine: [1, 1, 1] };
  const harmonics = (order, c) => Array.from({ length: order ** 2 }, (_, i) => i + c);
  const term = (order) => ({ order, light: [0, 1, 2].map((c) => harmonics(order, c)), square: harmonics(order, 7) });
  const light = { terms: [term(3), term(2)], sky: term(3).light, lobes: [lobe], least: [0, 0, 0], unit: 1 };
  const model = { key: lobe.towards, follows: "light" };
  const placed = { grid: { ...GRID, rotation }, plan: { turns: true }, light };
  const found = turnLight({ ...placed, model }, TURN);
  const world = turnVector(TURN, lobe.towards), inBox = [0, 1, 2].map((i) => rotation.reduce((sum, row, j) => sum + row[i] * world[j], 0));
  close(found.towards[0], inBox);
  close(found.key, inBox);
  const lamp = { ...model, follows: "nothing" };
  close(turnLight({ ...placed, model: lamp }, TURN).key, lobe.towards);
  assert.equal(found.columns.length, 13);
  const direction = [0.36, 0.48, 0.8], there = [0, 1, 2].map((i) => rotation.reduce((sum, row, j) => sum + row[i] * turnVector(TURN, direction)[j], 0));
  const first = (k) => at(found.columns.slice(0, 9).map((column) => column[k]), there);
  close([first(1), first(3)], [at(light.terms[0].light[1], direction), at(light.terms[0].square, direction)]);
  const fixed = turnLight({ ...placed, plan: { turns: false }, model }, [1, 0, 0, 0]);
  close([...fixed.towards[0], ...fixed.key], [...lobe.towards, ...lobe.towards]);
  close(fixed.columns.slice(0, 9).map((column) => column[1]), light.terms[0].light[1]);
});

const CAMERA = { eye: [30, 30, 50], target: [10, 7.5, 10], up: [0, 0, 1], fov: 30 };
const ray = (from, [x, y], right, down) => from.map((a, i) => a + x * right[i] + y * down[i]);

test("the middle ray goes from the eye to the target", () => {
  const { eye, corner, right, down } = pinhole(GRID, CAMERA, 200, 100), d = ray(corner, [100, 50], right, down);
  close(eye, [30, 60, 25]);
  const t = (CAMERA.target[0] / GRID.spacing[0] - eye[0]) / d[0];
  close(eye.map((a, i) => a + t * d[i]), CAMERA.target.map((a, i) => a / GRID.spacing[i]), 1e-9);
});

test("a camera of a placed volume is brought into its box", () => {
  const rotation = rotationMatrix(fromAngles({ yaw: 90, pitch: 0, roll: 0 })), origin = [100, 200, 300];
  const world = (v, shift) => rotation.map((row, i) => row[0] * v[0] + row[1] * v[1] + row[2] * v[2] + shift[i]);
  const camera = { ...CAMERA, eye: world(CAMERA.eye, origin), target: world(CAMERA.target, origin), up: world(CAMERA.up, [0, 0, 0]) };
  const [there, here] = [pinhole({ ...GRID, rotation, origin }, camera, 20, 10), pinhole(GRID, CAMERA, 20, 10)];
  for (const part of ["eye", "corner", "right", "down"]) close(there[part], here[part], 1e-9);
});

test("rays begin before the box on the way from the eye", () => {
  for (const camera of [CAMERA, { ...CAMERA, parallel: true }]) {
    const { eye } = pinhole(GRID, camera, 40, 30), { start, startRight, startDown, corner, right, down } = raysOf(GRID, camera, 40, 30);
    for (const at of [[0, 0], [40, 30], [20, 15]]) {
      const o = ray(start, at, startRight, startDown), d = ray(corner, at, right, down), s = (o[0] - eye[0]) / d[0];
      close(o, eye.map((a, i) => a + s * d[i]), 1e-6);
      assert.ok(o.some((x, i) => x < 0 || x > GRID.size[i] - 1) && s > 0, "outside the box");
      assert.ok(Math.hypot(...o) < 200, "near the box, also from afar");
    }
  }
});

test("parallel rays keep what is at the target as large", () => {
  const [near, far] = [CAMERA, { ...CAMERA, parallel: true }].map((camera) => pinhole(GRID, camera, 40, 30));
  const span = ({ eye, corner, right, down }) => [0, 40].map((x) => {
    const d = ray(corner, [x, 15], right, down), middle = ray(corner, [20, 15], right, down), target = [10, 15, 5];
    const depth = middle.reduce((sum, a, i) => sum + (target[i] - eye[i]) * a * GRID.spacing[i] ** 2, 0) / middle.reduce((sum, a, i) => sum + (a * GRID.spacing[i]) ** 2, 0);
    return eye.map((a, i) => a + depth * d[i]);
  });
  span(near).forEach((point, i) => close(point, span(far)[i], 1e-5));
});

test("a window's planes are brought into index space", () => {
  const rotation = rotationMatrix(fromAngles({ yaw: 90, pitch: 0, roll: 0 })), plane = { normal: [0.6, 0, 0.8], limit: 40 };
  const [x, y, z, w] = windowOf({ ...GRID, rotation, origin: [10, 20, 30] }, [plane]);
  for (const index of [[3, 4, 5], [20, 0, 1]]) {
    const box = index.map((i, axis) => i * GRID.spacing[axis]), world = rotation.map((row, i) => row[0] * box[0] + row[1] * box[1] + row[2] * box[2] + [10, 20, 30][i]);
    close([x * index[0] + y * index[1] + z * index[2] + w], [40 - 0.6 * world[0] - 0.8 * world[2]]);
  }
});

test("faces are grey from end to end of the core", () => {
  const document = { values: { offset: 10, scale: -256, core: [-40, 60] }, volume: { gain: 1 / 128, base: -0.25 }, exposure: 2 };
  const { greys, paper } = facesOf(document), value = (code) => 10 - 256 * (-0.25 + code / 128);
  for (const code of [0, 20, 57]) close([greys[0] * code + greys[1]], [(value(code) + 40) / 100]);
  assert.equal(paper, 0.4);
});

/** A block as the server packs it: two bricks with two and one texels. */
function block() {
  const bytes = new ArrayBuffer(32 + 32 + 5 * 16), words = new Uint32Array(bytes), view = new DataView(bytes);
  words.set([0x424f5349, bytes.byteLength]);
  [3, 2, 1, 0].forEach((x, i) => view.setUint16(8 + 2 * i, x, true));
  words.set([2, 5, 0x44332211, 0x88776655, 5, 0, 0, 0, 0, 1 << 31, 3, 0x010203], 4);
  for (let i = 0; i < 20; i++) words[16 + i] = i;
  return bytes;
}

test("blocks are read as docs/card.md lays them out", () => {
  const twice = new Uint8Array([...new Uint8Array(block()), ...new Uint8Array(block())]).buffer, [first, second] = readBlocks(twice);
  assert.deepEqual([first.at, first.index, first.version, first.raw, first.count], ["3.2.1", [1, 2, 3], "1122334455667788", false, 5]);
  assert.deepEqual([...second.bricks], [5, 0, 0, 0, 0, 1 << 31 >>> 0, 3, 0x010203]);
  assert.deepEqual([...second.records], Array.from({ length: 20 }, (_, i) => i));
});

test("damaged light is refused in words", () => {
  for (const bytes of [block().slice(0, 100), new ArrayBuffer(40), block().slice(0, 20)]) assert.throws(() => readBlocks(bytes), /damaged/);
});

test("bits are counted", () => {
  for (const [word, count] of [[0, 0], [1, 1], [0xffffffff, 32], [0x80000001, 2], [0x0f0f, 8]]) assert.equal(ones(word), count);
});

test("samples fill the pixel and the disc evenly", () => {
  assert.deepEqual([jitterOf(0), discOf(0)], [[0, 0], [0, 0]]);
  const all = Array.from({ length: SAMPLES }, (_, i) => i + 1);
  for (const places of [all.map(jitterOf), all.map(discOf)]) {
    for (const axis of [0, 1]) assert.ok(Math.abs(places.reduce((sum, at) => sum + at[axis], 0) / SAMPLES) < 0.05);
  }
  assert.ok(all.map(jitterOf).flat().every((x) => Math.abs(x) <= 0.5));
  const radii = all.map((n) => Math.hypot(...discOf(n)) ** 2);
  close([radii.reduce((sum, x) => sum + x, 0) / SAMPLES], [0.5], 1e-9);
  assert.ok(Math.max(...radii) < 1);
});

test("a plain rotation leaves harmonics as they are", () => {
  const light = Array.from({ length: 25 }, (_, i) => i + 1);
  close(turned(bandRotations(5, PLAIN), light), light, 1e-12);
});

/** What a half float's bits stand for. */
function numberOf(half) {
  const exponent = (half >> 10) & 31, fraction = half & 1023, sign = half & 0x8000 ? -1 : 1;
  return sign * (exponent ? 2 ** (exponent - 15) * (1 + fraction / 1024) : fraction * 2 ** -24);
}

test("halves are the nearest ones, and end at the greatest", () => {
  for (const x of [0, 1, -1, 0.1, -0.3333, 1.99999, 65504, 6.1e-5, 5e-8, -3e-6, 1234.5]) {
    assert.ok(Math.abs(numberOf(halfOf(x)) - x) <= Math.max(Math.abs(x) * 2 ** -11, 2 ** -25), `${x}`);
  }
  assert.equal(numberOf(halfOf(1e6)), 65504);
  assert.equal(numberOf(halfOf(-1e6)), -65504);
});

test("maps of several surfaces are joined, and each finds its own cells", () => {
  const size = [13, 9, 10];
  const random = numbers(7);
  const voxels = Float32Array.from({ length: size[0] * size[1] * size[2] }, () => random.next().value);
  const ranges = findRanges(voxels, size);
  const maps = [0.9, 0.98, 2].map((isovalue) => markCells(voxels, size, ranges, isovalue));
  const joinedMap = joinMaps(maps);
  assert.equal(joinedMap.marked, maps[0].marked + maps[1].marked);
  maps.forEach(({ tops, cells }, k) => tops.forEach((top, b) => {
    const other = joinedMap.tops[k * tops.length + b];
    if (top >= EMPTY) assert.equal(other, top);
    else assert.deepEqual([...joinedMap.cells.subarray(2 * other, 2 * other + 2)], [...cells.subarray(2 * top, 2 * top + 2)]);
  }));
});

test("a surface at the isovalue of an earlier one is not seen", () => {
  const side = { sky: [[1], [2], [3]], least: [0, 0, 0] };
  const surface = (isovalue, clear) => ({ isovalue, clear, albedo: [1, 1, 1], outer: side, inner: side });
  const document = {
    values: { offset: 10, scale: 2 }, volume: { base: 0, gain: 1 }, plan: { ratios: true },
    surfaces: [surface(null, 0), surface(20, 0.5), surface(30, 0.25)],
  };
  const [tops, bricks] = [{ size: [2, 3, 12] }, { size: [2, 3, 24] }];
  const at = (shown) => uniformsOf(document, shown, { tops, bricks });
  assert.deepEqual([codesOf(document, 50), at(50).clears], [[20, 5, 10], [0, 0.5, 0.25]]);
  assert.deepEqual(at(30).clears, [0, 0.5, 1]);
  assert.deepEqual([at(50).map_layers, at(50).light_layers, at(50).skies.length], [4, 4, 162]);
  assert.deepEqual(uniformsOf({ ...document, surfaces: null }, 50, { tops, bricks }), {});
});
