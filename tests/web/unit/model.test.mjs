import assert from "node:assert/strict";
import { test } from "node:test";
import { albedoQuery, isTint, startAlbedo } from "../../../web/isogi_web/view/albedo.js";
import { keyActions, nextStop } from "../../../web/isogi_web/view/keys.js";
import { ViewModel, sliderRange } from "../../../web/isogi_web/view/model.js";
import { PAINTED, SCENE } from "./fixtures.mjs";

test("a view starts where the scene starts", () => {
  const { values } = new ViewModel(SCENE);
  assert.equal(values.isovalue, 70);
  assert.equal(values.exposure, 1.234567, "defaults are not rounded");
  assert.deepEqual([values.target, values.shading, values.overlay, values.compare], [null, "gi", "none", ""]);
  assert.ok(!("albedo" in values) && !("tint" in values));
});

test("knobs without meaning take the scene's default", () => {
  const { values } = new ViewModel(SCENE, { azimuth: NaN, shading: "none", overlay: "x", target: [1, 2] });
  assert.deepEqual([values.azimuth, values.shading, values.overlay, values.target], [30, "gi", "none", null]);
});

test("numbers stay within the scene's ranges", () => {
  const view = new ViewModel(SCENE, { isovalue: 1e300, elevation: -100 });
  assert.deepEqual([view.values.isovalue, view.values.elevation], [240, -90]);
  view.set({ isovalue: -5 });
  assert.equal(view.values.isovalue, 40);
});

test("a full turn wraps round, and the rest is limited", () => {
  const view = new ViewModel(SCENE, { azimuth: 765, yaw: -190 });
  assert.deepEqual([view.values.azimuth, view.values.yaw], [45, 170]);
  view.set({ azimuth: 180 });
  assert.equal(view.values.azimuth, 180, "the end of the slider stays where it is");
});

test("angles keep two decimals, distances four digits", () => {
  const view = new ViewModel(SCENE, { elevation: 12.3456, distance: 3.14159, isovalue: 70.123456789 });
  assert.deepEqual([view.values.elevation, view.values.distance, view.values.isovalue], [12.35, 3.142, 70.123456789]);
});

test("listeners are called after a change, and only then", () => {
  const view = new ViewModel(SCENE);
  const seen = [];
  view.subscribe(({ azimuth }) => seen.push(azimuth));
  view.set({ azimuth: 31 });
  view.set({ azimuth: 31.001 });
  view.set({});
  assert.deepEqual(seen, [31]);
});

test("a watcher hears of changes of its part alone", () => {
  const view = new ViewModel(SCENE);
  let count = 0;
  view.watch(({ exposure, ...rest }) => rest, () => { count += 1; });
  view.set({ exposure: 2 });
  assert.equal(count, 0);
  view.set({ azimuth: 40 });
  assert.equal(count, 1);
});

test("a reset brings the start back", () => {
  const view = new ViewModel(SCENE, { azimuth: 99, target: [1, 2, 3], compare: "phong" });
  view.reset();
  assert.deepEqual(view.values, new ViewModel(SCENE).values);
});

test("a view starts where the surface is seen whole, and goes back there", () => {
  const start = { azimuth: 35, elevation: 25, distance: 2.5, target: [4, 5, 6] };
  const view = new ViewModel({ ...SCENE, start });
  const { azimuth, elevation, distance, target } = view.values;
  assert.deepEqual({ azimuth, elevation, distance, target }, start);
  view.set({ distance: 9, target: null });
  view.reset();
  assert.deepEqual(view.values.target, start.target);
});

test("the values are a copy", () => {
  const view = new ViewModel(SCENE);
  view.values.azimuth = 77;
  assert.equal(view.values.azimuth, 30);
});

test("a shading is not compared with itself", () => {
  const view = new ViewModel(SCENE, { compare: "gi" });
  assert.equal(view.values.compare, "");
  view.set({ compare: "phong" });
  view.set({ shading: "phong" });
  assert.deepEqual([view.values.shading, view.values.compare], ["phong", "gi"], "they change places");
});

test("sliders span what is handy, within what is allowed", () => {
  assert.deepEqual(sliderRange(SCENE, "azimuth"), { min: -180, max: 180, log: false });
  assert.deepEqual(sliderRange(SCENE, "distance"), { min: 0.2, max: 20, log: true });
  assert.deepEqual(sliderRange(SCENE, "isovalue"), { min: 40, max: 240, log: false });
  const { min, max } = sliderRange(SCENE, "exposure");
  assert.ok(Math.abs(max / min - 256) < 1e-9, "four stops either way");
});

test("without a range the isovalue spans the volume's values", () => {
  assert.deepEqual(sliderRange({ ...SCENE, ranges: {} }, "isovalue"), { min: 0, max: 255, log: false });
});

test("a grey scene starts at its albedo with a white tint", () => {
  assert.deepEqual(startAlbedo(PAINTED), { albedo: 0.7, tint: "#ffffff" });
  assert.deepEqual(startAlbedo(SCENE), {});
  assert.deepEqual(startAlbedo({ albedo: [0, 0, 0], albedos: PAINTED.albedos }), { albedo: 0, tint: "#ffffff" });
});

test("a tint is the albedo over its largest, in sRGB", () => {
  // a linear half is 0.735357 in sRGB: 187.5 of 255 rounds to 188, which is bc
  assert.deepEqual(startAlbedo({ albedo: [0.8, 0.4, 0], albedos: PAINTED.albedos }), { albedo: 0.8, tint: "#ffbc00" });
});

test("the scene's own albedo is no part of a request", () => {
  assert.deepEqual(albedoQuery(PAINTED, { albedo: 0.7, tint: "#ffffff" }), {});
  assert.deepEqual(albedoQuery(SCENE, { albedo: 0.5, tint: "#ffffff" }), {}, "nor any where it is fixed");
});

test("a white tint is one number, and a colour three", () => {
  assert.deepEqual(albedoQuery(PAINTED, { albedo: 0.5, tint: "#ffffff" }), { albedo: 0.5 });
  assert.deepEqual(albedoQuery(PAINTED, { albedo: 0.8, tint: "#ff8000" }), { albedo: "0.8,0.1727,0" });
});

test("a tint is six hexadecimal digits", () => {
  assert.ok(isTint("#00fFa9"));
  for (const text of ["#fff", "00ffaa", "#00ffaaa", "red", null, undefined, 7]) assert.ok(!isTint(text), String(text));
});

test("a view keeps a tint in small letters, an albedo in range", () => {
  const view = new ViewModel(PAINTED, { tint: "#FF8000", albedo: 5 });
  assert.deepEqual([view.values.tint, view.values.albedo], ["#ff8000", 0.9]);
});

test("brackets go to the next stop of the isovalue, braces a hundredth of its range", () => {
  const view = new ViewModel(SCENE);
  const keys = keyActions(SCENE, view, () => {});
  const seen = ["]", "]", "]", "[", "}", "{", "["].map((key) => (keys[key](), view.values.isovalue));
  assert.deepEqual(seen, [80, 200, 200, 80, 82, 80, 60]);
});

test("the next stop is beyond the isovalue, and there may be none", () => {
  const stops = [-2.5, 0, 1e-9, 4];
  const next = (isovalue, way) => nextStop(stops, isovalue, way);
  assert.deepEqual([-9, -2.5, 0, 3.9, 4, 9].map((isovalue) => next(isovalue, 1)), [-2.5, 0, 1e-9, 4, 4, 9]);
  assert.deepEqual([9, 4, 1e-9, 0, -2.5, -9].map((isovalue) => next(isovalue, -1)), [4, 1e-9, 0, -2.5, -2.5, -9]);
  assert.equal(nextStop([], 7, 1), 7, "without stops");
});

test("o goes round the marks, also as a capital", () => {
  const view = new ViewModel(SCENE);
  const keys = keyActions(SCENE, view, () => {});
  const seen = ["o", "O", "o"].map((key) => (keys[key](), view.values.overlay));
  assert.deepEqual(seen, ["provisional", "error", "none"]);
});
