/** Slices: where they lie in the world, what planes leave of them, and where planes cross them. */

import assert from "node:assert/strict";
import { test } from "node:test";

import { cutAt, movablePlanes, planesOf } from "../../../web/view/planes.js";
import { lineAcross, partLeft, slicesAt, slopeOf } from "../../../web/view/slices.js";
import { SCENE } from "./fixtures.mjs";

const VOXEL = [4.5, 12, 9.25];
const WHOLE = [[0, 0], [1, 0], [1, 1], [0, 1]];
const COLUMNS = { z: [0, 1], y: [0, 2], x: [1, 2] };

/** A volume that lies turned in the world, its second axis the wrong way round. */
const TURNED = (() => {
  const [c, s, size, spacing] = [Math.cos(0.5), Math.sin(0.5), [12, 9, 15], [1, 0.5, 2]];
  const turn = [[c, s, 0], [s, -c, 0], [0, 0, -1]]; // a rotation: two axes are swapped, the third points down
  const affine = turn.map((row, i) => [...row.map((x, k) => x * spacing[k]), [-3, 20, 7][i]]);
  const corners = [0, 1, 2, 3, 4, 5, 6, 7].map((bits) => worldOf(affine, size.map((n, i) => ((bits >> i) & 1) * (n - 1))));
  const bounds = [Math.min, Math.max].map((most) => [0, 1, 2].map((i) => most(...corners.map((corner) => corner[i]))));
  return { size, spacing, affine, bounds };
})();

function worldOf(affine, voxel) {
  return affine.map((row) => row[3] + row[0] * voxel[0] + row[1] * voxel[1] + row[2] * voxel[2]);
}

/** The world's point at a place of a slice, by its voxel. */
function pointAt({ size, affine }, { axis, at }, [right, up]) {
  const [column, row] = COLUMNS[axis], voxel = [at, at, at];
  [voxel[column], voxel[row]] = [right * size[column] - 0.5, up * size[row] - 0.5];
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
  assert.deepEqual([z.axis, z.at, z.ratio, z.point, z.name], ["z", 3.96, 1, [0.5, 0.025], "z 4"]);
  assert.deepEqual([y.axis, y.at, y.ratio, y.point[0], y.point[1].toFixed(3)], ["y", 0, 1, 0.5, "0.892"]);
  assert.deepEqual([x.axis, x.at, x.ratio, x.point[0]], ["x", 4.5, 1, 0.025]);
});

test("a slice lies in the world where its voxels do", () => {
  for (const volume of [SCENE.volume, TURNED]) {
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
        if (Math.abs(most) > 0.3) assert.equal(holds(polygon, place), most < 0, `${text} ${slice.name} ${place}`);
        left += Number(most < 0);
      }
      assert.ok(left > 0 && left < GRID.length, `${text} crosses ${slice.name}`);
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
        if (crosses) assert.equal(ends.length, 2, `${name} in ${slice.name}`);
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
          const beside = slicesAt(volume, voxel.map((x) => x + step)).find(({ axis }) => axis === slice.axis);
          assert.deepEqual(partLeft(beside, text), step * sign > 0 ? [] : WHOLE);
        }
      }
    }
  }
});
