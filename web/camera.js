/** Where the camera is: around a target, which is the volume's centre or where the picture was moved to. */

import { cameraAxes } from "./rotation.js";

const MARGIN = 0.5; // radii by which a target may be outside the volume's box
const FURTHEST = 1e12; // coordinates that the server takes
const DEGREE = Math.PI / 180;

/** @typedef {import("./rotation.js").Vec3} Vec3 */

/**
 * The box between the volume's outermost voxels: where it ends, its middle, the radius of the sphere around it.
 * @param {object} scene answer of `readScene`
 * @returns {{extent: Vec3, centre: Vec3, radius: number}} world units
 */
export function boxOf({ volume }) {
  const extent = volume.size.map((count, i) => (count - 1) * volume.spacing[i]);
  return { extent, centre: extent.map((length) => length / 2), radius: Math.hypot(...extent) / 2 };
}

/**
 * A target that keeps the volume in reach, with digits that an address can hold.
 * @param {object} scene answer of `readScene`
 * @param {Vec3|null} target null for the volume's centre
 * @returns {Vec3|null}
 */
export function limitTarget(scene, target) {
  if (!Array.isArray(target) || target.length !== 3 || !target.every(Number.isFinite)) return null;
  const { extent, radius } = boxOf(scene);
  const [before, beyond] = [-MARGIN * radius, MARGIN * radius];
  const inside = target.map((x, i) => Number(Math.min(extent[i] + beyond, Math.max(before, x)).toPrecision(6)));
  return inside.every((x) => Math.abs(x) <= FURTHEST) ? inside : null;
}

/**
 * Move the picture: what is in the target's depth moves by exactly so much.
 * @param {object} scene answer of `readScene`
 * @param {object} values knobs of the view
 * @param {number} right in heights of the picture
 * @param {number} down in heights of the picture
 * @returns {{target: Vec3}}
 */
export function pan(scene, values, right, down) {
  const { centre, radius } = boxOf(scene);
  const axes = cameraAxes(values.azimuth, values.elevation);
  const height = 2 * values.distance * radius * Math.tan((values.fov * DEGREE) / 2);
  const from = values.target ?? centre;
  return { target: from.map((x, i) => x + height * (down * axes.up[i] - right * axes.right[i])) };
}

/**
 * The ray through a place of the picture.
 * @param {object} scene answer of `readScene`
 * @param {object} values knobs of the view
 * @param {number} right of the middle, in heights of the picture
 * @param {number} up of the middle, in heights of the picture
 * @returns {{eye: Vec3, target: Vec3, up: Vec3}} the eye, a point that the ray meets, and what is up in the picture
 */
export function rayThrough(scene, values, right, up) {
  const { centre, radius } = boxOf(scene);
  const axes = cameraAxes(values.azimuth, values.elevation);
  const away = values.distance * radius;
  const height = 2 * away * Math.tan((values.fov * DEGREE) / 2);
  const middle = values.target ?? centre;
  return {
    eye: middle.map((x, i) => x + away * axes.out[i]),
    target: middle.map((x, i) => x + height * (right * axes.right[i] + up * axes.up[i])),
    up: axes.up,
  };
}
