/**
 * Where the camera is: around a target, which is the volume's centre or where the picture was moved
 * to.
 */

import { cameraAxes, dot, vector } from "./rotation.js";

/** @typedef {import("./rotation.js").Vec3} Vec3 */
/** @typedef {import("../net/schemas.js").Scene} Scene */
/**
 * @typedef {{azimuth: number, elevation: number, distance: number, fov: number, target: Vec3|null,
 *   projection?: string}} Orbit knobs of the camera
 */
/**
 * @typedef {{eye: Vec3, target: Vec3, up: Vec3}} Ray from the eye through the target; `up` in the
 *   picture
 */

const MARGIN = 0.5; // radii by which a target may be outside the volume's box
const FURTHEST = 1e12; // coordinates that the server takes
const CLOSE = 0.05; // degrees
const AFAR = 1e3; // radii from which parallel rays begin: before all of a volume
const DEGREE = Math.PI / 180;

/** How rays may leave the camera: from the eye, or side by side. */
export const PROJECTIONS = ["perspective", "orthographic"];

/**
 * Azimuth and elevation of the views along the axes; from above and from below, x goes to the
 * right.
 * @type {Record<string, {azimuth: number, elevation: number}>}
 */
export const AXIS_VIEWS = {
  "+x": { azimuth: 0, elevation: 0 },
  "-x": { azimuth: 180, elevation: 0 },
  "+y": { azimuth: 90, elevation: 0 },
  "-y": { azimuth: -90, elevation: 0 },
  "+z": { azimuth: -90, elevation: 90 },
  "-z": { azimuth: -90, elevation: -90 },
};

/**
 * Whether two cameras look the same way, or nearly so.
 * @param {{azimuth: number, elevation: number}} a
 * @param {{azimuth: number, elevation: number}} b
 * @returns {boolean}
 */
export function looksAlong(a, b) {
  const turned = Math.abs(((a.azimuth - b.azimuth + 540) % 360) - 180);
  return turned < CLOSE && Math.abs(a.elevation - b.elevation) < CLOSE;
}

/**
 * The box between the volume's outermost voxels: where it begins and ends, its middle, the radius
 * of the sphere around it.
 * @param {{volume: Pick<Scene["volume"], "size"|"spacing"|"bounds">}} scene
 * @returns {{low: Vec3, high: Vec3, centre: Vec3, radius: number}} world units
 */
export function boxOf({ volume }) {
  const [low, high] = volume.bounds;
  const extent = vector((i) => (volume.size[i] - 1) * volume.spacing[i]);
  return {
    low,
    high,
    centre: vector((i) => (low[i] + high[i]) / 2),
    radius: Math.hypot(...extent) / 2,
  };
}

/**
 * A target that keeps the volume in reach, with digits that an address can hold.
 * @param {{volume: Pick<Scene["volume"], "size"|"spacing"|"bounds">}} scene
 * @param {unknown} target a point; null, or what is no point, for the volume's centre
 * @returns {Vec3|null}
 */
export function limitTarget(scene, target) {
  if (!Array.isArray(target) || target.length !== 3 || !target.every(Number.isFinite)) return null;
  const { low, high, radius } = boxOf(scene);
  const beyond = MARGIN * radius;
  const inside = vector((i) =>
    Number(Math.min(high[i] + beyond, Math.max(low[i] - beyond, target[i])).toPrecision(6)),
  );
  return inside.every((x) => Math.abs(x) <= FURTHEST) ? inside : null;
}

/**
 * Move the picture: what is in the target's depth moves by exactly so much.
 * @param {{volume: Pick<Scene["volume"], "size"|"spacing"|"bounds">}} scene
 * @param {Orbit} values knobs of the view
 * @param {number} right in heights of the picture
 * @param {number} down in heights of the picture
 * @returns {{target: Vec3}}
 */
export function pan(scene, values, right, down) {
  const { centre, radius } = boxOf(scene);
  const axes = cameraAxes(values.azimuth, values.elevation);
  const height = 2 * values.distance * radius * Math.tan((values.fov * DEGREE) / 2);
  const from = values.target ?? centre;
  return { target: vector((i) => from[i] + height * (down * axes.up[i] - right * axes.right[i])) };
}

/** Whether a camera's rays are parallel. @param {Pick<Orbit, "projection">} values */
function isParallel({ projection }) {
  return projection === "orthographic";
}

/**
 * The ray through a place of the picture.
 * @param {{volume: Pick<Scene["volume"], "size"|"spacing"|"bounds">}} scene
 * @param {Orbit} values knobs of the view
 * @param {number} right of the middle, in heights of the picture
 * @param {number} up of the middle, in heights of the picture
 * @returns {Ray}
 */
export function rayThrough(scene, values, right, up) {
  const { centre, radius } = boxOf(scene);
  const axes = cameraAxes(values.azimuth, values.elevation);
  const away = values.distance * radius;
  const height = 2 * away * Math.tan((values.fov * DEGREE) / 2);
  const middle = values.target ?? centre;
  const target = vector((i) => middle[i] + height * (right * axes.right[i] + up * axes.up[i]));
  const [from, far] = isParallel(values) ? [target, AFAR * radius] : [middle, away];
  return { eye: vector((i) => from[i] + far * axes.out[i]), target, up: axes.up };
}

/**
 * The direction from a point of the world to the eye.
 * @param {{volume: Pick<Scene["volume"], "size"|"spacing"|"bounds">}} scene
 * @param {Orbit} values knobs of the view
 * @param {Vec3} point
 * @returns {Vec3} not of length 1
 */
export function towardsEye(scene, values, point) {
  const { right, up } = placeOf(scene, values, point);
  const { eye } = rayThrough(scene, values, right, up);
  return vector((i) => eye[i] - point[i]);
}

/**
 * Where a point of the world is in the picture.
 * @param {{volume: Pick<Scene["volume"], "size"|"spacing"|"bounds">}} scene
 * @param {Orbit} values knobs of the view
 * @param {Vec3} point
 * @returns {{right: number, up: number, depth: number}} of the middle, in heights of the picture;
 *   and along the view, in
 *   world units: behind the eye it is not positive, and the place has no meaning
 */
export function placeOf(scene, values, point) {
  const { centre, radius } = boxOf(scene);
  const axes = cameraAxes(values.azimuth, values.elevation);
  const middle = values.target ?? centre;
  const from = vector((i) => point[i] - middle[i]);
  const away = values.distance * radius;
  const depth = (isParallel(values) ? AFAR * radius : away) - dot(from, axes.out);
  const height = 2 * (isParallel(values) ? away : depth) * Math.tan((values.fov * DEGREE) / 2);
  return { right: dot(from, axes.right) / height, up: dot(from, axes.up) / height, depth };
}

/** The other side of a patient, by the letter of a side. */
export const OPPOSITE = /** @type {Record<string, string>} */ ({
  R: "L",
  L: "R",
  A: "P",
  P: "A",
  S: "I",
  I: "S",
});

/**
 * The sides of a patient that the picture's edges show; "" where the volume is of none.
 * @param {{volume: Pick<Scene["volume"], "letters">}} scene
 * @param {Pick<Orbit, "azimuth"|"elevation">} values knobs of the view
 * @returns {{left: string, right: string, top: string, bottom: string}}
 */
export function sidesOf({ volume }, values) {
  const { right, up } = cameraAxes(values.azimuth, values.elevation);
  const letter = (/** @type {Vec3} */ direction, /** @type {number} */ sign) => {
    const sizes = direction.map(Math.abs);
    const axis = sizes.indexOf(Math.max(...sizes));
    const name = volume.letters[axis] ?? "";
    return sign * direction[axis] > 0 ? name : (OPPOSITE[name] ?? "");
  };
  return {
    left: letter(right, -1),
    right: letter(right, 1),
    top: letter(up, 1),
    bottom: letter(up, -1),
  };
}
