/**
 * Planes that take away what lies there, as frame requests spell them: `x>40;z<10`, and what they
 * leave along each axis.
 */

import { niceStep } from "./format.js";
import { dot, vector } from "./rotation.js";

/** @typedef {import("./rotation.js").Vec3} Vec3 */
/** @typedef {import("../net/schemas.js").Scene} Scene */
/**
 * @typedef {[number, number]} Kept what is left along an axis, from one world coordinate to another
 */
/** @typedef {[Vec3, Vec3]} Bounds the least and the greatest coordinates of the world */
/**
 * @typedef {{normal: Vec3, limit: number}} Plane takes away the points p with normal · p > limit;
 *   `normal` has length 1
 */
/**
 * @typedef {{kept: Kept[], others: string[]}} Planes what is left along the world's axes, and the
 *   planes along none
 */

/**
 * @typedef {object} Movable a plane that is moved along its normal
 * @property {string} name
 * @property {Vec3} normal in whose direction the value grows
 * @property {Vec3} at where its handle is
 * @property {Vec3[]} outline of an oblique plane within what is left; none of a side of the box
 * @property {number} value
 * @property {Kept} range of values
 * @property {number} open the value with which it takes nothing away
 * @property {(value: number) => string} move the text of all planes, with this one at another value
 */

/** The world's axes, by which planes may be named. */
export const AXES = ["x", "y", "z"];

const NUMBER = "[+-]?(?:\\d+\\.?\\d*|\\.\\d+)(?:[eE][+-]?\\d+)?";
const TERM = new RegExp(`^([xyz]|${NUMBER},${NUMBER},${NUMBER})([<>])(${NUMBER})$`);
const MOST = 12;
// of a component: half a thousandth of a voxel across a volume of a thousand
const NORMAL_DIGITS = 6;
const ALONG = 1e-6; // by how much a normal may be off an axis, as the server has it

/** Most planes that are along no axis: the others are six sides of a box. */
export const MOST_OBLIQUE = 6;

/**
 * Whether a text spells planes.
 * @param {unknown} text
 * @returns {text is string}
 */
export function arePlanes(text) {
  if (typeof text !== "string") return false;
  const terms = termsOf(text);
  return terms.length > 0 && terms.length <= MOST && terms.every((term) => TERM.test(term));
}

/**
 * The plane that a term spells.
 * @param {string} term
 * @returns {Plane}
 */
export function planeOf(term) {
  const [, named, sign, limit] = TERM.exec(term) ?? [];
  const axis = AXES.indexOf(named);
  const given = axis < 0 ? named.split(",").map(Number) : AXES.map((_, i) => Number(i === axis));
  const length = Math.hypot(...given) * (sign === ">" ? 1 : -1) || 1;
  return {
    normal: [given[0] / length, given[1] / length, given[2] / length],
    limit: Number(limit) / length,
  };
}

/** The planes that a text spells. @param {string} text @returns {Plane[]} */
export function planesOf(text) {
  return termsOf(text).map(planeOf);
}

/**
 * The term of a plane, with digits that an address can hold.
 * @param {Plane} plane
 * @returns {string}
 */
export function termOf({ normal, limit }) {
  const short = normal.map((x) => Number(x.toFixed(NORMAL_DIGITS)) + 0);
  return `${short.join(",")}>${Number((limit * Math.hypot(...short)).toPrecision(6))}`;
}

/** The number of the axis that a plane is across; -1 where there is none. @param {Plane} plane */
function axisOf({ normal }) {
  return normal.findIndex((x) => Math.abs(x) >= 1 - ALONG);
}

/**
 * What planes leave along the world's axes within `bounds`, and the planes that are along none of
 * them.
 * @param {string} text
 * @param {Bounds} bounds
 * @returns {Planes}
 */
export function readPlanes(text, [low, high]) {
  /** @type {Kept[]} */
  const kept = low.map((from, axis) => [from, high[axis]]);
  /** @type {string[]} */
  const others = [];
  for (const term of termsOf(text)) {
    const plane = planeOf(term);
    const range = kept[axisOf(plane)];
    const limit = plane.limit * Math.sign(plane.normal[axisOf(plane)]);
    if (!range) others.push(term);
    else if (plane.normal[axisOf(plane)] < 0)
      range[0] = Math.min(Math.max(range[0], limit), range[1]);
    else range[1] = Math.max(Math.min(range[1], limit), range[0]);
  }
  return { kept, others };
}

/**
 * The planes across the world's axes, which light can come in by, and all others, each as a text.
 * @param {string} text
 * @returns {{along: string, oblique: string}}
 */
export function partPlanes(text) {
  const terms = termsOf(text);
  const across = terms.map((term) => axisOf(planeOf(term)) >= 0);
  return {
    along: terms.filter((_, k) => across[k]).join(";"),
    oblique: terms.filter((_, k) => !across[k]).join(";"),
  };
}

/**
 * The plane that faces a direction, through the middle of what is left.
 * @param {Planes} planes
 * @param {Vec3} towards where it looks, of length 1
 * @returns {Plane}
 */
export function facingPlane({ kept }, towards) {
  return {
    normal: towards,
    limit: kept.reduce((sum, [from, to], i) => sum + (towards[i] * (from + to)) / 2, 0),
  };
}

/**
 * The direction along a world axis that is nearest to another.
 * @param {Vec3} towards
 * @returns {Vec3} of length 1
 */
export function nearestAxis(towards) {
  const sizes = towards.map(Math.abs);
  const axis = sizes.indexOf(Math.max(...sizes));
  return vector((i) => (i === axis ? Math.sign(towards[i]) : 0));
}

/**
 * The text of planes with one through a point: along an axis it is a side of the box, else an
 * oblique plane, which
 * replaces one that faces the same way; where there are too many, the oldest goes.
 * @param {string} text
 * @param {Bounds} bounds
 * @param {Vec3} point
 * @param {Vec3} normal towards what is taken away, of length 1
 * @returns {string}
 */
export function cutAt(text, bounds, point, normal) {
  const plane = { normal, limit: dot(normal, point) };
  const axis = axisOf(plane);
  if (axis >= 0)
    return movablePlanes({ bounds }, text)[2 * axis + Number(normal[axis] > 0)].move(
      Number(point[axis].toPrecision(6)),
    );
  const term = termOf(plane);
  const { kept, others } = readPlanes(text, bounds);
  const facing = (/** @type {string} */ each) => each.split(">")[0] === term.split(">")[0];
  return writePlanes(
    { kept, others: [...others.filter((each) => !facing(each)), term].slice(-MOST_OBLIQUE) },
    bounds,
  );
}

/**
 * The least and the greatest limits with which a plane of this normal goes through a box.
 * @param {Vec3} normal
 * @param {Kept[]} box along each axis
 * @returns {Kept}
 */
export function limitsWithin(normal, box) {
  const ends = box.map(([from, to], i) => [normal[i] * from, normal[i] * to].sort((a, b) => a - b));
  return [
    ends.reduce((sum, [least]) => sum + least, 0),
    ends.reduce((sum, [, most]) => sum + most, 0),
  ];
}

/**
 * The text of planes; "" where all is left.
 * @param {Planes} planes
 * @param {Bounds} bounds
 * @returns {string}
 */
export function writePlanes({ kept, others }, [low, high]) {
  const along = kept.flatMap(([from, to], axis) => [
    ...(from > low[axis] ? [`${AXES[axis]}<${from}`] : []),
    ...(to < high[axis] ? [`${AXES[axis]}>${to}`] : []),
  ]);
  return [...along, ...others].join(";");
}

/**
 * The planes that a view may move: six sides of a box, and those along no axis.
 * @param {Pick<Scene["volume"], "bounds">} volume
 * @param {string} text of the planes
 * @returns {Movable[]}
 */
export function movablePlanes({ bounds }, text) {
  const planes = readPlanes(text, bounds);
  const { kept, others } = planes;
  const middle = vector((i) => (kept[i][0] + kept[i][1]) / 2);
  const sides = AXES.flatMap((name, axis) =>
    ["from", "to"].map((end, side) => ({
      name: `${name} ${end}`,
      normal: vector((i) => Number(i === axis)),
      at: vector((i) => (i === axis ? kept[axis][side] : middle[i])),
      outline: [],
      value: kept[axis][side],
      range: /** @type {Kept} */ ([bounds[0][axis], bounds[1][axis]]),
      open: bounds[side][axis],
      move: (/** @type {number} */ value) => {
        const range = [...kept[axis]];
        range[side] = side ? Math.max(value, range[0]) : Math.min(value, range[1]);
        return writePlanes(
          { kept: /** @type {Kept[]} */ (kept.with(axis, /** @type {Kept} */ (range))), others },
          bounds,
        );
      },
    })),
  );
  const oblique = others.map((term, k) => {
    const { normal, limit } = planeOf(term);
    const outline = outlineOf(normal, limit, kept);
    const range = limitsWithin(normal, whole(bounds));
    const foot = vector((i) => middle[i] + normal[i] * (limit - dot(normal, middle)));
    const at = outline.length
      ? vector((i) => outline.reduce((sum, point) => sum + point[i], 0) / outline.length)
      : foot;
    const move = (/** @type {number} */ value) =>
      writePlanes({ kept, others: others.with(k, termOf({ normal, limit: value })) }, bounds);
    return {
      name: `plane ${k + 1}`,
      normal,
      at,
      outline,
      value: limit,
      range,
      open: range[1],
      move,
    };
  });
  return [...sides, ...oblique];
}

/**
 * The text of all planes with one of them moved, to a round value within its range.
 * @param {Movable} plane
 * @param {number} value
 * @returns {string}
 */
export function moved({ range: [low, high], move }, value) {
  const step = niceStep(high - low);
  return move(
    Number(Math.min(Math.max(Math.round(value / step) * step, low), high).toPrecision(8)),
  );
}

/**
 * Where a plane cuts a box: the corners of a polygon, in turn; none where it cuts nothing.
 * @param {Vec3} normal of length 1
 * @param {number} limit normal · p on the plane
 * @param {Kept[]} box along each axis
 * @returns {Vec3[]}
 */
export function outlineOf(normal, limit, box) {
  const points = edgesOf(box).flatMap(([a, b]) => {
    const [from, to] = [dot(normal, a) - limit, dot(normal, b) - limit];
    return from < 0 === to < 0 ? [] : [vector((i) => a[i] + (from / (from - to)) * (b[i] - a[i]))];
  });
  const middle = vector((i) => points.reduce((sum, point) => sum + point[i], 0) / points.length);
  const least = normal.map(Math.abs).indexOf(Math.min(...normal.map(Math.abs)));
  const u = cross(
    normal,
    vector((i) => Number(i === least)),
  );
  const v = cross(normal, u);
  const angle = (/** @type {Vec3} */ p) =>
    Math.atan2(dot(v, p) - dot(v, middle), dot(u, p) - dot(u, middle));
  return points.sort((a, b) => angle(a) - angle(b));
}

/** The twelve edges of a box. @param {Kept[]} box @returns {[Vec3, Vec3][]} */
export function edgesOf(box) {
  const corner = (/** @type {number} */ bits) => vector((i) => box[i][(bits >> i) & 1]);
  return [0, 1, 2].flatMap((axis) =>
    [0, 1, 2, 3, 4, 5, 6, 7]
      .filter((bits) => !((bits >> axis) & 1))
      .map((bits) => /** @type {[Vec3, Vec3]} */ ([corner(bits), corner(bits | (1 << axis))])),
  );
}

/** The volume's box, along each axis. @param {[Vec3, Vec3]} bounds @returns {Kept[]} */
function whole([low, high]) {
  return low.map((from, i) => [from, high[i]]);
}

/** @param {string} text */
function termsOf(text) {
  return text
    .split(";")
    .map((term) => term.replaceAll(" ", ""))
    .filter(Boolean);
}

/** @param {Vec3} a @param {Vec3} b */
function cross(a, b) {
  return vector((i) => a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3]);
}
