import assert from "node:assert/strict";
import { test } from "node:test";
import { complaints, readAddress, writeAddress } from "../../../web/net/address.js";
import { MOST, angleOf, arcOf, distanceOf, knownInWords, lengthInWords, limitMeasures, measureInWords, readMeasure, writeMeasure } from "../../../web/view/measures.js";
import { sizeRows } from "../../../web/panels/reading.js";
import { ViewModel } from "../../../web/view/model.js";
import { SCENE, knobs } from "./fixtures.mjs";

const VOXELS = { unit: "", spacing: [1, 1, 1] };
const [A, B, C] = [[3, 0, 0], [0, 0, 0], [0, 4, 0]];

test("a distance has the unit of the volume", () => {
  assert.equal(distanceOf(A, C), 5);
  assert.equal(measureInWords({ unit: "mm", spacing: [1, 1, 2] }, [A, C]), "5 mm");
  assert.equal(measureInWords(VOXELS, [[0, 0, 0], [1, 1, 1]]), "1.732 voxels");
  assert.equal(lengthInWords({ unit: "", spacing: [1, 1, 2] }, 3), "3 units");
  assert.equal(lengthInWords(VOXELS, 1), "1 voxel");
});

test("a quantity has as many digits as its error leaves", () => {
  assert.equal(knownInWords(1614.2083, 15.262, "mm³"), "1614 ± 15 mm³");
  assert.equal(knownInWords(0.0031416, 0.00000213, "mm²"), "0.0031416 ± 0.0000021 mm²");
  assert.equal(knownInWords(12.34, 40, "mm²"), "10 ± 40 mm²");
  assert.equal(knownInWords(6600, 0, "voxel³"), "6600 voxel³");
});

test("a surface's size has squares and cubes of its unit", () => {
  const size = { unit: "mm", area: 50, area_error: 1, volume: 20, volume_error: 0.5, is_open: false };
  assert.deepEqual(sizeRows(VOXELS, size), [["Area", "50 ± 1 mm²"], ["Volume", "20 ± 0.5 mm³"]]);
  assert.equal(sizeRows(VOXELS, { ...size, unit: "" })[0][1], "50 ± 1 voxel²");
  assert.equal(sizeRows({ spacing: [1, 1, 2] }, { ...size, unit: "" })[1][1], "20 ± 0.5 unit³");
  assert.deepEqual(sizeRows(VOXELS, { ...size, area: 0 }), [["Area", "no surface"]]);
});

test("an angle is that at the second point", () => {
  assert.equal(measureInWords(VOXELS, [A, B, C]), "90.0°");
  assert.ok(Math.abs(angleOf(A, C, B) - (Math.atan2(3, 4) * 180) / Math.PI) < 1e-12);
  assert.deepEqual([angleOf(A, B, A), angleOf(A, B, [-1e-9, 0, 0])], [0, 180]);
  assert.equal(measureInWords(VOXELS, [A, A, C]), "no angle");
});

test("an arc goes from side to side, as far from the second point everywhere", () => {
  const arc = arcOf([A, B, C]);
  assert.deepEqual([arc[0], arc.at(-1)].map((point) => point.map((x) => Number(x.toFixed(9)))), [[0.9, 0, 0], [0, 0.9, 0]]);
  for (const point of arc) assert.ok(Math.abs(distanceOf(point, B) - 0.9) < 1e-12);
  assert.deepEqual(arcOf([A, C]), []);
});

test("an address holds what was measured", () => {
  const measures = [[A, C], [A, B, [0.333333, -4, 1e-9]]];
  const query = writeAddress(SCENE, knobs({ measures }));
  assert.deepEqual(new ViewModel(SCENE, readAddress(query).start).values.measures, measures);
  assert.deepEqual(complaints(query, SCENE), []);
  assert.deepEqual(readMeasure(writeMeasure(measures[1])), measures[1]);
});

test("what is no measure is left out, and told", () => {
  for (const text of ["", "1,2,3", "1,2,3;4,5", "1,2,3;4,5,x", "1,2,3;4,,6", "1,2,3;4,5,1e13", "0,0,0;1,1,1;2,2,2;3,3,3"]) {
    assert.equal(readMeasure(text), null, text);
    assert.equal(complaints(`?scene=small&measure=${text}`, SCENE).length, 1, text);
    assert.equal("measures" in readAddress(`?measure=${text}`).start, false, text);
  }
  assert.deepEqual(limitMeasures([[A], [A, [1, NaN, 2]], "x", [A, B]]), [[A, B]]);
  assert.equal(limitMeasures(Array(MOST + 5).fill([A, B])).length, MOST);
});

test("points have digits that an address can hold", () => {
  assert.deepEqual(limitMeasures([[[1 / 3, 2e6 / 3, 0], B]]), [[[0.333333, 666667, 0], B]]);
});

test("a reset keeps what was measured", () => {
  const view = new ViewModel(SCENE, { measures: [[A, B]], azimuth: 77 });
  view.reset();
  assert.deepEqual([view.values.azimuth, view.values.measures], [30, [[A, B]]]);
});

test("points that are grouped otherwise are another change", () => {
  const view = new ViewModel(SCENE, { measures: [[A, B], [C, A]] });
  let changes = 0;
  view.subscribe(() => { changes += 1; });
  view.set({ measures: [[A, B], [C, A]] });
  assert.equal(changes, 0);
  view.set({ measures: [[A, B, C]] });
  assert.equal(changes, 1);
});
