/** Planes and slices: what planes leave, knobs and addresses that name them, and where slices lie and planes cross them. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { complaints, readAddress, writeAddress } from "../../../web/isogi_web/net/address.js";
import { frameQuery } from "../../../web/isogi_web/net/request.js";
import { contourOf } from "../../../web/isogi_web/slices/contour.js";
import { captionOf } from "../../../web/isogi_web/slices/figure.js";
import { liesOf, lineAcross, partLeft, sliceAt, slopeOf, stepped, voxelAt } from "../../../web/isogi_web/slices/geometry.js";
import { draggedGreys, wheelSteps } from "../../../web/isogi_web/slices/gestures.js";
import { valuesOfGreys } from "../../../web/isogi_web/net/bytes.js";
import { SliceCache, pixelsOf, turned, usualGreys } from "../../../web/isogi_web/slices/values.js";
import { draggedBy, tell } from "../../../web/isogi_web/view/handles.js";
import { readRows } from "../../../web/isogi_web/view/npy.js";
import { ViewModel } from "../../../web/isogi_web/view/model.js";
import { arePlanes, cutAt, facingPlane, movablePlanes, moved, nearestAxis, outlineOf, partPlanes, planeOf, planesOf, readPlanes, termOf, writePlanes } from "../../../web/isogi_web/view/planes.js";
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

test("screen readers hear where a plane is, and from where to where it goes", () => {
  const element = {};
  tell(element, { name: "from below along x", value: 12.34567, range: [0.5, 99.99999] });
  assert.equal(element.ariaLabel, "Cut, from below along x");
  assert.equal(element.ariaValueText, "from below along x 12.35, within 0.5 to 100");
  assert.deepEqual([element.ariaValueMin, element.ariaValueNow, element.ariaValueMax], ["0.5", "12.34567", "99.99999"]);
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

const VOXEL = [4.5, 12, 9.25];
const WHOLE = [[0, 0], [1, 0], [1, 1], [0, 1]];

/** The slices through a voxel, across z, y and x. */
function slicesAt(volume, voxel) {
  const [z, x, y] = liesOf(volume.axes ?? "").map((lie) => sliceAt(volume, lie, voxel));
  return [z, y, x];
}


/** A volume that lies turned in the world, its second axis the wrong way round. */
const TURNED = (() => {
  const [c, s, size, spacing] = [Math.cos(0.5), Math.sin(0.5), [12, 9, 15], [1, 0.5, 2]];
  const turn = [[c, s, 0], [s, -c, 0], [0, 0, -1]]; // a rotation: two axes are swapped, the third points down
  const affine = turn.map((row, i) => [...row.map((x, k) => x * spacing[k]), [-3, 20, 7][i]]);
  const corners = [0, 1, 2, 3, 4, 5, 6, 7].map((bits) => worldOf(affine, size.map((n, i) => ((bits >> i) & 1) * (n - 1))));
  const bounds = [Math.min, Math.max].map((most) => [0, 1, 2].map((i) => most(...corners.map((corner) => corner[i]))));
  return { size, spacing, affine, bounds, axes: "", letters: "", unit: "" };
})();

function worldOf(affine, voxel) {
  return affine.map((row) => row[3] + row[0] * voxel[0] + row[1] * voxel[1] + row[2] * voxel[2]);
}

/** The world's point at a place of a slice, by its voxel. */
function pointAt({ size, affine }, { lie, at }, place) {
  const voxel = [at, at, at];
  [lie.right, lie.up].forEach(({ axis, sign }, k) => {
    voxel[axis] = (sign > 0 ? place[k] : 1 - place[k]) * size[axis] - 0.5;
  });
  return worldOf(affine, voxel);
}

/** By how much a point lies beyond a plane. */
function beyond({ normal, limit }, point) {
  return normal[0] * point[0] + normal[1] * point[1] + normal[2] * point[2] - limit;
}

/** Whether a place is in a convex polygon whose corners go round to the left. */
function holds(polygon, [x, y]) {
  return polygon.length > 2 && polygon.every(([ax, ay], i) => {
    const [bx, by] = polygon[(i + 1) % polygon.length];
    return (bx - ax) * (y - ay) - (by - ay) * (x - ax) >= -1e-12;
  });
}

const GRID = Array.from({ length: 400 }, (_, i) => [((i % 20) + 0.37) / 20, (Math.floor(i / 20) + 0.61) / 20]);

test("slices go through the point, each as wide and high as its voxels", () => {
  const [z, y, x] = slicesAt({ ...TURNED, size: [10, 20, 5], spacing: [1, 0.5, 2] }, [4.5, 0, 3.96]);
  assert.deepEqual([z.lie.axis, z.at, z.extent, z.point[0], z.point[1].toFixed(3)], ["z", 3.96, [10, 10], 0.5, "0.025"]);
  assert.deepEqual([y.lie.axis, y.at, y.extent, y.point[0], y.point[1].toFixed(3)], ["y", 0, [10, 10], 0.5, "0.892"]);
  assert.deepEqual([x.lie.axis, x.at, x.extent, x.point[0].toFixed(3)], ["x", 4.5, [10, 10], "0.025"]);
});

test("a slice lies in the world where its voxels do", () => {
  for (const volume of [SCENE.volume, TURNED, { ...TURNED, axes: "LPI" }, { ...TURNED, axes: "SLA" }]) {
    for (const slice of slicesAt(volume, [3, 7.5, 9])) {
      for (const [right, up] of [[0, 0], [1, 0], [0.3, 0.8], slice.point]) {
        const here = [0, 1, 2].map((i) => slice.corner[i] + right * slice.width[i] + up * slice.height[i]);
        pointAt(volume, slice, [right, up]).forEach((x, i) => assert.ok(Math.abs(x - here[i]) < 1e-12));
      }
      assert.ok(Math.abs(Math.hypot(...slice.normal) - 1) < 1e-12);
      const along = [slice.width, slice.height].map((edge) => beyond({ normal: slice.normal, limit: 0 }, edge));
      assert.ok(Math.max(...along.map(Math.abs)) < 1e-12, "a normal is across its slice");
    }
  }
});

test("what planes leave of a slice is what lies before all of them", () => {
  for (const [volume, voxel, text] of [
    [SCENE.volume, VOXEL, "x>6.1;y<2;z>9.3;0.2,-0.5,1>1.2"], [SCENE.volume, VOXEL, "1,1,0>9.5;-3,1,0.2<-9"],
    [TURNED, [3, 7.5, 9], "x>2;y<18.2;z>-9;1,0.3,-1<13.5"],
  ]) {
    const planes = planesOf(text);
    for (const slice of slicesAt(volume, voxel)) {
      const polygon = partLeft(slice, text);
      let left = 0;
      for (const place of GRID) {
        const most = Math.max(...planes.map((plane) => beyond(plane, pointAt(volume, slice, place))));
        if (Math.abs(most) > 0.3) assert.equal(holds(polygon, place), most < 0, `${text} ${slice.lie.name} ${place}`);
        left += Number(most < 0);
      }
      assert.ok(left > 0 && left < GRID.length, `${text} crosses ${slice.lie.name}`);
    }
  }
});

test("all of a slice is left, or nothing, by planes that do not cross it", () => {
  const [z] = slicesAt(SCENE.volume, VOXEL); // at z = 9.25 / 3
  assert.deepEqual([partLeft(z, ""), partLeft(z, "z>4;x>11"), partLeft(z, "z>3")], [WHOLE, WHOLE, []]);
});

test("a slice through the face of a cut is left: faces lie a little beyond their planes", () => {
  for (const side of ["x>4", "x<4"]) {
    const outward = side[1] === ">" ? 1 : -1, slices = slicesAt(SCENE.volume, [4 + outward * 0.11, 12, 9]);
    assert.deepEqual(partLeft(slices[2], side), WHOLE);
    assert.deepEqual(partLeft(slicesAt(SCENE.volume, [4 + outward * 0.2, 12, 9])[2], side), []);
  }
});

test("a line is where a plane crosses, from edge to edge", () => {
  for (const volume of [SCENE.volume, TURNED]) {
    const planes = movablePlanes(volume, "x>2;1,1,1>17");
    for (const slice of slicesAt(volume, [3, 7.5, 9])) {
      for (const { normal, value, name } of planes) {
        const plane = { normal, limit: value };
        const ends = lineAcross(slopeOf(slice, plane));
        const crosses = new Set(GRID.map((place) => beyond(plane, pointAt(volume, slice, place)) > 0)).size > 1;
        if (crosses) assert.equal(ends.length, 2, `${name} in ${slice.lie.name}`);
        for (const end of ends) {
          assert.ok(Math.abs(beyond(plane, pointAt(volume, slice, end))) < 1e-9);
          assert.ok(Math.min(...end.map((x) => Math.abs(x * (1 - x)))) < 1e-12, "at an edge");
        }
      }
    }
  }
  const [z, , x] = slicesAt(SCENE.volume, VOXEL), sides = movablePlanes(SCENE.volume, "x>4.5;z<1");
  const across = (slice) => sides.filter(({ normal, value }) => lineAcross(slopeOf(slice, { normal, limit: value })).length).map(({ name }) => name);
  assert.deepEqual([across(z), across(x)], [["x from", "x to", "y from", "y to"], ["y from", "y to", "z from", "z to"]]);
});

test("what is cut along a slice leaves it, and takes away what is before it", () => {
  for (const volume of [SCENE.volume, TURNED]) {
    const voxel = [3.123456, 7.654321, 9.87654], point = worldOf(volume.affine, voxel);
    for (const slice of slicesAt(volume, voxel)) {
      for (const sign of [1, -1]) {
        const normal = slice.normal.map((x) => sign * x), text = cutAt("", volume.bounds, point, normal);
        assert.deepEqual(partLeft(slice, text), WHOLE, text);
        const [{ normal: given, limit }] = planesOf(text);
        assert.deepEqual(lineAcross(slopeOf(slice, { normal: given, limit })), [], "a plane in a slice is no line of it");
        for (const step of [0.3, -0.3]) {
          const beside = slicesAt(volume, voxel.map((x) => x + step)).find(({ lie }) => lie.axis === slice.lie.axis);
          assert.deepEqual(partLeft(beside, text), step * sign > 0 ? [] : WHOLE);
        }
      }
    }
  }
});

/** Which way an edge of the screen points in a patient, by the letters of voxel axes. */
function edgesOf({ right, up }, axes) {
  const opposite = { R: "L", L: "R", A: "P", P: "A", S: "I", I: "S" };
  return [right, up].map(({ axis, sign }) => (sign > 0 ? axes[axis] : opposite[axes[axis]])).join("");
}

test("slices of a patient lie as radiologists see them, however voxels lie", () => {
  for (const axes of ["RAS", "LPS", "LAS", "PIR", "ASL", "SLP", "IPR"]) {
    const lies = liesOf(axes);
    assert.deepEqual(lies.map(({ kind }) => kind), ["Axial", "Sagittal", "Coronal"], axes);
    assert.deepEqual(lies.map((lie) => edgesOf(lie, axes)), ["LA", "PS", "LS"], axes);
    assert.deepEqual(lies.map(({ sides }) => sides.join("")), ["RLAP", "APSI", "RLSI"], axes);
    assert.deepEqual(lies.map(({ across }) => "SIRLAP".indexOf(axes[across]) >> 1), [0, 1, 2], axes);
  }
});

test("elsewhere slices lie along the axes of their voxels", () => {
  for (const axes of ["", "RRS"]) { // of voxels that lie oblique no axis may be the nearest one to a side
    const lies = liesOf(axes);
    assert.deepEqual(lies.map(({ axis, right, up }) => [axis, right.axis, up.axis, right.sign, up.sign].join("")), ["z0111", "x1211", "y0211"]);
    assert.deepEqual(lies.map(({ sides }) => sides.join("")), ["", "", ""]);
  }
});

test("the voxel at a place is the one whose pixel it is on", () => {
  for (const volume of [TURNED, { ...TURNED, axes: "LPI" }, { ...TURNED, axes: "SLA" }]) {
    for (const slice of slicesAt(volume, [3, 7, 9])) {
      assert.deepEqual(voxelAt(volume, slice, slice.point), [3, 7, 9]);
      const first = voxelAt(volume, slice, [-1, 0]), last = voxelAt(volume, slice, [2, 1]);
      first.forEach((x, i) => assert.equal(Math.abs(x - last[i]), i === slice.lie.across ? 0 : volume.size[i] - 1, "at most to the edges"));
    }
  }
});

test("steps go as the screen points, and stay in the volume", () => {
  const volume = { ...TURNED, axes: "LPI" }, [axial] = liesOf("LPI");
  assert.deepEqual(stepped(volume, axial, [3, 7, 9], { right: 1 }), [4, 7, 9]);
  assert.deepEqual(stepped(volume, axial, [3, 7, 9], { up: 1 }), [3, 6, 9], "anterior");
  assert.deepEqual(stepped(volume, axial, [3, 7, 9], { across: 100 }), [3, 7, 14]);
});

/** The file that NumPy writes of rows. */
function npy(kind, numbers, rows) {
  const text = `{'descr': '${kind}', 'fortran_order': False, 'shape': (${rows}, ${numbers.length / rows}), }`.padEnd(117) + "\n";
  const head = new Uint8Array([0x93, ...new TextEncoder().encode("NUMPY"), 1, 0, text.length, 0, ...new TextEncoder().encode(text)]);
  const bytes = new Uint8Array(head.length + numbers.byteLength);
  bytes.set(head);
  bytes.set(new Uint8Array(numbers.buffer), head.length);
  return bytes.buffer;
}

test("values are read from every kind of file that the server sends", () => {
  const kinds = { "|u1": Uint8Array, "<u2": Uint16Array, "<i2": Int16Array, "<f4": Float32Array, "<f8": Float64Array };
  for (const [kind, Kind] of Object.entries(kinds)) {
    const { values, width, height } = readRows(npy(kind, Kind.from([1, 2, 3, 4, 5, 6]), 2));
    assert.deepEqual([[...values], width, height], [[1, 2, 3, 4, 5, 6], 3, 2], kind);
  }
  assert.throws(() => readRows(npy("<c8", Float32Array.from([1, 2]), 1)), TypeError);
});

test("values of a grey picture are read as those of a file", () => {
  for (const [width, height] of [[3, 2], [1, 7], [123, 45]]) {
    const data = Uint8ClampedArray.from({ length: 4 * width * height }, (_, i) => (i % 4 === 3 ? 255 : (i >> 2) % 256));
    const found = readRows(valuesOfGreys({ data, width, height }, [10, 61]));
    assert.deepEqual([found.width, found.height, found.values.length], [width, height, width * height]);
    found.values.forEach((value, i) => assert.ok(Math.abs(value - (10 + 0.2 * (i % 256))) < 1e-5));
  }
});

test("values lie on the screen where their voxels do", () => {
  const size = [4, 3, 5], volume = { ...TURNED, size };
  for (const axes of ["", "RAS", "LPI", "SLA", "PIR"]) {
    for (const lie of liesOf(axes)) {
      const [first, second] = [0, 1, 2].filter((axis) => axis !== lie.across), sent = [];
      for (let row = size[second] - 1; row >= 0; row -= 1) { // as the server has them
        for (let column = 0; column < size[first]; column += 1) sent.push(10 * row + column);
      }
      const { values, width, height } = turned({ values: Uint8Array.from(sent), width: size[first], height: size[second] }, lie);
      for (let y = 0; y < height; y += 1) {
        for (let x = 0; x < width; x += 1) {
          const voxel = voxelAt(volume, sliceAt(volume, lie, [1, 1, 1]), [(x + 0.5) / width, 1 - (y + 0.5) / height]);
          assert.equal(values[y * width + x], 10 * voxel[second] + voxel[first], `${axes} ${lie.name}`);
        }
      }
    }
  }
});

test("black is the first grey and below, white the second and above", () => {
  const values = Float32Array.from([-5, 10, 15, 20, 99, NaN]);
  const pixels = pixelsOf({ values, width: 3, height: 2 }, [10, 20]);
  assert.deepEqual([...pixels].filter((_, i) => i % 4 === 0), [0, 0, 128, 255, 255, 0]);
  assert.ok([...pixels].every((x, i) => (i % 4 === 3 ? x === 255 : x === pixels[i - (i % 4)])), "opaque and grey");
});

test("at first a few voxels far out are whiter than white", () => {
  const edges = [0, 1, 2, 3, 4, 5];
  assert.deepEqual(usualGreys({ counts: [500, 300, 200, 1, 1], edges }), [0, 3]);
  assert.deepEqual(usualGreys({ counts: [1, 300, 200, 1, 300], edges }), [1, 5]);
  assert.deepEqual(usualGreys({ counts: [9, 0, 0, 0, 9], edges }), [0, 5]);
  assert.deepEqual(usualGreys({ counts: [5], edges: [2, 3] }), [2, 3]);
});

test("slices that were read are kept until others need the room", async () => {
  const asked = [], [lie] = liesOf("");
  const cache = new SliceCache(async (axis, at) => {
    asked.push(at);
    return at === 7 ? null : npy("<f8", new Float64Array(1 << 21), 1024); // 16 MiB
  });
  for (const at of [1, 2, 3, 1, 4]) assert.equal((await cache.find(lie, at)).height, 1024);
  assert.deepEqual(asked, [1, 2, 3, 4]);
  await cache.find(lie, 5);
  await cache.find(lie, 1);
  assert.deepEqual(asked, [1, 2, 3, 4, 5], "1 was read later than 2");
  await cache.find(lie, 2);
  assert.deepEqual(asked, [1, 2, 3, 4, 5, 2]);
  assert.equal(await cache.find(lie, 7), null);
});

/** A slice of a field that is known everywhere. */
function sampled(field, width, height, Kind = Float64Array) {
  const values = Kind.from({ length: width * height }, (_, i) => field((i % width) + 0.5, Math.floor(i / width) + 0.5));
  return { values, width, height };
}

/** Both ends of each line. */
function endsOf(lines) {
  return Array.from({ length: lines.length / 2 }, (_, i) => [lines[2 * i], lines[2 * i + 1]]);
}

test("the contour of a disc is its circle", () => {
  const lines = contourOf(sampled((x, y) => 20 - Math.hypot(x - 30, y - 25), 64, 50), 5); // radius 15
  const ends = endsOf(lines);
  for (const [x, y] of ends) assert.ok(Math.abs(Math.hypot(x - 30, y - 25) - 15) < 0.02, `${x}, ${y}`);
  const length = ends.reduce((sum, [x, y], i) => (i % 2 ? sum + Math.hypot(x - ends[i - 1][0], y - ends[i - 1][1]) : sum), 0);
  assert.ok(Math.abs(length / (2 * Math.PI * 15) - 1) < 0.002);
  const counts = new Map();
  for (const end of ends) counts.set(end.map((x) => x.toFixed(9)).join(), (counts.get(end.map((x) => x.toFixed(9)).join()) ?? 0) + 1);
  assert.deepEqual([...new Set(counts.values())], [2], "it is closed");
});

test("a contour parts exactly the voxels above from those below", () => {
  let seed = 7;
  const random = () => (seed = (seed * 16807) % 2147483647) / 2147483647;
  const slice = sampled(() => Math.floor(256 * random()), 17, 13, Uint8Array), { values, width, height } = slice;
  for (const isovalue of [0.5, 100, 127.5, 128, 250]) {
    const ends = new Set(endsOf(contourOf(slice, isovalue)).map(([x, y]) => `${x.toFixed(9)} ${y.toFixed(9)}`));
    const expected = new Set();
    for (let i = 0; i < values.length; i += 1) {
      const [x, y] = [i % width, Math.floor(i / width)];
      for (const [right, down] of [[1, 0], [0, 1]]) {
        const other = x + right < width && y + down < height ? values[i + right + down * width] : values[i];
        if (values[i] > isovalue === other > isovalue) continue;
        const share = (isovalue - values[i]) / (other - values[i]);
        expected.add(`${(x + 0.5 + right * share).toFixed(9)} ${(y + 0.5 + down * share).toFixed(9)}`);
      }
    }
    assert.deepEqual(ends, expected, `at ${isovalue}`);
  }
});

test("where two corners across are solid the contour goes as the values between them do", () => {
  for (const [corners, isovalue] of [[[9, 0, 0, 5], 3.2], [[9, 0, 0, 5], 3.3], [[0, 9, 5, 0], 3.2], [[0, 9, 5, 0], 3.3]]) {
    const lines = contourOf({ values: Float64Array.from(corners), width: 2, height: 2 }, isovalue);
    const cutOff = [0, 4].map((from) => {
      const [x, y] = [(lines[from] + lines[from + 2]) / 2 - 0.5, (lines[from + 1] + lines[from + 3]) / 2 - 0.5];
      return Math.round(x) + 2 * Math.round(y);
    });
    const saddle = 45 / 14; // the value where the values between four corners have neither a maximum nor a minimum
    const expected = [0, 1, 2, 3].filter((i) => corners[i] > isovalue !== saddle > isovalue);
    assert.deepEqual(cutOff.sort(), expected, `${corners} at ${isovalue}`);
  }
});

test("a hole has no contour around it", () => {
  const lines = contourOf({ values: Float32Array.from([0, 9, 9, 0, NaN, 9, 0, 9, 9]), width: 3, height: 3 }, 5);
  assert.deepEqual(lines, []);
});

test("a drag to the right widens the window, and down it raises the level", () => {
  assert.deepEqual(draggedGreys([0, 100], 0, 0), [0, 100]);
  assert.deepEqual(draggedGreys([0, 100], 100, 0), [-50, 150]);
  assert.deepEqual(draggedGreys([0, 100], -100, 0), [25, 75]);
  assert.deepEqual(draggedGreys([0, 100], 0, 100), [50, 150]);
  const [black, white] = draggedGreys([0, 1], -5000, 3000);
  assert.ok(black < white || black === white, "never the wrong way round");
});

test("a notch of any wheel is one slice, and a touchpad goes through them slowly", () => {
  const steps = wheelSteps(), go = (deltaY, deltaMode = 0) => steps({ deltaY, deltaMode });
  assert.deepEqual([go(-120), go(-100), go(53), go(-3, 1)], [1, 1, -1, 1]);
  assert.deepEqual([20, 20, 20, 20, 20].map((by) => go(by)), [0, 0, -1, 0, 0]);
  assert.deepEqual([go(-30), go(-30)], [0, 1], "the other way begins anew");
});

test("a caption has the coordinate that all of a slice has", () => {
  const { volume } = SCENE, plain = slicesAt(volume, [4, 12, 9]);
  assert.deepEqual(plain.map((slice) => captionOf(volume, slice, [4, 12, 9])), ["z 3", "y 6", "x 4"]);
  const patient = { ...volume, letters: "RAS", axes: "RAS", unit: "mm", affine: [[1, 0, 0, -20], [0, 0.5, 0, 0], [0, 0, 1 / 3, 0]] };
  const captions = liesOf("RAS").map((lie) => captionOf(patient, sliceAt(patient, lie, [4, 12, 9]), [4, 12, 9]));
  assert.deepEqual(captions, ["Axial · S 3 mm", "Sagittal · L 16 mm", "Coronal · A 6 mm"]);
  const [z, y] = slicesAt(TURNED, [3, 7, 9]);
  assert.deepEqual([captionOf(TURNED, z, [3, 7, 9]), captionOf({ ...TURNED, unit: "mm" }, y, [3, 7, 9])], ["z −11", "voxel y 7"]);
});
