import assert from "node:assert/strict";
import { test } from "node:test";

import { readAddress, writeAddress, complaints } from "../../../web/net/address.js";
import { frameQuery } from "../../../web/net/request.js";
import { ViewModel } from "../../../web/view/model.js";
import { areHidden, areSurfaces, readHidden, readSurfaces, writeHidden, writeSurfaces } from "../../../web/view/surfaces.js";
import { SCENE } from "./fixtures.mjs";

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
