/**
 * Points of the world that a view names: measures between points (the distance of two, or the angle
 * at the second of three), and the cross hair of the slices next to the picture.
 */

import { OPPOSITE } from "./camera.js";
import { dot, vector } from "./rotation.js";

/** @typedef {import("./rotation.js").Vec3} Vec3 */
/** @typedef {import("../documents.js").Volume} Volume */
/** @typedef {Vec3[]} Measure two points, or three */
/** @typedef {Record<string, string>} Notes texts beside measures, by what `writeMeasure` returns */
/** @typedef {[number, number]} Greys the values that are black and white, ascending */
/**
 * @typedef {{voxel: Vec3, greys: Greys|null}} CrossHair voxel indices, x first; null in `greys`
 *   stands for the volume's defaults
 */

const DIGITS = 6; // digits of a coordinate: short in an address, and finer than a voxel
const COORDINATE_DIGITS = 2; // decimals of a voxel that coordinates tell apart
const FURTHEST = 1e12; // largest coordinate
const ARC_SHARE = 0.3; // radius of an arc, as a share of the shorter side of its angle
const ARC_STEPS = 16; // segments of an arc

/** Number of measures that a view may have. */
export const MOST = 20;

/** Number of letters that a text beside a measure may have. */
export const NOTE_LETTERS = 60;

/**
 * Round measures to the digits of an address; anything else than a measure is left out.
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
 * Write a measure for the address: `x,y,z;x,y,z`.
 * @param {Measure} points
 * @returns {string}
 */
export function writeMeasure(points) {
  return points.map((point) => point.join(",")).join(";");
}

/**
 * Read a measure from the address, which may have a text behind a tilde; null if there is none.
 * @param {string} text
 * @returns {Measure|null}
 */
export function readMeasure(text) {
  const points = text
    .split("~", 1)[0]
    .split(";")
    .map((point) => point.split(",").map((x) => (x.trim() ? Number(x) : NaN)));
  return isMeasure(points) ? points : null;
}

/**
 * Return the texts beside measures that addresses give, as in `0,0,0;1,2,3~width of the duct`.
 * @param {string[]} measures as in an address
 * @returns {Notes}
 */
export function readNotes(measures) {
  /** @type {Notes} */
  const notes = {};
  for (const text of measures) {
    const points = readMeasure(text);
    const note = text.includes("~") ? text.slice(text.indexOf("~") + 1) : "";
    if (points && note) notes[writeMeasure(points.map(rounded))] = note;
  }
  return notes;
}

/**
 * Leave out texts of measures that a view does not have, and shorten long ones.
 * @param {unknown} wanted
 * @param {Measure[]} measures
 * @returns {Notes}
 */
export function limitNotes(wanted, measures) {
  if (typeof wanted !== "object" || wanted === null) return {};
  const given = /** @type {Record<string, unknown>} */ (wanted);
  const known = measures.map(writeMeasure).flatMap((name) => {
    const note = Object.hasOwn(given, name) ? String(given[name]).trim() : "";
    return note ? [[name, [...note].slice(0, NOTE_LETTERS).join("")]] : [];
  });
  return Object.fromEntries(known);
}

/**
 * Return the distance of two points.
 * @param {Vec3} a
 * @param {Vec3} b
 * @returns {number} in the world's unit
 */
export function distanceOf(a, b) {
  return Math.hypot(...a.map((x, i) => b[i] - x));
}

/**
 * Return the angle at `b` between the directions to `a` and to `c`.
 * @param {Vec3} a
 * @param {Vec3} b
 * @param {Vec3} c
 * @returns {number} degrees, 0 to 180; NaN if one of the points coincides with `b`
 */
export function angleOf(a, b, c) {
  const [u, v] = [from(b, a), from(b, c)];
  if (!Math.hypot(...u) || !Math.hypot(...v)) return NaN;
  const cross = Math.hypot(
    u[1] * v[2] - u[2] * v[1],
    u[2] * v[0] - u[0] * v[2],
    u[0] * v[1] - u[1] * v[0],
  );
  // The arc tangent is accurate for small angles, unlike the arc cosine.
  return (Math.atan2(cross, u[0] * v[0] + u[1] * v[1] + u[2] * v[2]) * 180) / Math.PI;
}

/**
 * Write a length with its unit; voxels or units if the volume has none.
 * @param {Pick<Volume, "unit"|"spacing">} volume
 * @param {number} length
 * @returns {string}
 */
export function lengthInWords({ unit, spacing }, length) {
  const name = spacing.every((step) => step === 1) ? "voxel" : "unit";
  return `${length} ${unit || (length === 1 ? name : `${name}s`)}`;
}

/**
 * Write the coordinates of a point of the world, to a hundredth of a voxel.
 * @param {Pick<Volume, "spacing">} volume
 * @param {Vec3} place
 * @param {string} sides letters of a patient's sides that replace the signs, such as "LAS"; "" if
 *   there is no patient
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
 * Write a point of the world with its unit, such as "L 12 · A 3.5 · S 40 mm".
 * @param {Pick<Volume, "spacing"|"unit">} volume
 * @param {Vec3} place
 * @param {string} sides letters of a patient's sides; "" if there is no patient
 * @returns {string}
 */
export function placeInWords(volume, place, sides) {
  return `${coordinatesInWords(volume, place, sides).join(sides ? " · " : ", ")} ${volume.unit}`.trim();
}

/**
 * Return the sides of a patient on which a point of the world lies, such as "LAS"; "" if the volume
 * has no patient.
 * @param {Pick<Volume, "letters">} volume
 * @param {Vec3} place
 * @returns {string}
 */
export function sidesAt({ letters }, place) {
  return [...letters].map((letter, i) => (place[i] >= 0 ? letter : OPPOSITE[letter])).join("");
}

/**
 * Write a quantity with the digits that its error leaves, such as "1614 ± 15 mm³".
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
 * Write the result of a measure, such as "23.4 mm" or "41.2°".
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
 * Return the arc of an angle as points of the world from one side to the other; none for a
 * distance.
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

/**
 * Write a cross hair for the address: `x,y,z` or `x,y,z,black,white`.
 * @param {CrossHair} crossHair
 * @returns {string}
 */
export function writeCrossHair({ voxel, greys }) {
  return [...voxel, ...(greys ?? [])].join(",");
}

/**
 * Read a cross hair from the address; null if the text is none.
 * @param {string} text
 * @returns {CrossHair|null}
 */
export function readCrossHair(text) {
  const numbers = text.split(",").map((number) => (number.trim() ? Number(number) : NaN));
  const [x, y, z, black, white] = numbers;
  if (![3, 5].includes(numbers.length) || !numbers.every(Number.isFinite)) return null;
  if (numbers.length === 3) return { voxel: [x, y, z], greys: null };
  return black < white ? { voxel: [x, y, z], greys: [black, white] } : null;
}

/**
 * Move a cross hair to the nearest voxel of the volume; null remains null.
 * @param {{size: Vec3}} volume
 * @param {CrossHair|null} wanted
 * @returns {CrossHair|null}
 */
export function limitCrossHair({ size }, wanted) {
  if (!wanted) return null;
  const voxel = vector((i) => Math.min(size[i] - 1, Math.max(0, Math.round(wanted.voxel[i]))));
  return { voxel, greys: wanted.greys };
}

/**
 * Return the point of the world at voxel indices, which may have fractions.
 * @param {{affine: number[][]}} volume
 * @param {Vec3} voxel
 * @returns {Vec3}
 */
export function worldOf({ affine }, voxel) {
  return vector((i) => dot(/** @type {Vec3} */ (affine[i].slice(0, 3)), voxel) + affine[i][3]);
}

/** Return true if some value is a measure. @param {unknown} points @returns {points is Measure} */
function isMeasure(points) {
  const row = (/** @type {unknown} */ point) =>
    Array.isArray(point) && point.length === 3 && point.every(isNear);
  return Array.isArray(points) && [2, 3].includes(points.length) && points.every(row);
}

/** Return true if some value is a coordinate. @param {unknown} x */
function isNear(x) {
  return typeof x === "number" && Math.abs(x) <= FURTHEST;
}

/** Round a point's coordinates. @param {Vec3} point */
function rounded(point) {
  return vector((i) => Number(point[i].toPrecision(DIGITS)));
}

/** Return the vector from `a` to `b`. @param {Vec3} a @param {Vec3} b */
function from(a, b) {
  return vector((i) => b[i] - a[i]);
}

/** Scale a vector to length 1; the zero vector is kept. @param {Vec3} v */
function unit(v) {
  const length = Math.hypot(...v) || 1;
  return vector((i) => v[i] / length);
}
