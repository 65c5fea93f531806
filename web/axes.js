/** Axes: where they end, and ticks that read well. */

import { niceStep } from "./view.js";

const UNITS = [[3600, "hours"], [60, "minutes"], [1, "seconds"]];
const MOST_TICKS = 6;

/**
 * An axis of time from 0 to the first tick that is no earlier than `seconds`, in a fitting unit.
 * @param {number} seconds
 * @returns {{end: number, unit: string, ticks: {at: number, label: string}[]}} `end` and `at` in seconds
 */
export function timeAxis(seconds) {
  const [size, unit] = UNITS.find(([length]) => seconds >= 2 * length) ?? UNITS.at(-1);
  const length = Math.max(1, seconds / size);
  const step = niceStep(length, MOST_TICKS - 1);
  const count = Math.ceil(length / step - 1e-9);
  const ticks = Array.from({ length: count + 1 }, (_, i) => ({ at: i * step * size, label: short(i * step) }));
  return { end: count * step * size, unit, ticks };
}

/**
 * A logarithmic axis around some relative errors, from 1, 2 or 5 times a power of ten, a little below, to 1 or 5 times one.
 * @param {number[]} errors those that are not above zero have no place on it
 * @returns {{low: number, high: number, ticks: {at: number, label: string}[]}}
 */
export function errorAxis(errors) {
  const seen = errors.filter((error) => error > 0);
  const [least, most] = seen.length ? [Math.min(...seen), Math.max(...seen)] : [0.01, 1];
  const all = rungs(Math.floor(Math.log10(least)) - 1, Math.ceil(Math.log10(most)) + 1);
  const low = all.findLast((rung) => rung <= 0.8 * least);
  const high = all.find((rung, i) => rung >= most * (1 - 1e-9) && i % 3 !== 1); // 1 or 5, well above the next power
  const within = all.filter((rung) => rung >= low && rung <= high);
  const ticks = within.length > MOST_TICKS ? within.filter((rung) => rung === high || isPowerOfTen(rung)) : within;
  return { low, high, ticks: ticks.map((at) => ({ at, label: `${short(100 * at)} %` })) };
}

/** 1, 2 and 5 times the powers of ten from `first` to `last`. */
function rungs(first, last) {
  const powers = Array.from({ length: last - first + 1 }, (_, i) => first + i);
  return powers.flatMap((power) => [1, 2, 5].map((factor) => Number(`${factor}e${power}`)));
}

function isPowerOfTen(number) {
  return Number.isInteger(Number(Math.log10(number).toFixed(9)));
}

function short(number) {
  return String(Number(number.toPrecision(3)));
}
