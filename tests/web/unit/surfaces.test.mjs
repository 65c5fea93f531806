import assert from "node:assert/strict";
import { test } from "node:test";

import { readAddress, writeAddress, complaints } from "../../../web/isogi_web/net/address.js";
import { frameQuery } from "../../../web/isogi_web/net/request.js";
import { ViewModel } from "../../../web/isogi_web/view/model.js";
import { exportQuery } from "../../../web/isogi_web/net/export.js";
import { numberRange } from "../../../web/isogi_web/panels/cuts.js";
import { absorbedShares, areHidden, areSurfaces, isMaterial, readHidden, readMaterial, readSurfaces, tintOf, writeHidden, writeMaterial, writeSurfaces } from "../../../web/isogi_web/view/surfaces.js";
import { PAINTED, SCENE } from "./fixtures.mjs";

const surfaces = [{ name: "skin", isovalue: 64, albedo: [0.6, 0.6, 0.6], clear: 0.3 }, { name: "", isovalue: 90, albedo: [0.7, 0.7, 0.7], clear: 0 }];

test("a text says what each surface lets pass, and which are hidden", () => {
  const shown = [{ shown: true, clear: 0.55 }, { shown: false, clear: 0 }];
  assert.deepEqual(readSurfaces("0.55,off", surfaces), shown);
  assert.equal(writeSurfaces(shown, surfaces), "0.55,off");
  assert.deepEqual(readSurfaces("", surfaces), [{ shown: true, clear: 0.3 }, { shown: true, clear: 0 }]);
  assert.equal(writeSurfaces(readSurfaces("", surfaces), surfaces), "");
});

test("texts that do not fit the surfaces are none", () => {
  for (const text of ["0.5", "0.5,off,0", "0.5,2", "0.5,no", "-1,off", "", undefined]) assert.ok(!areSurfaces(text, 2), text);
  for (const text of ["0,1", "off,off", ".5,0.25"]) assert.ok(areSurfaces(text, 2), text);
});

test("what surfaces let pass is in the address and in requests, where it is not the scene's own", () => {
  const clear = { ...SCENE, surfaces };
  const view = new ViewModel(clear, readAddress("?surfaces=0.5,off").start);
  const size = { width: 8, height: 8 };
  assert.equal(frameQuery(clear, view.values, size).surfaces, "0.5,off");
  assert.match(writeAddress(clear, view.values), /surfaces=0\.5%2Coff/);
  view.set({ surfaces: "" });
  assert.ok(!("surfaces" in frameQuery(clear, view.values, size)));
  assert.equal(new ViewModel(SCENE, { surfaces: "0.5,off" }).values.surfaces, "");
  assert.match(complaints("?surfaces=3", clear)[0], /does not fit/);
});

const labels = [-2, 3, 8].map((value) => ({ value, name: `label ${value}`, colour: "#b5523a", shown: value !== 3 }));
const parts = { ...SCENE, colours: { name: "seg", map: "labels", low: -2, high: 8, colours: ["#b5523a"], outside: "#b5523a", labels } };

test("a text says which labels are hidden, and is empty where the scene hides these", () => {
  assert.deepEqual([readHidden("", labels), readHidden("none", labels), readHidden("3,-2", labels)], [[3], [], [3, -2]]);
  assert.deepEqual([writeHidden([3], labels), writeHidden([], labels), writeHidden([8, -2], labels)], ["", "none", "-2,8"]);
});

test("texts that name no labels, or hide all of them, are none", () => {
  for (const text of ["none", "3", "-2,8"]) assert.ok(areHidden(text, labels), text);
  for (const text of ["", "4", "3,", "x", "3,-2,8", undefined]) assert.ok(!areHidden(text, labels), text);
  assert.ok(!areHidden("none", []));
});

test("hidden labels are in the address and in requests, where they are not the scene's own", () => {
  const view = new ViewModel(parts, readAddress("?hide=-2,8").start), size = { width: 8, height: 8 };
  assert.equal(frameQuery(parts, view.values, size).hide, "-2,8");
  assert.match(writeAddress(parts, view.values), /hide=-2%2C8/);
  view.set({ hide: "" });
  assert.ok(!("hide" in frameQuery(parts, view.values, size)));
  assert.equal(new ViewModel(SCENE, { hide: "3" }).values.hide, "");
  assert.match(complaints("?hide=4", parts)[0], /does not fit the labels/);
});

const materials = [
  { kind: "diffuse", numbers: {}, refused: null },
  { kind: "glass", numbers: { index: 1.5, absorption: 0 }, refused: null },
  { kind: "subsurface", numbers: { mean_free_path: 0.4 }, refused: null },
];
const made = { ...PAINTED, material: "diffuse", materials };
const tinted = [materials[0], { kind: "glass", numbers: { index: 1.3, absorption: [0.2, 0.06, 0] }, refused: null }, { kind: "subsurface", numbers: {}, refused: "Lamps do not reach inside." }];
const vase = { ...SCENE, material: "glass,index=1.3,absorption=0.2,0.06,0.0", materials: tinted };

test("a text says what the surface is made of, with the material's own numbers where it leaves them out", () => {
  assert.deepEqual(readMaterial("glass,index=2", made), { kind: "glass", numbers: { index: [2], absorption: [0] } });
  assert.deepEqual(readMaterial("", made), { kind: "diffuse", numbers: {} });
  assert.deepEqual(readMaterial("", vase).numbers, { index: [1.3], absorption: [0.2, 0.06, 0] });
  assert.deepEqual(readMaterial("glass,absorption=1,2,3,index=2", vase).numbers, { index: [2], absorption: [1, 2, 3] });
});

test("the text is empty where the surface is the scene's own", () => {
  for (const text of ["glass", "glass,index=2", "subsurface,mean_free_path=3"]) assert.equal(writeMaterial(readMaterial(text, made), made), text);
  for (const scene of [made, vase]) assert.equal(writeMaterial(readMaterial(scene.material, scene), scene), "");
  assert.equal(writeMaterial(readMaterial("diffuse", vase), vase), "diffuse");
  assert.equal(writeMaterial({ kind: "glass", numbers: { index: [1.3], absorption: [0.5, 0.5, 0.5] } }, vase), "glass,absorption=0.5");
});

test("texts that say no material of the scene are none", () => {
  for (const text of ["glass", "glass,index=1.3", "glass,absorption=0.1,0.2,0.3", "diffuse"]) assert.ok(isMaterial(text, materials), text);
  for (const text of ["", "jelly", "glass,1.5", "glass,index=", "glass,index=x", "glass,mean_free_path=2", undefined]) assert.ok(!isMaterial(text, materials), text);
  assert.ok(!isMaterial("subsurface", tinted));
  assert.match(complaints("?material=subsurface", vase)[0], /no material of this scene: Lamps do not reach/);
  assert.deepEqual(complaints("?material=glass", vase), []);
});

test("what absorbs has the tint of white light behind it, and the tint says the shares", () => {
  for (const grey of [[0.3], [0.2, 0.2, 0.2], [0]]) assert.equal(tintOf(grey), "#ffffff");
  assert.equal(tintOf([0.4, 0, 0]), "#3fffff", "e⁻³ of the red is left");
  assert.equal(tintOf([4, 0, 0]), "#3fffff", "how much is not its matter");
  const near = (a, b) => a.forEach((each, k) => assert.ok(Math.abs(each - b[k]) < 0.01, `${a} is not ${b}`));
  for (const shares of [[1, 0.25, 0], [0.5, 1, 0.8], [1, 1, 1], [0, 0, 1]]) near(absorbedShares(tintOf(shares)), shares);
  near(absorbedShares("#ff0000"), [0, 1, 1]);
  near(absorbedShares("#000000"), [1, 1, 1]);
});

test("a material is in the address and in requests, without knobs that say nothing of it", () => {
  const view = new ViewModel(made, readAddress("?material=glass,index=2&yaw=30&albedo=0.5").start), size = { width: 8, height: 8 };
  const query = frameQuery(made, view.values, size);
  assert.deepEqual([query.material, query.albedo, query.yaw], ["glass,index=2", undefined, 30]);
  assert.equal(exportQuery(query).material, "glass,index=2");
  assert.match(writeAddress(made, view.values), /material=glass%2Cindex%3D2/);
  assert.doesNotMatch(writeAddress(made, view.values), /albedo|tint/);
  view.set({ material: "subsurface" });
  assert.equal(frameQuery(made, view.values, size).yaw, undefined);
  assert.doesNotMatch(writeAddress(made, view.values), /yaw/);
  view.set({ material: "" });
  assert.deepEqual([frameQuery(made, view.values, size).yaw, frameQuery(made, view.values, size).albedo], [30, 0.5]);
  assert.equal(new ViewModel(SCENE, { material: "glass" }).values.material, "", "a scene that may not");
});

test("sliders of numbers span what shows in a volume of that size, and the scene's own", () => {
  const bounds = [[0, 0, 0], [20, 0, 0]]; // a radius of 10
  assert.deepEqual(numberRange("index", bounds, 1.5), { min: 1, max: 2.5, log: false });
  assert.deepEqual(numberRange("absorption", bounds, 0.1), { min: 0, max: 0.5, log: false });
  assert.deepEqual(numberRange("absorption", bounds, 9), { min: 0, max: 9, log: false });
  assert.deepEqual(numberRange("mean_free_path", bounds, 0.2), { min: 0.01, max: 10, log: true });
});
