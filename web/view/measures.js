/** Measures between points of the world: a distance of two, the angle at the second of three. */

import { OPPOSITE } from "./camera.js";
import { vector } from "./rotation.js";

/** @typedef {import("./rotation.js").Vec3} Vec3 */
/** @typedef {import("../documents.js").Volume} Volume */
/** @typedef {Vec3[]} Measure two points, or three */

const DIGITS = 6; // of a coordinate: what an address can hold, and a voxel of any volume needs
const COORDINATE_DIGITS = 2; // decimals of a voxel that coordinates tell apart
const FURTHEST = 1e12;
const ARC_SHARE = 0.3; // of the shorter side of an angle
const ARC_STEPS = 16;

/** How many measures a view may have. */
export const MOST = 20;

/**
 * Measures with digits that an address can hold; what is none is left out.
 * @param {unknown} wanted
 * @returns {Measure[]}
 */
export function limitMeasures(wanted) {
  if (!Array.isArray(wanted)) return [];
  return wanted
    .filter(isMeasure)
    .slice(0, MOST)
    .map((points) => points.map(rounded));
}

/**
 * A measure as the address has it, `x,y,z;x,y,z`.
 * @param {Measure} points
 * @returns {string}
 */
export function writeMeasure(points) {
  return points.map((point) => point.join(",")).join(";");
}

/**
 * A measure that an address has; null where it is none.
 * @param {string} text
 * @returns {Measure|null}
 */
export function readMeasure(text) {
  const points = text
    .split(";")
    .map((point) => point.split(",").map((x) => (x.trim() ? Number(x) : NaN)));
  return isMeasure(points) ? points : null;
}

/**
 * How far two points are from each other.
 * @param {Vec3} a
 * @param {Vec3} b
 * @returns {number} in the unit of the world
 */
export function distanceOf(a, b) {
  return Math.hypot(...a.map((x, i) => b[i] - x));
}

/**
 * The angle at `b` between the ways to `a` and to `c`.
 * @param {Vec3} a
 * @param {Vec3} b
 * @param {Vec3} c
 * @returns {number} degrees, 0 to 180; NaN where one of the ways has no length
 */
export function angleOf(a, b, c) {
  const [u, v] = [from(b, a), from(b, c)];
  if (!Math.hypot(...u) || !Math.hypot(...v)) return NaN;
  const cross = Math.hypot(
    u[1] * v[2] - u[2] * v[1],
    u[2] * v[0] - u[0] * v[2],
    u[0] * v[1] - u[1] * v[0],
  );
  return (Math.atan2(cross, u[0] * v[0] + u[1] * v[1] + u[2] * v[2]) * 180) / Math.PI;
}

/**
 * A length with its unit, for a person: voxels or units, where the volume has none.
 * @param {Pick<Volume, "unit"|"spacing">} volume
 * @param {number} length
 * @returns {string}
 */
export function lengthInWords({ unit, spacing }, length) {
  const own = `${spacing.every((step) => step === 1) ? "voxel" : "unit"}${length === 1 ? "" : "s"}`;
  return `${length} ${unit || own}`;
}

/**
 * The coordinates of a place in the world, with digits that tell a hundredth of a voxel.
 * @param {Pick<Volume, "spacing">} volume
 * @param {Vec3} place
 * @param {string} sides of a patient on which the coordinates lie, such as "LAS"; "" elsewhere
 * @returns {string[]}
 */
export function coordinatesInWords({ spacing }, place, sides) {
  const decimals = Math.min(
    20,
    Math.max(0, Math.ceil(-Math.log10(Math.min(...spacing))) + COORDINATE_DIGITS),
  );
  const shown = (/** @type {number} */ x) => String(Number(x.toFixed(decimals))).replace("-", "−");
  return place.map((x, i) => (sides ? `${sides[i]} ${shown(Math.abs(x))}` : shown(x)));
}

/**
 * A place in the world with its unit, for a person, such as "L 12 · A 3.5 · S 40 mm".
 * @param {Pick<Volume, "spacing"|"unit">} volume
 * @param {Vec3} place
 * @param {string} sides of a patient on which the coordinates lie; "" elsewhere
 * @returns {string}
 */
export function placeInWords(volume, place, sides) {
  return `${coordinatesInWords(volume, place, sides).join(sides ? " · " : ", ")} ${volume.unit}`.trim();
}

/**
 * The sides of a patient on which a place of the world lies, such as "LAS"; "" where the volume is
 * of none.
 * @param {Pick<Volume, "letters">} volume
 * @param {Vec3} place
 * @returns {string}
 */
export function sidesAt({ letters }, place) {
  return [...letters].map((letter, i) => (place[i] >= 0 ? letter : OPPOSITE[letter])).join("");
}

/**
 * A quantity as exactly as it is known, such as "1614 ± 15 mm³".
 * @param {number} value
 * @param {number} error
 * @param {string} unit
 * @returns {string}
 */
export function knownInWords(value, error, unit) {
  const digits = error > 0 ? Math.ceil(Math.log10(value / error) + 1e-9) + 1 : 6;
  const shown = Number(value.toPrecision(Math.min(6, Math.max(1, digits))));
  return `${shown}${error > 0 ? ` ± ${Number(error.toPrecision(2))}` : ""} ${unit}`;
}

/**
 * What a measure comes to, such as "23.4 mm" or "41.2°".
 * @param {Pick<Volume, "unit"|"spacing">} volume
 * @param {Measure} points
 * @returns {string}
 */
export function measureInWords(volume, [a, b, c]) {
  if (c === undefined) return lengthInWords(volume, Number(distanceOf(a, b).toPrecision(4)));
  const angle = angleOf(a, b, c);
  return Number.isNaN(angle) ? "no angle" : `${angle.toFixed(1)}°`;
}

/**
 * The arc of an angle: points of the world from the one side to the other; none of a distance.
 * @param {Measure} points
 * @returns {Vec3[]}
 */
export function arcOf([a, b, c]) {
  if (c === undefined) return [];
  const [u, v] = [from(b, a), from(b, c)];
  const radius = ARC_SHARE * Math.min(Math.hypot(...u), Math.hypot(...v));
  return Array.from({ length: ARC_STEPS + 1 }, (_, step) => {
    const share = step / ARC_STEPS;
    const way = vector((i) => (1 - share) * unit(u)[i] + share * unit(v)[i]);
    return vector((i) => b[i] + radius * unit(way)[i]);
  });
}

/** @param {unknown} points @returns {points is Measure} */
function isMeasure(points) {
  const row = (/** @type {unknown} */ point) =>
    Array.isArray(point) && point.length === 3 && point.every(isNear);
  return Array.isArray(points) && [2, 3].includes(points.length) && points.every(row);
}

/** @param {unknown} x */
function isNear(x) {
  return typeof x === "number" && Math.abs(x) <= FURTHEST;
}

/** @param {Vec3} point */
function rounded(point) {
  return vector((i) => Number(point[i].toPrecision(DIGITS)));
}

/** @param {Vec3} a @param {Vec3} b */
function from(a, b) {
  return vector((i) => b[i] - a[i]);
}

/** @param {Vec3} v */
function unit(v) {
  const length = Math.hypot(...v) || 1;
  return vector((i) => v[i] / length);
}
