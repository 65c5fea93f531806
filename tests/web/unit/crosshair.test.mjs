/** The cross hair of the slices: where it may be, and how an address holds it. */

import assert from "node:assert/strict";
import { test } from "node:test";

import { complaints, readAddress, writeAddress } from "../../../web/net/address.js";
import { readCrossHair, writeCrossHair } from "../../../web/view/crosshair.js";
import { ViewModel } from "../../../web/view/model.js";
import { coordinatesInWords, placeInWords, sidesAt } from "../../../web/view/measures.js";
import { SCENE, knobs } from "./fixtures.mjs";

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
