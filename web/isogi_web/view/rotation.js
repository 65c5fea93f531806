/**
 * Rotations in the server's conventions: right-handed, z up, R = Rz(yaw) · Ry(pitch) · Rx(roll).
 */

const DEGREE = Math.PI / 180;

/** @typedef {[number, number, number]} Vec3 */
/** @typedef {[number, number, number, number]} Quaternion w, x, y, z */
/** @typedef {{yaw: number, pitch: number, roll: number}} Angles degrees */
/**
 * @typedef {Angles & {azimuth: number, elevation: number}} LightAndCamera knobs of the view,
 *   degrees
 */

/**
 * Return the axes of a camera that orbits the target: `right` and `up` in the picture, `out`
 * towards the eye.
 * @param {number} azimuth degrees; 0 looks from +x, 90 from +y
 * @param {number} elevation degrees
 * @returns {{right: Vec3, up: Vec3, out: Vec3}}
 */
export function cameraAxes(azimuth, elevation) {
  const [ca, sa] = [Math.cos(azimuth * DEGREE), Math.sin(azimuth * DEGREE)];
  const [ce, se] = [Math.cos(elevation * DEGREE), Math.sin(elevation * DEGREE)];
  return { right: [-sa, ca, 0], up: [-se * ca, -se * sa, ce], out: [ce * ca, ce * sa, se] };
}

/**
 * Return the rotation about a unit axis.
 * @param {Vec3} axis
 * @param {number} angle degrees
 * @returns {Quaternion}
 */
export function aboutAxis([x, y, z], angle) {
  const s = Math.sin((angle * DEGREE) / 2);
  return [Math.cos((angle * DEGREE) / 2), s * x, s * y, s * z];
}

/**
 * Return the rotation that applies `b` first, then `a`.
 * @param {Quaternion} a
 * @param {Quaternion} b
 * @returns {Quaternion}
 */
export function compose([aw, ax, ay, az], [bw, bx, by, bz]) {
  return [
    aw * bw - ax * bx - ay * by - az * bz,
    aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw,
  ];
}

/**
 * Return the quaternion of yaw, pitch and roll.
 * @param {Angles} angles
 * @returns {Quaternion}
 */
export function fromAngles({ yaw, pitch, roll }) {
  return compose(
    compose(aboutAxis([0, 0, 1], yaw), aboutAxis([0, 1, 0], pitch)),
    aboutAxis([1, 0, 0], roll),
  );
}

/**
 * Return yaw, pitch and roll of a unit quaternion. At pitch ±90°, only a combination of yaw and
 * roll is determined: roll is then 0.
 * @param {Quaternion} q
 * @returns {Angles} pitch within ±90
 */
export function toAngles([w, x, y, z]) {
  const sine = Math.min(1, Math.max(-1, 2 * (w * y - x * z)));
  const pitch = Math.asin(sine) / DEGREE;
  if (Math.abs(sine) > 1 - 1e-9) {
    return {
      yaw: Math.atan2(2 * (w * z - x * y), 1 - 2 * (x * x + z * z)) / DEGREE,
      pitch,
      roll: 0,
    };
  }
  return {
    yaw: Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)) / DEGREE,
    pitch,
    roll: Math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)) / DEGREE,
  };
}

/**
 * Return the angles rounded as the server rounds them if it bakes the light of each turn.
 * @param {Angles} angles
 * @param {number|null|undefined} step degrees; null if any turn is lit by the light that is kept
 * @returns {Angles}
 */
export function inSteps(angles, step) {
  const { yaw, pitch, roll } = angles;
  if (!step) return { yaw, pitch, roll };
  // Angles out of their usual ranges stand for a turn within them. Adding 0 turns -0 into 0.
  const turn = toAngles(fromAngles(angles));
  const near = (/** @type {number} */ angle) => step * Math.round(angle / step) + 0;
  return { yaw: near(turn.yaw), pitch: near(turn.pitch), roll: near(turn.roll) };
}

/**
 * Rotate a vector.
 * @param {Quaternion} q
 * @param {Vec3} v
 * @returns {Vec3}
 */
export function turnVector(q, v) {
  const [, x, y, z] = compose(compose(q, [0, ...v]), [q[0], -q[1], -q[2], -q[3]]);
  return [x, y, z];
}

/**
 * Rotate the light like a ball that is dragged across the picture, whatever the camera's direction.
 * @param {LightAndCamera} values knobs of the view
 * @param {number} right degrees
 * @param {number} down degrees
 * @returns {Angles} the light's new angles
 */
export function rollLight(values, right, down) {
  const axes = cameraAxes(values.azimuth, values.elevation);
  const turn = compose(aboutAxis(axes.up, right), aboutAxis(axes.right, down));
  return toAngles(compose(turn, fromAngles(values)));
}

/**
 * Rotate the light as if its front were dragged across the picture. A drag sideways rotates about
 * the vertical, so that the light's horizon remains level.
 * @param {LightAndCamera} values knobs of the view
 * @param {number} right degrees
 * @param {number} down degrees
 * @returns {Angles} the light's new angles
 */
export function dragLight(values, right, down) {
  const tilt = aboutAxis(cameraAxes(values.azimuth, values.elevation).right, down);
  const turned = compose(aboutAxis([0, 0, 1], right), compose(tilt, fromAngles(values)));
  return toAngles(turned);
}

/**
 * Return the vector with the given components.
 * @param {(i: number) => number} component
 * @returns {Vec3}
 */
export function vector(component) {
  return [component(0), component(1), component(2)];
}

/** Return the scalar product of two vectors. @param {Vec3} a @param {Vec3} b @returns {number} */
export function dot(a, b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}
