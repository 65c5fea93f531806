/**
 * Slices through a volume: their orientation on the screen, their place in the world, and the lines
 * in which planes cross them.
 */

import { OPPOSITE } from "../view/camera.js";
import { worldOf } from "../view/measures.js";
import { planesOf } from "../view/planes.js";
import { dot, vector } from "../view/rotation.js";

/** @typedef {import("../view/planes.js").Movable} Movable */
/** @typedef {import("../view/planes.js").Plane} Plane */
/** @typedef {import("../view/rotation.js").Vec3} Vec3 */
/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {"x"|"y"|"z"} Axis axis of the voxels */
/** @typedef {Pick<Scene["volume"], "size"|"spacing"|"affine"|"axes">} Grid grid of voxels */
/**
 * @typedef {[number, number]} Share a place on a slice: shares of its width, from the left, and of
 *   its height, from below
 */
/**
 * @typedef {{at: number, right: number, up: number, near: number}} Slope distance from a plane over
 *   a slice, in world units: at its lower left corner, and the change to its lower right and upper
 *   left corner; points nearer than `near` count as on the plane
 */
/**
 * @typedef {{axis: number, sign: 1|-1}} Way a direction along a voxel axis, by its number: 1 to its
 *   end, -1 to its beginning
 */

/**
 * @typedef {object} Lie orientation of slices across an axis on the screen
 * @property {Axis} axis
 * @property {string} kind "Axial", "Sagittal" or "Coronal" in a patient; "" elsewhere
 * @property {string} name name of such a slice
 * @property {number} across number of the axis
 * @property {Way} right
 * @property {Way} up
 * @property {[string, string, string, string]} sides of a patient at the left, right, upper and
 *   lower edge; "" elsewhere
 */

/**
 * @typedef {object} Slice
 * @property {Lie} lie
 * @property {number} at voxel index
 * @property {[number, number]} extent its width and height, in the world
 * @property {Share} point place of the point that it goes through
 * @property {Vec3} corner lower left corner in the world
 * @property {Vec3} width vector to the lower right corner
 * @property {Vec3} height vector to the upper left corner
 * @property {Vec3} normal unit vector along its axis
 * @property {Vec3[]} steps vectors between neighbouring voxels, along each axis
 */

const NEAR = 0.125; // voxels: the face of a cut lies up to a ninth of a voxel beyond its plane

/** Corners of a slice. @type {Share[]} */
const SQUARE = [
  [0, 0],
  [1, 0],
  [1, 1],
  [0, 1],
];
/** @type {Axis[]} */
const NAMES = ["x", "y", "z"];
/** Kinds of slices, by the sides of a patient between which they are. @type {[string, string][]} */
const PLANES = [
  ["SI", "Axial"],
  ["RL", "Sagittal"],
  ["AP", "Coronal"],
];
const UPRIGHT = "LRAPSI"; // sides of a patient: of a slice's two axes, the later one points up

/** Sides of a patient at the right and at the upper edge of a slice, as radiologists look. */
const [RIGHTWARD, UPWARD] = ["LP", "SA"];

/**
 * Return the orientations of the three kinds of slices: as radiologists see a patient if the volume
 * has one, otherwise along the axes.
 * @param {string} axes sides of a patient that the voxels' axes point to, such as "RAS"; "" without
 *   a patient
 * @returns {Lie[]} axial, sagittal and coronal slices, or slices across z, x and y
 */
export function liesOf(axes) {
  const found = PLANES.map(([pair]) => [...axes].findIndex((letter) => pair.includes(letter)));
  if (found.includes(-1)) return [2, 0, 1].map((across) => lieOf("", across, ""));
  return found.map((across, k) => lieOf(axes, across, PLANES[k][1]));
}

/**
 * Return the orientation of slices across an axis.
 * @param {string} axes
 * @param {number} across
 * @param {string} kind
 * @returns {Lie}
 */
function lieOf(axes, across, kind) {
  const rank = (/** @type {number} */ axis) => UPRIGHT.indexOf(axes[axis]) >> 1;
  const way = (/** @type {number} */ axis, /** @type {string} */ ends) => ({
    axis,
    sign: /** @type {1|-1} */ (!axes || ends.includes(axes[axis]) ? 1 : -1),
  });
  const [first, second] = [0, 1, 2]
    .filter((axis) => axis !== across)
    .sort((a, b) => rank(a) - rank(b));
  const [right, up] = [way(first, RIGHTWARD), way(second, UPWARD)];
  const axis = NAMES[across];
  const name = kind ? `${kind} slice` : `Slice across ${axis}`;
  return { axis, kind, name, across, right, up, sides: sidesOf(axes, right, up) };
}

/**
 * Return the sides of a patient at the edges of a slice.
 * @param {string} axes
 * @param {Way} right
 * @param {Way} up
 * @returns {Lie["sides"]}
 */
function sidesOf(axes, right, up) {
  const side = (/** @type {Way} */ { axis, sign }, /** @type {number} */ way) => {
    const letter = axes[axis] ?? "";
    return sign * way > 0 ? letter : (OPPOSITE[letter] ?? "");
  };
  return [side(right, -1), side(right, 1), side(up, 1), side(up, -1)];
}

/**
 * Return the slice through a point with a given orientation.
 * @param {Grid} volume
 * @param {Lie} lie
 * @param {Vec3} voxel indices of the point, x first
 * @returns {Slice}
 */
export function sliceAt(volume, lie, voxel) {
  const { size, spacing, affine } = volume;
  const { across, right, up } = lie;
  const steps = [0, 1, 2].map((axis) => vector((i) => affine[i][axis]));
  const scaled = (/** @type {number} */ axis, /** @type {number} */ factor) =>
    vector((i) => factor * steps[axis][i]);
  const at = Math.min(size[across] - 1, Math.max(0, voxel[across]));
  const share = (/** @type {Way} */ { axis, sign }) =>
    0.5 + sign * ((voxel[axis] + 0.5) / size[axis] - 0.5); // a voxel fills its pixel
  // The corner lies half a voxel outside of the outermost voxels' middles.
  const first = vector((i) => (i === across ? at : -0.5));
  for (const { axis, sign } of [right, up]) if (sign < 0) first[axis] = size[axis] - 0.5;
  return {
    lie,
    at,
    extent: [size[right.axis] * spacing[right.axis], size[up.axis] * spacing[up.axis]],
    point: [share(right), share(up)],
    corner: worldOf(volume, first),
    width: scaled(right.axis, right.sign * size[right.axis]),
    height: scaled(up.axis, up.sign * size[up.axis]),
    normal: scaled(across, 1 / spacing[across]),
    steps,
  };
}

/**
 * Return the voxel at a place of a slice, or the nearest one if the place is outside.
 * @param {Pick<Grid, "size">} volume
 * @param {Slice} slice
 * @param {Share} place
 * @returns {Vec3}
 */
export function voxelAt({ size }, { lie: { across, right, up }, at }, place) {
  const voxel = vector((i) => (i === across ? at : 0));
  [right, up].forEach(({ axis, sign }, k) => {
    const share = 0.5 + sign * (place[k] - 0.5);
    voxel[axis] = Math.min(size[axis] - 1, Math.max(0, Math.floor(share * size[axis])));
  });
  return voxel;
}

/**
 * Return the voxel some steps away in a slice, and across it, within the volume.
 * @param {Pick<Grid, "size">} volume
 * @param {Lie} lie
 * @param {Vec3} voxel
 * @param {{right?: number, up?: number, across?: number}} steps
 * @returns {Vec3}
 */
export function stepped({ size }, lie, voxel, { right = 0, up = 0, across = 0 }) {
  const moved = vector((i) => voxel[i]);
  moved[lie.right.axis] += lie.right.sign * right;
  moved[lie.up.axis] += lie.up.sign * up;
  moved[lie.across] += across;
  return vector((i) => Math.min(size[i] - 1, Math.max(0, moved[i])));
}

/**
 * Return the distance from a plane over a slice: it is linear.
 * @param {Slice} slice
 * @param {Plane} plane
 * @returns {Slope}
 */
export function slopeOf({ corner, width, height, steps }, { normal, limit }) {
  const near = NEAR * Math.hypot(...steps.map((step) => dot(normal, step)));
  return {
    at: dot(normal, corner) - limit,
    right: dot(normal, width),
    up: dot(normal, height),
    near,
  };
}

/**
 * Return the part of a slice that planes leave, as the corners of a convex polygon in order; empty
 * if nothing is left.
 * @param {Slice} slice
 * @param {string} text of the planes
 * @returns {Share[]} corners of a convex polygon, in order; none if nothing is left
 */
export function partLeft(slice, text) {
  // Clip the polygon by one plane after the other (Sutherland and Hodgman, 1974).
  return planesOf(text).reduce((polygon, plane) => {
    const { at, near, ...rest } = slopeOf(slice, plane);
    const slope = { at: at - near, near, ...rest };
    return polygon.flatMap((corner, i) => [
      ...(beyond(slope, corner) <= 0 ? [corner] : []),
      ...crossing(slope, corner, polygon[(i + 1) % polygon.length]),
    ]);
  }, SQUARE);
}

/**
 * Return the two ends of the line in which a plane crosses a slice; none if they do not cross.
 * @param {Slope} slope of the plane
 * @returns {Share[]} its two ends; none if they do not cross
 */
export function lineAcross(slope) {
  // A plane parallel to the slice has no line.
  if (Math.abs(slope.right) + Math.abs(slope.up) <= slope.near) return [];
  return SQUARE.flatMap((corner, i) => crossing(slope, corner, SQUARE[(i + 1) % SQUARE.length]));
}

/** Return the distance of a place from the plane. @param {Slope} slope @param {Share} place */
function beyond({ at, right, up }, [x, y]) {
  return at + right * x + up * y;
}

/**
 * Return the point at which an edge crosses a plane; none if both ends lie on one side.
 * @param {Slope} slope
 * @param {Share} a
 * @param {Share} b
 * @returns {Share[]} one place, or none
 */
function crossing(slope, a, b) {
  const [from, to] = [beyond(slope, a), beyond(slope, b)];
  if (from <= 0 === to <= 0) return [];
  const share = from / (from - to);
  return [[a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])]];
}

/**
 * Return true if a plane's line is steeper than 45 degrees on the screen.
 * @param {Slice} slice
 * @param {Slope} slope
 * @returns {boolean}
 */
export function isUpright({ extent: [wide, high] }, { right, up }) {
  return Math.abs(right) * high > wide * Math.abs(up);
}

/**
 * Return a shape for `clip-path` that covers all of a slice except a polygon.
 * @param {Share[]} polygon
 * @returns {string}
 */
export function around(polygon) {
  const ring = [SQUARE, polygon].flatMap((corners) => [...corners, ...corners.slice(0, 1)]);
  return `polygon(evenodd, ${ring.map(([x, y]) => `${100 * x}% ${100 * (1 - y)}%`).join(", ")})`;
}
