/**
 * Planes that take matter away, as frame requests spell them (`x>40;z<10`), and the parts that they
 * leave along each axis.
 */

import { niceStep } from "./format.js";
import { dot, vector } from "./rotation.js";

/** @typedef {import("./rotation.js").Vec3} Vec3 */
/** @typedef {import("../net/schemas.js").Scene} Scene */
/**
 * @typedef {[number, number]} Kept the part that is left along an axis: two world coordinates
 */
/** @typedef {[Vec3, Vec3]} Bounds the least and the greatest coordinates of the world */
/**
 * @typedef {{normal: Vec3, limit: number}} Plane takes away the points p with normal · p > limit;
 *   `normal` has length 1
 */
/**
 * @typedef {{kept: Kept[], others: string[]}} Planes the parts that are left along the world's
 *   axes, and the terms of oblique planes
 */

/**
 * @typedef {object} Movable a plane that is moved along its normal
 * @property {string} name
 * @property {Vec3} normal direction in which the value grows
 * @property {Vec3} at place of its handle
 * @property {Vec3[]} outline polygon of an oblique plane within the remaining box; empty for a side
 *   of the box
 * @property {number} value
 * @property {Kept} range range of values
 * @property {number} open the value at which it takes nothing away
 * @property {(value: number) => string} move returns the text of all planes with this one at
 *   another value
 */

/** Names of the world's axes. */
export const AXES = ["x", "y", "z"];

const NUMBER = "[+-]?(?:\\d+\\.?\\d*|\\.\\d+)(?:[eE][+-]?\\d+)?";
const TERM = new RegExp(`^([xyz]|${NUMBER},${NUMBER},${NUMBER})([<>])(${NUMBER})$`);
const MOST = 12; // planes of a view

/** Decimals of a normal: across 1000 voxels the error is half a thousandth of a voxel. */
const NORMAL_DIGITS = 6;
const ALONG = 1e-6; // deviation of a normal from an axis that counts as none, as on the server

/** Number of oblique planes at most: the others are the six sides of a box. */
export const MOST_OBLIQUE = 6;

/**
 * Return true if a text spells planes.
 * @param {unknown} text
 * @returns {text is string}
 */
export function arePlanes(text) {
  if (typeof text !== "string") return false;
  const terms = termsOf(text);
  return terms.length > 0 && terms.length <= MOST && terms.every((term) => TERM.test(term));
}

/**
 * Return the plane that a term spells.
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

/** Return the planes that a text spells. @param {string} text @returns {Plane[]} */
export function planesOf(text) {
  return termsOf(text).map(planeOf);
}

/**
 * Write a plane as a term, with few enough digits for an address.
 * @param {Plane} plane
 * @returns {string}
 */
export function termOf({ normal, limit }) {
  const short = normal.map((x) => Number(x.toFixed(NORMAL_DIGITS)) + 0);
  return `${short.join(",")}>${Number((limit * Math.hypot(...short)).toPrecision(6))}`;
}

/**
 * Return the number of the axis that is normal to a plane; -1 for an oblique plane.
 * @param {Plane} plane
 */
function axisOf({ normal }) {
  return normal.findIndex((x) => Math.abs(x) >= 1 - ALONG);
}

/**
 * Return the parts that planes leave along the world's axes within `bounds`, and the oblique
 * planes.
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
    // Each plane along an axis moves one end of the range, never past the other end.
    if (!range) others.push(term);
    else if (plane.normal[axisOf(plane)] < 0)
      range[0] = Math.min(Math.max(range[0], limit), range[1]);
    else range[1] = Math.max(Math.min(range[1], limit), range[0]);
  }
  return { kept, others };
}

/**
 * Separate the planes along the world's axes, which can let light in, from oblique planes.
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
 * Return the plane that faces a direction and goes through the middle of the remaining box.
 * @param {Planes} planes
 * @param {Vec3} towards unit vector
 * @returns {Plane}
 */
export function facingPlane({ kept }, towards) {
  return {
    normal: towards,
    limit: kept.reduce((sum, [from, to], i) => sum + (towards[i] * (from + to)) / 2, 0),
  };
}

/**
 * Return the direction along a world axis that is nearest to a given one.
 * @param {Vec3} towards
 * @returns {Vec3} of length 1
 */
export function nearestAxis(towards) {
  const sizes = towards.map(Math.abs);
  const axis = sizes.indexOf(Math.max(...sizes));
  return vector((i) => (i === axis ? Math.sign(towards[i]) : 0));
}

/**
 * Add a plane through a point to a text of planes.
 *
 * A plane along an axis moves a side of the box. An oblique plane replaces one that faces the same
 * direction; if there are too many, the oldest is dropped.
 *
 * @param {string} text
 * @param {Bounds} bounds
 * @param {Vec3} point
 * @param {Vec3} normal unit vector towards the matter that is taken away
 * @returns {string}
 */
export function cutAt(text, bounds, point, normal) {
  const plane = { normal, limit: dot(normal, point) };
  // A plane along an axis is a side of the box, which has a slider: sides come in pairs, from and
  // to.
  const axis = axisOf(plane);
  if (axis >= 0)
    return movablePlanes({ bounds }, text)[2 * axis + Number(normal[axis] > 0)].move(
      Number(point[axis].toPrecision(6)),
    );
  // An oblique plane is a term; terms with the same normal, as rounded, face the same direction.
  const term = termOf(plane);
  const { kept, others } = readPlanes(text, bounds);
  const facing = (/** @type {string} */ each) => each.split(">")[0] === term.split(">")[0];
  return writePlanes(
    { kept, others: [...others.filter((each) => !facing(each)), term].slice(-MOST_OBLIQUE) },
    bounds,
  );
}

/**
 * Return the least and the greatest limit at which a plane with this normal meets a box.
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
 * Write planes as a text; "" if nothing is taken away.
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
 * Return the planes that a view may move: the six sides of a box, and oblique planes.
 * @param {Pick<Scene["volume"], "bounds">} volume
 * @param {string} text of the planes
 * @returns {Movable[]}
 */
export function movablePlanes({ bounds }, text) {
  const planes = readPlanes(text, bounds);
  const { kept, others } = planes;
  const middle = vector((i) => (kept[i][0] + kept[i][1]) / 2);
  // The sides of the box: a side moves along its axis, never past the opposite side.
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
  // Oblique planes: the handle lies in the middle of the outline, or at the foot of the box's
  // centre if the plane misses the box.
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
 * Return the text of all planes after one is moved to a value, rounded and limited to its range.
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
 * Return the polygon in which a plane cuts a box, as corners in order; none if they do not meet.
 * @param {Vec3} normal unit vector
 * @param {number} limit normal · p for points of the plane
 * @param {Kept[]} box along each axis
 * @returns {Vec3[]}
 */
export function outlineOf(normal, limit, box) {
  const points = edgesOf(box).flatMap(([a, b]) => {
    const [from, to] = [dot(normal, a) - limit, dot(normal, b) - limit];
    return from < 0 === to < 0 ? [] : [vector((i) => a[i] + (from / (from - to)) * (b[i] - a[i]))];
  });
  // Sort the points of the edges by their angle around the middle, in two axes of the plane.
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

/** Return the twelve edges of a box. @param {Kept[]} box @returns {[Vec3, Vec3][]} */
export function edgesOf(box) {
  const corner = (/** @type {number} */ bits) => vector((i) => box[i][(bits >> i) & 1]);
  return [0, 1, 2].flatMap((axis) =>
    [0, 1, 2, 3, 4, 5, 6, 7]
      .filter((bits) => !((bits >> axis) & 1))
      .map((bits) => /** @type {[Vec3, Vec3]} */ ([corner(bits), corner(bits | (1 << axis))])),
  );
}

/** Return the volume's box along each axis. @param {[Vec3, Vec3]} bounds @returns {Kept[]} */
function whole([low, high]) {
  return low.map((from, i) => [from, high[i]]);
}

/** Split a text into terms. @param {string} text */
function termsOf(text) {
  return text
    .split(";")
    .map((term) => term.replaceAll(" ", ""))
    .filter(Boolean);
}

/** Return the cross product of two vectors. @param {Vec3} a @param {Vec3} b */
function cross(a, b) {
  return vector((i) => a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3]);
}
