import assert from "node:assert/strict";
import { test } from "node:test";
import { readAddress, writeAddress } from "../../../web/net/address.js";
import { rayThrough } from "../../../web/view/camera.js";
import { distanceOf } from "../../../web/view/measures.js";
import { legendNumbers, legendOf, legendShapes, roundLength, rulerShapes, scaleBar, tripod } from "../../../web/view/rulers.js";
import { SCENE, knobs } from "./fixtures.mjs";

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
  assert.deepEqual(words.slice(3).map(({ text }) => text), [`${length} mm`, "at the target’s depth"]);
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
