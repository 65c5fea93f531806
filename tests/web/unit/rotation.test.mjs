import assert from "node:assert/strict";
import { test } from "node:test";
import { aboutAxis, cameraAxes, compose, dragLight, fromAngles, rollLight, toAngles, turnVector } from "../../../web/view/rotation.js";

const H = Math.SQRT1_2;
const DRAGS = 100_000;

function close(actual, expected, within = 1e-12) {
  assert.equal(actual.length, expected.length);
  actual.forEach((x, i) => assert.ok(Math.abs(x - expected[i]) <= within, `[${actual}] is not [${expected}]`));
}

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
