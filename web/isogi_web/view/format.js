/** Numbers, shares, errors, times, shadings and the state of a frame, in words for people. */

/** @typedef {import("../net/schemas.js").Facts} Facts */
/**
 * @typedef {Pick<Facts,
 *   "provisional"|"surface"|"error"|"controls"|"interval"|"p99"|"timeLeft">} StateFacts
 */

/** Names of shadings, by their ids. @type {Record<string, string>} */
const SHADING_NAMES = {
  gi: "Global illumination",
  vicinity: "Vicinity shading",
  lambert: "Diffuse, no shadows",
  lambert_shadow: "Diffuse, shadows",
  lambert_fog: "Diffuse, depth fog",
  phong: "Phong, no shadows",
  phong_shadow: "Phong, shadows",
  path_traced: "Path traced (reference, slow)",
};

/**
 * Return the name of a shading.
 * @param {string} id
 * @returns {string}
 */
export function shadingName(id) {
  return SHADING_NAMES[id] ?? id;
}

/**
 * Return a step of 1, 2 or 5 times a power of ten that divides a span into at most `parts` steps.
 * @param {number} span
 * @param {number} [parts] by default the number of positions of a slider
 * @returns {number}
 */
export function niceStep(span, parts = 500) {
  const rough = span / parts;
  const power = 10 ** Math.floor(Math.log10(rough));
  return (
    [1, 2, 5].map((factor) => factor * power).find((step) => step >= rough * 0.999) ?? 10 * power
  );
}

/**
 * Write a number of any magnitude with the digits that `step` can tell apart, and no more.
 * @param {number} value
 * @param {number} step
 * @returns {string}
 */
export function showNumber(value, step) {
  if (Math.abs(value) <= step * 1e-6) return "0";
  const digits = Math.ceil(Math.log10(Math.abs(value) / step) + 1e-9) + 2;
  return String(Number(value.toPrecision(Math.min(17, Math.max(1, digits)))));
}

/**
 * Round a value to the digits that tell it from its neighbours in a range, as the server's single
 * floats do: typed back, it is the same surface.
 * @param {number} value
 * @param {readonly [number, number]|number[]} range least and greatest value
 * @returns {number}
 */
export function exactValue(value, [low, high]) {
  const most = Math.max(Math.abs(low), Math.abs(high));
  const digits = Math.ceil(Math.log10(most / (high - low))) + FLOAT_DIGITS;
  return Number(value.toPrecision(Number.isFinite(digits) ? Math.min(17, digits) : 17));
}

/** Digits of a single float. */
const FLOAT_DIGITS = 9;

/**
 * Write a share in percent, rounded down, so that 100 % means all of it.
 * @param {number} share 0 to 1
 * @returns {string}
 */
export function shareInWords(share) {
  return `${Math.floor(100 * share + 1e-9)} %`;
}

/**
 * Write a relative error with two digits, such as "3.4 %".
 * @param {number} error
 * @returns {string}
 */
export function errorInWords(error) {
  return `${Number((100 * error).toPrecision(2))} %`;
}

/**
 * Write the time of a stage, such as "3.4 ms" or "120 ms".
 * @param {number} ms milliseconds
 * @returns {string}
 */
export function millisecondsInWords(ms) {
  return `${ms < 10 ? ms.toFixed(1) : Math.round(ms)} ms`;
}

/**
 * Write a time in the unit that a person would use: "0.4 s", "41 s", "3 min", "2 h".
 * @param {number} seconds
 * @returns {string}
 */
export function timeInWords(seconds) {
  if (seconds >= 7200) return `${Math.round(seconds / 3600)} h`;
  if (seconds >= 120) return `${Math.round(seconds / 60)} min`;
  return `${Number(seconds.toFixed(seconds < 1 ? 1 : 0))} s`;
}

/**
 * Estimate of the time left, in seconds: a range, the likely value, and true in `overdue` if the
 * work takes longer than was estimated before.
 * @typedef {{low: number, likely: number, high: number, overdue?: boolean}} Left
 */

/**
 * Return an estimate of the time left some seconds later, if nothing else is known: reduced by
 * these seconds.
 *
 * Once the likely time has passed, the work is overdue: expect that it takes as long again, then
 * twice as long, and so on.
 *
 * @template {Left|null} T
 * @param {T} left
 * @param {number} seconds
 * @returns {T|Left}
 */
export function leftAfter(left, seconds) {
  if (!left) return left;
  let passed = seconds;
  let span = Math.max(left.likely, 1);
  let overdue = left.overdue ?? false;
  for (; passed >= span; span *= 2) {
    passed -= span;
    overdue = true;
  }
  const within = passed === seconds; // true if the estimate has not passed
  const likely = within ? Math.min(span - passed, left.likely) : span - passed;
  // Scale the range with the likely time.
  const share = left.likely > 0 ? likely / left.likely : 1;
  return { low: share * left.low, likely, high: share * left.high, overdue };
}

/**
 * Write the time left, such as "about 20 s left".
 * @param {Pick<Left, "likely"|"overdue">} left
 * @returns {string}
 */
export function leftInWords({ likely, overdue }) {
  const words = `about ${atLeastOne(likely)} left`;
  return overdue ? `longer than expected, ${words}` : words;
}

/**
 * Write the time left with its range: "about 20 s left (12 s to 41 s)".
 * @param {Left} left
 * @returns {string}
 */
export function rangeInWords(left) {
  const [low, high] = [atLeastOne(left.low), atLeastOne(left.high)];
  return low === high ? leftInWords(left) : `${leftInWords(left)} (${low} to ${high})`;
}

/**
 * Describe the state of a frame: "Preview, about 40 s left", "Refining, about 1.8 % error", "Done,
 * 0.8 % error".
 * @param {StateFacts} facts
 * @param {{target?: number, empty?: string}} [about] `target` is the relative error at which the
 *   frame is done, `empty` the words for a frame without a surface
 * @returns {string}
 */
export function frameInWords(facts, { target = 0, empty = "No surface in view" } = {}) {
  const { provisional, error, controls, timeLeft } = facts;
  if (!showsSurface(facts)) return empty;
  const known = error > 0 && error < PREVIEW;
  // An error that was not measured by control pixels is an estimate: “about”.
  const wrong = known ? `${controls ? "" : "about "}${errorInWords(error)} error` : "";
  const reason = known ? reasonInWords(facts, target) : "";
  const left = provisional && timeLeft ? leftInWords(timeLeft) : "";
  let state = "Done";
  if (provisional) state = known ? "Refining" : "Preview";
  return [state, wrong, reason, left].filter(Boolean).join(", ");
}

/** Relative error from which a picture is called a preview. */
export const PREVIEW = 0.9;

/** Error that 99 % of the pixels of a final picture stay below, over its target. */
const TAIL = 5;

/**
 * Return the reason why a picture is not done although its error is below the target; otherwise "".
 * @param {StateFacts} facts
 * @param {number} target relative error
 * @returns {string}
 */
export function reasonInWords({ provisional, error, controls, interval, p99 }, target) {
  if (!provisional || !(error <= target)) return "";
  if (!controls) return "not measured yet";
  if (interval && interval[1] > target)
    return `between ${errorInWords(interval[0])} and ${errorInWords(interval[1])}`;
  if (p99 && p99 > TAIL * target) return `1 % of pixels off by more than ${errorInWords(p99)}`;
  return "not all of its light is there yet";
}

/**
 * Return true if a frame shows a surface, or does not tell.
 * @param {Pick<Facts, "surface">} facts
 * @returns {boolean}
 */
export function showsSurface({ surface }) {
  return surface !== 0;
}

/**
 * Explain why a view's picture shows no surface, and what to do about it.
 * @param {Pick<import("../net/schemas.js").Scene, "volume">} scene
 * @param {Pick<import("./model.js").Knobs, "isovalue"|"planes">} values knobs of the view
 * @returns {string}
 */
export function emptyInWords({ volume }, { isovalue, planes }) {
  const [low, high] = volume.value_range;
  if (low === high) return `No surface: all values are ${Number(low.toPrecision(6))}`;
  const step = niceStep(high - low);
  const [from, to, at] = [low, high, isovalue].map((value) => showNumber(value, step));
  if (isovalue <= low || isovalue >= high)
    return `No surface at ${at}: values go from ${from} to ${to}`;
  if (planes) return `No surface at ${at} in what the cut leaves: show all of it, or change either`;
  return `No surface at ${at} in view: reset the view, or choose another isovalue`;
}

/** Write a time of one second or more. @param {number} seconds */
function atLeastOne(seconds) {
  return timeInWords(Math.max(1, seconds));
}
