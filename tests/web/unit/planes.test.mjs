/** Planes: what they leave along each axis, and the knobs, addresses and requests that name them. */

import assert from "node:assert/strict";
import { test } from "node:test";

import { complaints, readAddress, writeAddress } from "../../../web/net/address.js";
import { frameQuery } from "../../../web/net/request.js";
import { ViewModel } from "../../../web/view/model.js";
import { draggedBy } from "../../../web/view/handles.js";
import { arePlanes, cutAt, facingPlane, movablePlanes, moved, nearestAxis, outlineOf, partPlanes, planeOf, readPlanes, termOf, writePlanes } from "../../../web/view/planes.js";
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

test("light comes in by planes across axes, and oblique ones are a window", () => {
  const both = knobs({ planes: "x>4;1,1,0>9;0,0,-2<-4" });
  assert.deepEqual(partPlanes(both.planes), { along: "x>4;0,0,-2<-4", oblique: "1,1,0>9" });
  const { cut, window } = frameQuery(SCENE, both, SIZE);
  assert.deepEqual([cut, window], ["x>4;0,0,-2<-4", "1,1,0>9"]);
  assert.equal(frameQuery(SCENE, both, SIZE, true).window, both.planes);
  const { start } = readAddress(writeAddress(SCENE, both));
  assert.deepEqual([start.planes, start.opened], ["x>4;0,0,-2<-4;1,1,0>9", true]);
});

test("each side of what is left, and each oblique plane, is moved along its normal", () => {
  const planes = movablePlanes(SCENE.volume, "x>4;1,1,0>9");
  assert.deepEqual(planes.map(({ name }) => name), ["x from", "x to", "y from", "y to", "z from", "z to", "plane 1"]);
  assert.equal(moved(planes[1], 2.5), "x>2.5;1,1,0>9");
  assert.equal(moved(planes[0], 99), "x<4;x>4;1,1,0>9", "no side passes the other");
  assert.equal(moved(planes[1], planes[1].open), "1,1,0>9");
  const oblique = planeOf(moved(planes[6], 5).split(";")[1]);
  assert.ok(Math.abs(oblique.limit - 5) < 1e-3 && Math.abs(oblique.normal[0] - Math.SQRT1_2) < 1e-3);
});

test("an oblique plane has an outline within what is left, and faces whom it should", () => {
  const box = [[0, 10], [0, 10], [0, 10]], s = Math.sqrt(1 / 3);
  const corners = outlineOf([s, s, s], 15 * s, box);
  assert.equal(corners.length, 6, "through the middle of a cube, across its diagonal");
  for (const corner of corners) assert.ok(Math.abs(corner[0] + corner[1] + corner[2] - 15) < 1e-9);
  assert.deepEqual(outlineOf([s, s, s], 99, box), []);
  assert.equal(termOf(facingPlane({ kept: box, others: [] }, [0, 0, 1])), "0,0,1>5");
});

test("a click cuts away what is before it, across the axis that looks most at the viewer", () => {
  assert.equal(cutAt("", bounds, [4, 5, 6], nearestAxis([0.9, 0.1, 0.2])), "x>4");
  assert.equal(cutAt("y>8", bounds, [4, 5, 6], nearestAxis([1, -9, 2])), "y<5;y>8");
});

test("a cut across no axis is an oblique plane, one for each direction, and six at most", () => {
  const cut = (text, normal) => cutAt(text, bounds, [4, 5, 6], normal);
  assert.equal(cut("x>7", [0.6, 0.8, 0]), "x>7;0.6,0.8,0>6.4");
  assert.equal(cut("x>7;0.6,0.8,0>2;1,1,1>9", [0.6, 0.8, 0]), "x>7;1,1,1>9;0.6,0.8,0>6.4");
  assert.equal(cut("0.6,0.8,0>2", [-0.6, -0.8, 0]), "0.6,0.8,0>2;-0.6,-0.8,0>-6.4", "the other side");
  const full = [1, 2, 3, 4, 5, 6].map((k) => `1,1,0>${k}`);
  assert.equal(cut(full.join(";"), [0.6, 0.8, 0]), [...full.slice(1), "0.6,0.8,0>6.4"].join(";"));
});

test("a plane follows the pointer along its normal in the picture", () => {
  const values = knobs({ azimuth: 0, elevation: 0 }), at = [5, 5, 5];
  const up = draggedBy(SCENE, values, { at, normal: [0, 0, 1] }, { right: 0, down: -0.1 });
  assert.ok(up > 0.5 && Math.abs(up + draggedBy(SCENE, values, { at, normal: [0, 0, -1] }, { right: 0, down: -0.1 })) < 1e-9);
  const across = [[1, 0, 0], [0, 1, 0]].map((normal) => Math.abs(draggedBy(SCENE, values, { at, normal }, { right: 0.1, down: 0 })));
  assert.ok(Math.max(...across) > 0.5, "to the right by one axis");
});
