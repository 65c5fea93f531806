/**
 * Slices through a volume: which way they lie on the screen, where in the world, and where planes
 * cross them.
 */

import { OPPOSITE } from "../view/camera.js";
import { worldOf } from "../view/crosshair.js";
import { planesOf } from "../view/planes.js";
import { dot, vector } from "../view/rotation.js";

/** @typedef {import("../view/planes.js").Movable} Movable */
/** @typedef {import("../view/planes.js").Plane} Plane */
/** @typedef {import("../view/rotation.js").Vec3} Vec3 */
/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {"x"|"y"|"z"} Axis of the voxels */
/** @typedef {Pick<Scene["volume"], "size"|"spacing"|"affine"|"axes">} Grid of voxels */
/**
 * @typedef {[number, number]} Share of a slice's width, from its left, and of its height, from its
 *   foot
 */
/** @typedef {{at: number, right: number, up: number, near: number}} Slope how far beyond a plane a slice's lower left corner
 *   is, and by how much more so its lower right and its upper left one; what is nearer than `near` is on it; world units */
/**
 * @typedef {{axis: number, sign: 1|-1}} Way along a voxel axis, by its number: to its end, or to
 *   its beginning
 */

/**
 * @typedef {object} Lie how slices across an axis lie on the screen
 * @property {Axis} axis
 * @property {string} kind "Axial", "Sagittal" or "Coronal" in a patient; "" elsewhere
 * @property {string} name what a person calls such a slice
 * @property {number} across the axis' number
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
 * @property {Share} point the share of the point that it goes through
 * @property {Vec3} corner the lower left one, in the world
 * @property {Vec3} width from there to the lower right one
 * @property {Vec3} height from there to the upper left one
 * @property {Vec3} normal along its axis, of length 1
 * @property {Vec3[]} steps from a voxel to the next one, along each axis
 */

const NEAR = 0.125; // voxels: the face of a cut lies up to a ninth of one beyond its plane
/** @type {Share[]} */
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
const UPRIGHT = "LRAPSI"; // sides of a patient: in a slice, the axis of later ones goes up
// sides at the right and the upper edge, as radiologists look at a patient
const [RIGHTWARD, UPWARD] = ["LP", "SA"];

/**
 * How the three kinds of slices lie: as radiologists see a patient where the volume is of one, else
 * along the axes.
 * @param {string} axes where the voxels' axes point in a patient, such as "RAS"; "" elsewhere
 * @returns {Lie[]} axial, sagittal and coronal slices; elsewhere across z, x and y
 */
export function liesOf(axes) {
  const found = PLANES.map(([pair]) => [...axes].findIndex((letter) => pair.includes(letter)));
  if (found.includes(-1)) return [2, 0, 1].map((across) => lieOf("", across, ""));
  return found.map((across, k) => lieOf(axes, across, PLANES[k][1]));
}

/** @param {string} axes @param {number} across @param {string} kind @returns {Lie} */
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

/** @param {string} axes @param {Way} right @param {Way} up @returns {Lie["sides"]} */
function sidesOf(axes, right, up) {
  const side = (/** @type {Way} */ { axis, sign }, /** @type {number} */ way) => {
    const letter = axes[axis] ?? "";
    return sign * way > 0 ? letter : (OPPOSITE[letter] ?? "");
  };
  return [side(right, -1), side(right, 1), side(up, 1), side(up, -1)];
}

/**
 * The slice through a point that lies in a certain way.
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
    0.5 + sign * ((voxel[axis] + 0.5) / size[axis] - 0.5); // a voxel is as wide as its pixel
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
 * The voxel at a place of a slice: the nearest one, also to a place beside it.
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
 * A voxel a few steps away in a slice, and across it; none outside the volume.
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
 * How the distance from a plane changes over a slice.
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
 * The part of a slice that planes leave.
 * @param {Slice} slice
 * @param {string} text of the planes
 * @returns {Share[]} corners of a convex polygon, in turn; none where nothing is left
 */
export function partLeft(slice, text) {
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
 * The line in which a plane crosses a slice.
 * @param {Slope} slope of the plane
 * @returns {Share[]} its two ends; none where they do not cross
 */
export function lineAcross(slope) {
  if (Math.abs(slope.right) + Math.abs(slope.up) <= slope.near) return [];
  return SQUARE.flatMap((corner, i) => crossing(slope, corner, SQUARE[(i + 1) % SQUARE.length]));
}

/** @param {Slope} slope @param {Share} place */
function beyond({ at, right, up }, [x, y]) {
  return at + right * x + up * y;
}

/**
 * Where an edge goes through a plane.
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
 * Whether a plane's line goes up rather than across.
 * @param {Slice} slice
 * @param {Slope} slope
 * @returns {boolean}
 */
export function isUpright({ extent: [wide, high] }, { right, up }) {
  return Math.abs(right) * high > wide * Math.abs(up);
}

/**
 * A shape for `clip-path`: all of a slice but a polygon.
 * @param {Share[]} polygon
 * @returns {string}
 */
export function around(polygon) {
  const ring = [SQUARE, polygon].flatMap((corners) => [...corners, ...corners.slice(0, 1)]);
  return `polygon(evenodd, ${ring.map(([x, y]) => `${100 * x}% ${100 * (1 - y)}%`).join(", ")})`;
}
