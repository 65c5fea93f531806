import assert from "node:assert/strict";
import { test } from "node:test";
import { complaints, readAddress, writeAddress } from "../../../web/isogi_web/net/address.js";
import { sizeRows } from "../../../web/isogi_web/panels/reading.js";
import { rayThrough } from "../../../web/isogi_web/view/camera.js";
import { MOST, angleOf, arcOf, coordinatesInWords, distanceOf, knownInWords, lengthInWords, limitMeasures, limitNotes, measureInWords, placeInWords, readCrossHair, readMeasure, sidesAt, writeCrossHair, writeMeasure } from "../../../web/isogi_web/view/measures.js";
import { ViewModel } from "../../../web/isogi_web/view/model.js";
import { legendNumbers, legendOf, legendShapes, roundLength, rulerShapes, scaleBar, tripod } from "../../../web/isogi_web/view/rulers.js";
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

test("an address holds the cross hair, and the greys that were chosen", () => {
  for (const slices of [{ voxel: [3, 12, 30], greys: null }, { voxel: [0, 0, 0], greys: [-0.5, 1e-9] }]) {
    const query = writeAddress(SCENE, knobs({ slices }));
    assert.deepEqual(new ViewModel(SCENE, readAddress(query).start).values.slices, slices);
    assert.deepEqual(complaints(query, SCENE), []);
    assert.deepEqual(readCrossHair(writeCrossHair(slices)), slices);
  }
  assert.ok(!writeAddress(SCENE, knobs()).includes("slices"));
});

test("what is no cross hair is left out, and told", () => {
  for (const text of ["1,2", "1,2,x", "1,2,3,4", "1,2,3,9,9", "1,2,3,9,8", "1,,3"]) {
    assert.equal("slices" in readAddress(`?slices=${text}`).start, false, text);
    assert.equal(complaints(`?scene=small&slices=${text}`, SCENE).length, 1, text);
  }
});

test("a cross hair is at a voxel of the volume", () => {
  const view = new ViewModel(SCENE, { slices: { voxel: [-4, 7.6, 99], greys: null } });
  assert.deepEqual(view.values.slices, { voxel: [0, 8, 30], greys: null });
  view.set({ isovalue: 80 });
  assert.deepEqual(view.values.slices?.voxel, [0, 8, 30], "another knob leaves it");
  view.set({ slices: null });
  assert.equal(view.values.slices, null);
});

test("a reset keeps the slices", () => {
  const view = new ViewModel(SCENE, { slices: { voxel: [1, 2, 3], greys: [4, 5] }, azimuth: 77 });
  view.reset();
  assert.deepEqual([view.values.azimuth, view.values.slices], [30, { voxel: [1, 2, 3], greys: [4, 5] }]);
});

test("a place is told in the unit and by the sides of the file", () => {
  const volume = { spacing: [1, 0.5, 2], unit: "mm", letters: "RAS" }, place = [-12.3456, 0, 40];
  assert.equal(sidesAt(volume, place), "LAS");
  assert.equal(sidesAt({ letters: "" }, place), "");
  assert.equal(placeInWords(volume, place, "LAS"), "L 12.346 · A 0 · S 40 mm");
  assert.equal(placeInWords({ ...volume, unit: "" }, place, ""), "−12.346, 0, 40");
  assert.deepEqual(coordinatesInWords({ spacing: [1e-6, 1e-6, 1e-6] }, [1.23456789e-4, 0, 0], ""), ["0.00012346", "0", "0"]);
});

const SIZE = { width: 800, height: 600 };
const HEAD = { ...SCENE, volume: { ...SCENE.volume, letters: "LPS", unit: "mm" } };

test("a round length is 1, 2 or 5, and the greatest that fits", () => {
  for (const [most, length] of [[1, 1], [1.99, 1], [2, 2], [4.9, 2], [5, 5], [99, 50], [0.0123, 0.01], [7e-9, 5e-9], [3e8, 2e8]]) {
    assert.equal(roundLength(most), length, String(most));
  }
});

test("a scale bar is as long as what it stands for at the target's depth", () => {
  for (const view of [knobs(), knobs({ fov: 90, distance: 0.3, azimuth: 200, elevation: -40, target: [1, 2, 3] })]) {
    const { length, pixels } = scaleBar(SCENE, view, SIZE);
    assert.ok(pixels <= 150 && pixels > 50, `${pixels} pixels`);
    const [from, to] = [0, pixels / SIZE.height].map((right) => rayThrough(SCENE, view, right, 0).target);
    assert.ok(Math.abs(distanceOf(from, to) / length - 1) < 1e-9);
  }
  assert.ok(scaleBar(SCENE, knobs(), { width: 320, height: 240 }).pixels <= 80, "a narrow picture has a short one");
});

test("axes are seen from where the camera is", () => {
  const seen = Object.fromEntries(tripod(SCENE, { azimuth: 0, elevation: 0 }).map(({ letter, ...axis }) => [letter, axis]));
  for (const [letter, right, up, out] of [["x", 0, 0, 1], ["y", 1, 0, 0], ["z", 0, 1, 0]]) {
    const { right: r, up: u, out: o } = seen[letter];
    assert.ok(Math.hypot(r - right, u - up, o - out) < 1e-12, letter);
  }
  const axes = tripod(SCENE, { azimuth: 215, elevation: 35 });
  assert.deepEqual(axes.map(({ out }) => out), axes.map(({ out }) => out).sort((a, b) => a - b), "the nearest is drawn last");
});

test("axes have the letters of a patient, and the bar the unit", () => {
  const { words, lines } = rulerShapes(HEAD, knobs(), SIZE);
  const { length } = scaleBar(HEAD, knobs(), SIZE);
  assert.deepEqual(words.slice(0, 3).map(({ text }) => text).sort(), ["L", "P", "S"]);
  assert.deepEqual(words.slice(3).map(({ text }) => text), [`${length} mm`, "at the centre of rotation"]);
  assert.equal(lines.length, 4);
});

test("a scale bar of parallel rays is right at every depth, and says no other", () => {
  const { words } = rulerShapes(HEAD, knobs({ projection: "orthographic" }), SIZE);
  assert.equal(words.length, 4);
  assert.deepEqual(scaleBar(HEAD, knobs({ projection: "orthographic" }), SIZE), scaleBar(HEAD, knobs(), SIZE));
});

test("an address says where they are hidden", () => {
  assert.ok(!writeAddress(SCENE, knobs()).includes("rulers"));
  assert.equal(readAddress(writeAddress(SCENE, knobs({ rulers: "off" }))).start.rulers, "off");
});

test("a legend of values is at the lower right, with numbers under its ends", () => {
  const colours = { name: "flow", map: "magma", low: 0, high: 9, colours: ["#000004", "#fcfdbf"], outside: "#808080", labels: [] };
  const { areas: [bar], words } = legendShapes(legendOf({ ...SCENE, colours }, knobs()), SIZE);
  assert.deepEqual(words.map(({ text }) => text), ["flow", "0", "4.5", "9"]);
  assert.ok(bar.from[0] > SIZE.width / 2 && bar.to[0] < SIZE.width && bar.to[1] < SIZE.height / 4);
  assert.deepEqual([words[1].at[0], words[3].at[0], words[3].end], [bar.from[0], bar.to[0], true]);
  const errors = legendOf({ ...SCENE, colours, error_scale: { low: 0.001, high: 0.1, colours: ["#000004"] } }, knobs({ overlay: "error" }));
  assert.deepEqual(errors.bar, { name: "Estimated error", colours: ["#000004"], ticks: ["0.1 %", "1 %", "10 %"] });
  assert.equal(legendOf(SCENE, knobs()), null);
});

test("a legend of labels has those that are shown, as many as there is room for", () => {
  const labels = Array.from({ length: 50 }, (_, value) => ({ value: value + 1, name: `part ${value + 1}`, colour: "#b5523a", shown: true }));
  const parts = { ...SCENE, colours: { name: "seg", map: "labels", low: 1, high: 50, colours: [], outside: "#808080", labels } };
  const few = legendShapes(legendOf(parts, knobs({ hide: labels.slice(2).map(({ value }) => value).join(",") })), SIZE);
  assert.deepEqual(few.words.map(({ text }) => text), ["part 1", "part 2"]);
  assert.ok(few.areas[0].from[1] > few.areas[1].from[1], "the first is on top");
  const many = legendShapes(legendOf(parts, knobs()), { width: 300, height: 200 });
  assert.equal(many.words.at(-1)?.text, `and ${50 - many.areas.length} more`);
  assert.ok(many.areas.every(({ to }) => to[1] < 200));
});

test("a legend has numbers at even steps, from the first colour to the last", () => {
  assert.deepEqual(legendNumbers(0, 80), ["0", "20", "40", "60", "80"]);
  assert.deepEqual(legendNumbers(-1, 1), ["−1", "−0.5", "0", "0.5", "1"]);
  assert.deepEqual(legendNumbers(0.00123456, 0.00623456), ["0.00123", "0.00248", "0.00373", "0.00498", "0.00623"]);
});

test("texts beside measures are kept in the address, and leave with their measures", () => {
  const measures = [[[0, 0, 0], [1, 2, 3]], [[0, 0, 0], [4, 5, 6]]];
  const view = new ViewModel(SCENE, { measures });
  const first = writeMeasure(measures[0]);
  view.set({ notes: { [first]: "  width ~ of the duct & more ", other: "nothing" } });
  assert.deepEqual(view.values.notes, { [first]: "width ~ of the duct & more" });
  const { start } = readAddress(writeAddress(SCENE, view.values));
  assert.deepEqual(new ViewModel(SCENE, start).values.notes, view.values.notes);
  assert.deepEqual(new ViewModel(SCENE, start).values.measures, measures);
  view.set({ notes: { [first]: "x".repeat(99) } });
  assert.equal(view.values.notes[first].length, 60);
  view.set({ measures: [measures[1]] });
  assert.deepEqual(view.values.notes, {});
  assert.deepEqual(limitNotes("nonsense", measures), {});
});
