/** Planes: what they leave along each axis, and the knobs, addresses and requests that name them. */

import assert from "node:assert/strict";
import { test } from "node:test";

import { complaints, readAddress, writeAddress } from "../../../web/net/address.js";
import { frameQuery } from "../../../web/net/request.js";
import { ViewModel } from "../../../web/view/model.js";
import { arePlanes, readPlanes, writePlanes } from "../../../web/view/planes.js";
import { SCENE, knobs } from "./fixtures.mjs";

const { bounds } = SCENE.volume;
const SIZE = { width: 40, height: 30 };

test("planes leave what lies before them", () => {
  assert.deepEqual(readPlanes("x>4; x<1;1,0,1>3;z>99", bounds), { kept: [[1, 4], [0, 10], [0, 10]], others: ["1,0,1>3"] });
  assert.deepEqual(readPlanes("x>4;x<6", bounds).kept[0], [4, 4]);
});

test("what is read is written again", () => {
  for (const text of ["", "x<1;x>4;z<2.5", "y>0.5;0.5,-1,2<3"]) assert.equal(writePlanes(readPlanes(text, bounds), bounds), text);
});

test("what spells no planes is told", () => {
  for (const text of ["x>1", "x<-2.5;z>1e3", "1,0,-2>.5"]) assert.ok(arePlanes(text), text);
  for (const text of ["", "x", "x=1", "w>1", "x>1&y>2", "1,2>3", Array(13).fill("x>1").join(";"), null]) assert.ok(!arePlanes(text));
});

test("a view that moves looks through a window, one at rest is cut", () => {
  assert.equal(frameQuery(SCENE, knobs({ planes: "x>4" }), SIZE).cut, "x>4");
  assert.equal(frameQuery(SCENE, knobs({ planes: "x>4" }), SIZE, true).window, "x>4");
  const dark = frameQuery(SCENE, knobs({ planes: "x>4", opened: false }), SIZE);
  assert.ok(dark.window === "x>4" && !("cut" in dark));
  const whole = frameQuery(SCENE, knobs(), SIZE, true);
  assert.ok(!("cut" in whole) && !("window" in whole));
});

test("the address keeps planes, and whether light comes in", () => {
  for (const opened of [true, false]) {
    const { start } = readAddress(writeAddress(SCENE, knobs({ planes: "x>4;z<1", opened })));
    assert.deepEqual([start.planes, start.opened], ["x>4;z<1", opened]);
  }
  assert.deepEqual(complaints("?cut=wall", SCENE), ["“wall” is no cut: it is planes such as x>40."]);
  assert.deepEqual(complaints("?window=x%3E40", SCENE), []);
});

test("a view takes planes that are some, and opens none across the voxels", () => {
  const view = new ViewModel(SCENE, { planes: "wall" });
  assert.equal(view.values.planes, "");
  view.set({ planes: "x>4" });
  assert.deepEqual([view.values.planes, view.values.opened], ["x>4", true]);
  view.set({ planes: "" });
  assert.equal(view.values.planes, "");
  assert.equal(new ViewModel({ ...SCENE, cuts: false }, { planes: "x>4", opened: true }).values.opened, false);
});
