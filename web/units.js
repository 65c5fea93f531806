/** Shares, errors and times as a person reads them. */

/**
 * A share of the whole, rounded down, so that 100 % means all of it.
 * @param {number} share within 0..1
 * @returns {string}
 */
export function shareInWords(share) {
  return `${Math.floor(100 * share + 1e-9)} %`;
}

/**
 * A relative error with two digits, such as "3.4 %".
 * @param {number} error
 * @returns {string}
 */
export function errorInWords(error) {
  return `${Number((100 * error).toPrecision(2))} %`;
}

/**
 * A time in the unit that a person would use: "0.4 s", "41 s", "3 min", "2 h".
 * @param {number} seconds
 * @returns {string}
 */
export function timeInWords(seconds) {
  const [size, unit] = [[3600, "h"], [60, "min"]].find(([length]) => seconds >= 2 * length) ?? [1, "s"];
  return `${Number((seconds / size).toFixed(seconds < 1 ? 1 : 0))} ${unit}`;
}

/**
 * How long it still takes, such as "about 20 s left".
 * @param {{likely: number}} left seconds
 * @returns {string}
 */
export function leftInWords({ likely }) {
  return `about ${atLeastOne(likely)} left`;
}

/**
 * The same with its range: "about 20 s left (12 s to 41 s)".
 * @param {{low: number, likely: number, high: number}} left seconds
 * @returns {string}
 */
export function rangeInWords(left) {
  const [low, high] = [atLeastOne(left.low), atLeastOne(left.high)];
  return low === high ? leftInWords(left) : `${leftInWords(left)} (${low} to ${high})`;
}

function atLeastOne(seconds) {
  return timeInWords(Math.max(1, seconds));
}
