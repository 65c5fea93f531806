/**
 * The camera: it orbits a target, which is the volume's centre or the point that the picture was
 * moved to.
 */

import { cameraAxes, dot, vector } from "./rotation.js";

/** @typedef {import("./rotation.js").Vec3} Vec3 */
/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {import("./model.js").Knobs} Knobs */
/**
 * @typedef {{azimuth: number, elevation: number, distance: number, fov: number, target: Vec3|null,
 *   projection?: string}} Orbit knobs of the camera
 */
/**
 * @typedef {{eye: Vec3, target: Vec3, up: Vec3}} Ray a ray from the eye through the target; `up` is
 *   the upward direction of the picture
 */

const SAME_SIZE = 0.01; // share by which the boxes of volumes in one world may differ
const MARGIN = 0.5; // distance of a target from the volume's box at most, in radii
const FURTHEST = 1e12; // largest coordinate that the server accepts
const CLOSE = 0.05; // degrees between directions that count as equal
const AFAR = 1e3; // radii from the target at which parallel rays begin: outside of any volume
const DEGREE = Math.PI / 180;

/** Projections of the camera: rays from the eye, or parallel rays. */
export const PROJECTIONS = ["perspective", "orthographic"];

/**
 * Azimuth and elevation of the views along the axes; seen from above and below, x points to the
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
 * Return true if two cameras look in the same direction, to within CLOSE.
 * @param {{azimuth: number, elevation: number}} a
 * @param {{azimuth: number, elevation: number}} b
 * @returns {boolean}
 */
export function looksAlong(a, b) {
  const turned = Math.abs(((a.azimuth - b.azimuth + 540) % 360) - 180);
  return turned < CLOSE && Math.abs(a.elevation - b.elevation) < CLOSE;
}

/**
 * Return the box between the volume's outermost voxels: its corners and centre, and the radius of
 * the sphere around it.
 * @param {{volume: Pick<Scene["volume"], "size"|"spacing"|"bounds">}} scene
 * @returns {{low: Vec3, high: Vec3, centre: Vec3, radius: number}} in world units
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
 * Limit a target to the surroundings of the volume, with few enough digits for an address.
 * @param {{volume: Pick<Scene["volume"], "size"|"spacing"|"bounds">}} scene
 * @param {unknown} target a point; anything else stands for the volume's centre
 * @returns {Vec3|null} null for the volume's centre
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
 * Move the picture: points at the target's depth move exactly by the given lengths.
 * @param {{volume: Pick<Scene["volume"], "size"|"spacing"|"bounds">}} scene
 * @param {Orbit} values knobs of the view
 * @param {number} right heights of the picture
 * @param {number} down heights of the picture
 * @returns {{target: Vec3}}
 */
export function pan(scene, values, right, down) {
  const { centre, radius } = boxOf(scene);
  const axes = cameraAxes(values.azimuth, values.elevation);
  // Height of the picture at the target's depth, in world units.
  const height = 2 * values.distance * radius * Math.tan((values.fov * DEGREE) / 2);
  const from = values.target ?? centre;
  return { target: vector((i) => from[i] + height * (down * axes.up[i] - right * axes.right[i])) };
}

/** Return true if a camera's rays are parallel. @param {Pick<Orbit, "projection">} values */
function isParallel({ projection }) {
  return projection === "orthographic";
}

/**
 * Return the ray through a place of the picture.
 * @param {{volume: Pick<Scene["volume"], "size"|"spacing"|"bounds">}} scene
 * @param {Orbit} values knobs of the view
 * @param {number} right heights of the picture, from its middle
 * @param {number} up heights of the picture, from its middle
 * @returns {Ray}
 */
export function rayThrough(scene, values, right, up) {
  const { centre, radius } = boxOf(scene);
  const axes = cameraAxes(values.azimuth, values.elevation);
  const away = values.distance * radius;
  const height = 2 * away * Math.tan((values.fov * DEGREE) / 2);
  const middle = values.target ?? centre;
  const target = vector((i) => middle[i] + height * (right * axes.right[i] + up * axes.up[i]));
  // Parallel rays start side by side, far outside of the volume; others in the eye, `away` from the
  // target.
  const [from, far] = isParallel(values) ? [target, AFAR * radius] : [middle, away];
  return { eye: vector((i) => from[i] + far * axes.out[i]), target, up: axes.up };
}

/**
 * Return the direction from a point of the world to the eye.
 * @param {{volume: Pick<Scene["volume"], "size"|"spacing"|"bounds">}} scene
 * @param {Orbit} values knobs of the view
 * @param {Vec3} point
 * @returns {Vec3} its length is not 1
 */
export function towardsEye(scene, values, point) {
  const { right, up } = placeOf(scene, values, point);
  const { eye } = rayThrough(scene, values, right, up);
  return vector((i) => eye[i] - point[i]);
}

/**
 * Project a point of the world into the picture.
 * @param {{volume: Pick<Scene["volume"], "size"|"spacing"|"bounds">}} scene
 * @param {Orbit} values knobs of the view
 * @param {Vec3} point
 * @returns {{right: number, up: number, depth: number}} `right` and `up` from the picture's middle,
 *   in heights of the picture; `depth` along the view, in world units. A depth of 0 or less lies
 *   behind the eye, and the place then has no meaning.
 */
export function placeOf(scene, values, point) {
  const { centre, radius } = boxOf(scene);
  const axes = cameraAxes(values.azimuth, values.elevation);
  const middle = values.target ?? centre;
  const from = vector((i) => point[i] - middle[i]);
  const away = values.distance * radius;
  // A parallel camera has its eye far away, and a picture whose height does not depend on the
  // depth.
  const depth = (isParallel(values) ? AFAR * radius : away) - dot(from, axes.out);
  const height = 2 * (isParallel(values) ? away : depth) * Math.tan((values.fov * DEGREE) / 2);
  return { right: dot(from, axes.right) / height, up: dot(from, axes.up) / height, depth };
}

/** The opposite side of a patient, by the letter of a side. */
export const OPPOSITE = /** @type {Record<string, string>} */ ({
  R: "L",
  L: "R",
  A: "P",
  P: "A",
  S: "I",
  I: "S",
});

/**
 * Return the sides of a patient that the picture's edges show; "" if the volume has no patient.
 * @param {{volume: Pick<Scene["volume"], "letters">}} scene
 * @param {Pick<Orbit, "azimuth"|"elevation">} values knobs of the view
 * @returns {{left: string, right: string, top: string, bottom: string}}
 */
export function sidesOf({ volume }, values) {
  const { right, up } = cameraAxes(values.azimuth, values.elevation);
  const letter = (/** @type {Vec3} */ direction, /** @type {number} */ sign) => {
    // Take the axis that is nearest to the direction.
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

/**
 * Return true if the volumes of two scenes fill the same box of one world, so that one camera shows
 * both.
 * @param {Pick<Scene, "volume">} a
 * @param {Pick<Scene, "volume">} b
 * @returns {boolean}
 */
export function isOneWorld(a, b) {
  const most = SAME_SIZE * boxOf(a).radius;
  const apart = a.volume.bounds.flatMap((corner, end) =>
    corner.map((at, axis) => Math.abs(at - b.volume.bounds[end][axis])),
  );
  return (
    a.volume.unit === b.volume.unit &&
    a.volume.letters === b.volume.letters &&
    apart.every((each) => each <= most)
  );
}

/**
 * Return the camera by which another scene is seen as a view of a scene is.
 *
 * In one world it is the same camera. Otherwise it looks in the same direction; its distance from
 * the fitted one, and that of its target, are the same in proportion to the size of the volume.
 *
 * @param {Pick<Scene, "volume"|"start">} scene
 * @param {Knobs} values view of the scene
 * @param {Pick<Scene, "volume"|"start">} other
 * @returns {Pick<Knobs, "azimuth"|"elevation"|"distance"|"fov"|"projection"|"target">}
 */
export function linkedCamera(scene, values, other) {
  const { azimuth, elevation, distance, fov, projection, target } = values;
  const camera = { azimuth, elevation, distance, fov, projection, target };
  if (isOneWorld(scene, other)) return camera;
  const [here, there] = [boxOf(scene), boxOf(other)];
  const [from, to] = [scene, other].map(({ start }, k) => start.target ?? [here, there][k].centre);
  const at = target ?? here.centre;
  const moved = vector((i) => to[i] + ((at[i] - from[i]) * there.radius) / here.radius);
  const share = distance / Number(scene.start.distance);
  return { ...camera, distance: share * Number(other.start.distance), target: moved };
}
