import assert from "node:assert/strict";
import { test } from "node:test";
import { AXIS_VIEWS, boxOf, limitTarget, looksAlong, pan, placeOf, rayThrough, sidesOf, towardsEye } from "../../../web/isogi_web/view/camera.js";
import { dragObject, hold, pinched, wheelZoom } from "../../../web/isogi_web/view/gestures.js";
import { spotOf } from "../../../web/isogi_web/view/marks.js";
import { pictureSize } from "../../../web/isogi_web/view/picture.js";
import { aboutAxis, cameraAxes, compose, dragLight, fromAngles, rollLight, toAngles, turnVector } from "../../../web/isogi_web/view/rotation.js";
import { SCENE, close, knobs } from "./fixtures.mjs";

const RADIUS = Math.sqrt(75); // half the diagonal of 10 × 10 × 10

const dot = (a, b) => a.reduce((sum, x, i) => sum + x * b[i], 0);
const minus = (a, b) => a.map((x, i) => x - b[i]);

test("the box ends at the outermost voxels", () => {
  const { high, centre, radius } = boxOf(SCENE);
  close([...high, ...centre, radius], [10, 10, 10, 5, 5, 5, RADIUS]);
});

test("a box elsewhere in the world keeps its target there", () => {
  const scene = { volume: { ...SCENE.volume, bounds: [[-110, 20, 0], [-100, 30, 10]] } };
  close(boxOf(scene).centre, [-105, 25, 5]);
  assert.deepEqual(limitTarget(scene, [-105, 1e9, -1e9]), [-105, Number((30 + RADIUS / 2).toPrecision(6)), Number((-RADIUS / 2).toPrecision(6))]);
});

test("the sides of a patient are named, looked at from the front and from the left", () => {
  const head = { volume: { letters: "RAS" } };
  assert.deepEqual(sidesOf(head, { azimuth: 90, elevation: 0 }), { left: "R", right: "L", top: "S", bottom: "I" });
  assert.deepEqual(sidesOf(head, { azimuth: 180, elevation: 0 }), { left: "A", right: "P", top: "S", bottom: "I" });
  assert.deepEqual(sidesOf(SCENE, { azimuth: 0, elevation: 0 }), { left: "", right: "", top: "", bottom: "" });
});

test("a target stays within half a radius of the box", () => {
  const limit = Number((0.5 * RADIUS).toPrecision(6));
  assert.deepEqual(limitTarget(SCENE, [-1e9, 5, 1e9]), [-limit, 5, Number((10 + 0.5 * RADIUS).toPrecision(6))]);
});

test("what is no point is the volume's centre", () => {
  for (const target of [null, "1,2,3", [1, 2], [1, NaN, 3], [1, 2, 3, 4], undefined]) assert.equal(limitTarget(SCENE, target), null);
});

test("a target has digits that an address can hold", () => {
  assert.deepEqual(limitTarget(SCENE, [1 / 3, 2 / 3, 1e-9]), [0.333333, 0.666667, 1e-9]);
});

test("a picture moved by its height moves by what it spans", () => {
  const view = knobs({ fov: 90, distance: 2, azimuth: 0, elevation: 0 }); // tan 45° is 1; right is +y, up is +z
  const span = 2 * 2 * RADIUS;
  close(pan(SCENE, view, 1, 0).target, [5, 5 - span, 5]);
  close(pan(SCENE, view, 0, 1).target, [5, 5, 5 + span]);
});

test("a picture moved there and back is where it was", () => {
  const view = knobs({ target: [1, 2, 3] });
  const there = pan(SCENE, view, 0.3, -0.2);
  close(pan(SCENE, { ...view, ...there }, -0.3, 0.2).target, [1, 2, 3]);
});

test("the ray through the middle meets the target", () => {
  const { eye, target, up } = rayThrough(SCENE, knobs({ azimuth: 90, elevation: 0, distance: 3 }), 0, 0);
  close(eye, [5, 5 + 3 * RADIUS, 5]);
  close(target, [5, 5, 5]);
  close(up, [0, 0, 1]);
});

test("the ray through the upper edge leaves at half the fov", () => {
  const view = knobs({ fov: 40, azimuth: 12, elevation: 34 });
  const { eye, target } = rayThrough(SCENE, view, 0, 0.5);
  const ray = minus(target, eye);
  const cosine = -dot(ray, cameraAxes(12, 34).out) / Math.hypot(...ray);
  assert.ok(Math.abs((Math.acos(cosine) * 180) / Math.PI - 20) < 1e-9);
});

test("axis views look along their axis", () => {
  for (const [name, { azimuth, elevation }] of Object.entries(AXIS_VIEWS)) {
    const axis = [0, 0, 0];
    axis["xyz".indexOf(name[1])] = name[0] === "+" ? 1 : -1;
    close(cameraAxes(azimuth, elevation).out, axis);
  }
});

test("from above and from below x goes to the right", () => {
  for (const name of ["+z", "-z"]) close(cameraAxes(AXIS_VIEWS[name].azimuth, 0).right, [1, 0, 0]);
});

test("looking along an axis is the same a turn later", () => {
  const view = AXIS_VIEWS["-x"];
  assert.ok(looksAlong(view, { azimuth: -180, elevation: 0.04 }));
  assert.ok(!looksAlong(view, { azimuth: 179.9, elevation: 0 }));
  assert.ok(!looksAlong(view, { azimuth: 180, elevation: 0.06 }));
});

test("an object dragged right is seen from further left", () => {
  assert.deepEqual(dragObject({ azimuth: 30, elevation: 20 }, 5, 7), { azimuth: 25, elevation: 27 });
});

test("fingers are held by their middle and their spread", () => {
  assert.deepEqual(hold([{ x: 0, y: 0 }, { x: 6, y: 8 }]), { x: 3, y: 4, spread: 10 });
  assert.deepEqual(hold([{ x: 7, y: 9 }]), { x: 7, y: 9, spread: 0 });
});

test("fingers twice as far apart halve the distance", () => {
  const grip = { x: 100, y: 100, spread: 50, values: knobs({ distance: 4 }) };
  const { distance, target } = pinched(200, SCENE, grip, { x: 100, y: 100, spread: 100 });
  assert.equal(distance, 2);
  close(target, [5, 5, 5]);
});

test("fingers that close up do not divide by zero", () => {
  const grip = { x: 0, y: 0, spread: 50, values: knobs({ distance: 4 }) };
  assert.equal(pinched(200, SCENE, grip, { x: 0, y: 0, spread: 0 }).distance, 200);
});

test("a wheel turned there and back keeps the distance", () => {
  const step = { deltaY: 120, deltaMode: 0, ctrlKey: false };
  assert.ok(wheelZoom(step) > 1);
  assert.ok(Math.abs(wheelZoom(step) * wheelZoom({ ...step, deltaY: -120 }) - 1) < 1e-12);
});

test("a wheel that counts lines zooms as 16 pixels each", () => {
  const lines = wheelZoom({ deltaY: 3, deltaMode: 1, ctrlKey: false });
  assert.equal(lines, wheelZoom({ deltaY: 48, deltaMode: 0, ctrlKey: false }));
});

test("a picture has the box's pixels, at most 1024 a side", () => {
  assert.deepEqual(pictureSize(600, 400, 1, 1), { width: 600, height: 400 });
  assert.deepEqual(pictureSize(600, 400, 1.5, 1), { width: 900, height: 600 });
  assert.deepEqual(pictureSize(600, 400, 3, 1), { width: 900, height: 600 }, "finer screens show no more");
  assert.deepEqual(pictureSize(600, 400, 3, 1, true), { width: 1800, height: 1200 }, "but of a picture that has its light");
  const { width, height } = pictureSize(8000, 4000, 2, 1, true);
  assert.ok(width * height <= 2048 * 2048 && width > 2800 && Math.abs(width / height - 2) < 1e-3, "as a server takes");
  assert.deepEqual(pictureSize(2048, 1024, 1, 1), { width: 1024, height: 512 });
});

test("a draft is smaller, and no side below 64", () => {
  assert.deepEqual(pictureSize(800, 400, 1, 0.5), { width: 400, height: 200 });
  assert.deepEqual(pictureSize(800, 100, 1, 0.25), { width: 200, height: 64 });
});

test("what a ray goes through is at its place in the picture", () => {
  for (const view of [knobs(), knobs({ azimuth: -130, elevation: 70, fov: 90, distance: 1.5, target: [1, 2, 3] })]) {
    for (const [right, up] of [[0, 0], [0.4, -0.3], [-0.7, 0.5]]) {
      const { eye, target } = rayThrough(SCENE, view, right, up);
      const ray = minus(target, eye);
      for (const far of [0.5, 1, 3]) {
        const place = placeOf(SCENE, view, eye.map((x, i) => x + far * ray[i]));
        close([place.right, place.up, place.depth], [right, up, far * view.distance * RADIUS], 1e-9);
      }
      assert.ok(placeOf(SCENE, view, eye.map((x, i) => x - ray[i])).depth < 0, "behind the eye");
    }
  }
});

test("parallel rays go through their places, and nothing is behind the eye", () => {
  const view = knobs({ azimuth: -130, elevation: 70, distance: 1.5, target: [1, 2, 3], projection: "orthographic" });
  const middle = rayThrough(SCENE, view, 0, 0);
  const way = minus(middle.target, middle.eye);
  for (const [right, up] of [[0.4, -0.3], [-0.7, 0.5]]) {
    const { eye, target } = rayThrough(SCENE, view, right, up);
    close(minus(target, eye), way, 1e-6);
    for (const along of [-20, 0, 20]) {
      const point = target.map((x, i) => x + (along * way[i]) / Math.hypot(...way));
      const place = placeOf(SCENE, view, point);
      close([place.right, place.up], [right, up], 1e-9);
      assert.ok(place.depth > 0);
    }
  }
  const perspective = rayThrough(SCENE, { ...view, projection: "perspective" }, 0.4, -0.3).target;
  close(rayThrough(SCENE, view, 0.4, -0.3).target, perspective, 1e-9);
});

test("a spot is on the stage, or it is not", () => {
  assert.deepEqual(spotOf({ right: 0.25, up: -0.5, depth: 3 }, 400, 200), { x: 250, y: 200, inside: true });
  assert.equal(spotOf({ right: 1.1, up: 0, depth: 3 }, 400, 200).inside, false);
  assert.equal(spotOf({ right: 0, up: 0, depth: -3 }, 400, 200).inside, false);
});

test("from a point to the eye it is along the view's rays", () => {
  const point = [2, 9, 7], values = knobs({ azimuth: 40, elevation: 25 }), { eye } = rayThrough(SCENE, values, 0, 0);
  close(towardsEye(SCENE, values, point), eye.map((x, i) => x - point[i]));
  const towards = towardsEye(SCENE, { ...values, projection: "orthographic" }, point);
  close(towards.map((x) => x / Math.hypot(...towards)), cameraAxes(40, 25).out);
});

const H = Math.SQRT1_2;
const DRAGS = 100_000;

/** Distance of two rotations, of which q and -q are one. */
function apart(a, b) {
  const sign = Math.sign(a.reduce((sum, x, i) => sum + x * b[i], 0));
  return Math.hypot(...a.map((x, i) => x - sign * b[i]));
}

/** Numbers in -0.5..0.5 that are the same in every run. */
function randoms(seed = 1) {
  return () => (seed = (seed * 16807) % 2147483647) / 2147483647 - 0.5;
}

test("azimuth 0 looks from +x and azimuth 90 from +y", () => {
  close(cameraAxes(0, 0).out, [1, 0, 0]);
  close(cameraAxes(90, 0).out, [0, 1, 0]);
  close(cameraAxes(0, 90).out, [0, 0, 1]);
});

test("the axes of a camera are a right-handed frame", () => {
  for (const [azimuth, elevation] of [[0, 0], [25, 15], [-170, 80], [359, -89]]) {
    const { right, up, out } = cameraAxes(azimuth, elevation);
    const cross = [0, 1, 2].map((i) => right[(i + 1) % 3] * up[(i + 2) % 3] - right[(i + 2) % 3] * up[(i + 1) % 3]);
    close(cross, out);
    close([Math.hypot(...right), Math.hypot(...up)], [1, 1]);
  }
});

test("90 degrees about z turns x to y", () => {
  close(aboutAxis([0, 0, 1], 90), [H, 0, 0, H]);
  close(turnVector(aboutAxis([0, 0, 1], 90), [1, 0, 0]), [0, 1, 0]);
});

test("compose does the second rotation first", () => {
  const both = compose(aboutAxis([0, 0, 1], 90), aboutAxis([1, 0, 0], 90));
  close(turnVector(both, [0, 1, 0]), [0, 0, 1]); // y to z about x, and z stays about z
});

test("compose is the quaternion product: ij = k, ji = -k", () => {
  close(compose([0, 1, 0, 0], [0, 0, 1, 0]), [0, 0, 0, 1]);
  close(compose([0, 0, 1, 0], [0, 1, 0, 0]), [0, 0, 0, -1]);
});

test("yaw, pitch and roll are about z, y and x in turn", () => {
  close(turnVector(fromAngles({ yaw: 90, pitch: 0, roll: 0 }), [1, 0, 0]), [0, 1, 0]);
  close(turnVector(fromAngles({ yaw: 0, pitch: 90, roll: 0 }), [1, 0, 0]), [0, 0, -1]);
  close(turnVector(fromAngles({ yaw: 0, pitch: 0, roll: 90 }), [0, 1, 0]), [0, 0, 1]);
  close(turnVector(fromAngles({ yaw: 90, pitch: 90, roll: 0 }), [0, 0, 1]), [0, 1, 0]); // z to x about y, then to y
});

test("angles survive the way to a quaternion and back", () => {
  for (const angles of [[0, 0, 0], [10, 20, 30], [-170, 89, 179], [135, -45, -90]]) {
    const [yaw, pitch, roll] = angles;
    close(Object.values(toAngles(fromAngles({ yaw, pitch, roll }))), angles, 1e-9);
  }
});

test("at pitch 90 the roll is 0 and the rotation the same", () => {
  for (const pitch of [90, -90]) {
    const q = fromAngles({ yaw: 40, pitch, roll: 25 });
    const angles = toAngles(q);
    assert.equal(angles.roll, 0);
    assert.ok(apart(fromAngles(angles), q) < 1e-7); // the arc sine has half the digits there
  }
});

test("a turned vector keeps its length", () => {
  const turned = turnVector(fromAngles({ yaw: 11, pitch: 22, roll: 33 }), [3, -4, 12]);
  assert.ok(Math.abs(Math.hypot(...turned) - 13) < 1e-12);
});

test("a light dragged right turns about the vertical", () => {
  const angles = dragLight({ azimuth: 77, elevation: 33, yaw: 5, pitch: 0, roll: 0 }, 10, 0);
  close([angles.yaw, angles.pitch, angles.roll], [15, 0, 0], 1e-9);
});

test("a light dragged down turns about the picture's right", () => {
  const angles = dragLight({ azimuth: -90, elevation: 0, yaw: 0, pitch: 0, roll: 0 }, 0, 10); // right is +x
  close([angles.yaw, angles.pitch, angles.roll], [0, 0, 10], 1e-9);
});

test("a ball rolled right turns about the picture's up", () => {
  const view = { azimuth: 30, elevation: 40, yaw: 12, pitch: -20, roll: 7 };
  const { up } = cameraAxes(30, 40);
  const wanted = compose(aboutAxis(up, 15), fromAngles(view));
  assert.ok(apart(fromAngles(rollLight(view, 15, 0)), wanted) < 1e-12);
});

test("a hundred thousand drags are the rotation they make", () => {
  const random = randoms();
  let [values, truth, worst] = [{ yaw: 0, pitch: 0, roll: 0 }, [1, 0, 0, 0], 0];
  for (let i = 0; i < DRAGS; i++) {
    const [azimuth, elevation, right, down] = [360, 160, 10, 10].map((range) => range * random());
    values = dragLight({ ...values, azimuth, elevation }, right, down);
    const tilt = aboutAxis(cameraAxes(azimuth, elevation).right, down);
    truth = compose(aboutAxis([0, 0, 1], right), compose(tilt, truth));
    truth = truth.map((x) => x / Math.hypot(...truth));
    worst = Math.max(worst, apart(fromAngles(values), truth));
  }
  assert.ok(worst < 1e-9, String(worst));
});
