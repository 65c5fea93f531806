import assert from "node:assert/strict";
import { test } from "node:test";

import { firstOther, namesOf, RightSide } from "../../../web/isogi_web/panels/comparison.js";
import { isOneWorld, linkedCamera } from "../../../web/isogi_web/view/camera.js";
import { readDifference, ViewModel } from "../../../web/isogi_web/view/model.js";
import { knobs, SCENE } from "./fixtures.mjs";

const SERIES = { ...SCENE, ranges: { ...SCENE.ranges, time: { min: 0, max: 7 } }, defaults: { ...SCENE.defaults, time: 0 } };

/** The same scene in a box twice as large, which begins at another place and distance. */
const LARGE = {
  ...SCENE, id: "large", name: "Large",
  volume: { ...SCENE.volume, spacing: [2, 1, 2 / 3], bounds: [[0, 0, 0], [20, 20, 20]] },
  start: { azimuth: 30, elevation: 20, distance: 4, target: [11, 10, 10] },
};

test("a difference is read, and only one that the scene has", () => {
  assert.deepEqual(readDifference(SCENE, "phong"), { shading: "phong" });
  assert.deepEqual(readDifference(SCENE, "isovalue:90"), { isovalue: 90 });
  assert.deepEqual(readDifference(SERIES, "time:7"), { time: 7 });
  assert.deepEqual(readDifference(SCENE, "scene:large"), { scene: "large" });
  for (const text of ["", "nonsense", "isovalue:", "isovalue:x", "isovalue:30", "time:1", "scene:small", "fov:30"])
    assert.equal(readDifference(SCENE, text), null, text);
});

test("an isovalue begins with the next stop, a step with the next one", () => {
  assert.equal(firstOther(SCENE, "isovalue", knobs({ isovalue: 70 })), 80);
  assert.equal(firstOther(SCENE, "isovalue", knobs({ isovalue: 220 })), 230);
  assert.equal(firstOther(SERIES, "time", knobs({ time: 7 })), 6);
});

test("both sides are named by what is different", () => {
  const names = namesOf(SERIES, [SCENE, LARGE]);
  assert.deepEqual(names(knobs({ compare: "phong" })), ["Global illumination", "Phong, no shadows"]);
  assert.deepEqual(names(knobs({ compare: "isovalue:90" })), ["isovalue 70", "isovalue 90"]);
  assert.deepEqual(names(knobs({ compare: "time:3", time: 0 })), ["step 0", "step 3"]);
  assert.deepEqual(names(knobs({ compare: "scene:large" })), ["Small", "Large"]);
});

test("a camera is shared in one world, and scaled between volumes of two sizes", () => {
  assert.ok(isOneWorld(SCENE, { ...LARGE, volume: SCENE.volume }));
  assert.ok(!isOneWorld(SCENE, { volume: { ...SCENE.volume, unit: "mm" } }));
  const values = knobs({ azimuth: 77, distance: 6, target: [6, 5, 5] });
  assert.deepEqual(linkedCamera(SCENE, values, { ...LARGE, volume: SCENE.volume }).target, [6, 5, 5]);
  const { azimuth, distance, target } = linkedCamera(SCENE, values, LARGE);
  assert.deepEqual([azimuth, distance], [77, 8], "twice the fitted distance, as on the left");
  assert.deepEqual(target.map((each) => Number(each.toFixed(9))), [13, 10, 10]);
});

test("the right side differs by what is compared alone", async () => {
  const side = new RightSide(SCENE, () => assert.fail("read"), { textContent: "" });
  const values = new ViewModel(SCENE, { azimuth: 77 }).values;
  const { scene, values: right } = await side.of(values, "isovalue:90");
  assert.equal(scene, SCENE);
  assert.deepEqual(right, { ...values, isovalue: 90 });
});

test("another scene is read once, and again only after a failure", async () => {
  let reads = 0;
  const read = async () => {
    reads += 1;
    if (reads === 1) throw new Error("away");
    return LARGE;
  };
  const note = { textContent: "" };
  const side = new RightSide(SCENE, read, note);
  const values = new ViewModel(SCENE, { azimuth: 77, shading: "phong", isovalue: 60 }).values;
  await assert.rejects(side.of(values, "scene:large"), /away/);
  await side.of(values, "scene:large");
  const { scene, values: right } = await side.of({ ...values, azimuth: 78 }, "scene:large");
  assert.deepEqual([reads, scene.id, right.azimuth, right.shading, right.isovalue], [2, "large", 78, "phong", 70]);
  assert.match(note.textContent, /differ in size/);
});
