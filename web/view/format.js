/** Numbers, shares, errors, times, shadings and the state of a frame, as a person reads them. */

/** @typedef {import("../net/schemas.js").Facts} Facts */
/**
 * @typedef {Pick<Facts,
 *   "provisional"|"surface"|"error"|"controls"|"interval"|"p99"|"timeLeft">} StateFacts
 */

/** @type {Record<string, string>} */
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
 * What people call a shading.
 * @param {string} id
 * @returns {string}
 */
export function shadingName(id) {
  return SHADING_NAMES[id] ?? id;
}

/**
 * A step that reads well, 1, 2 or 5 times a power of ten, and cuts a span into no more than so many
 * parts.
 * @param {number} span
 * @param {number} [parts] by default as many positions as a slider has
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
 * A number with the digits that `step` can tell apart, and no more; any magnitude.
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
 * A value with the digits that tell it from its neighbours in a range, as the server's single
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
 * The time of a stage, such as "3.4 ms" or "120 ms".
 * @param {number} ms milliseconds
 * @returns {string}
 */
export function millisecondsInWords(ms) {
  return `${ms < 10 ? ms.toFixed(1) : Math.round(ms)} ms`;
}

/**
 * A time in the unit that a person would use: "0.4 s", "41 s", "3 min", "2 h".
 * @param {number} seconds
 * @returns {string}
 */
export function timeInWords(seconds) {
  const [size, unit] = seconds >= 7200 ? [3600, "h"] : seconds >= 120 ? [60, "min"] : [1, "s"];
  return `${Number((seconds / size).toFixed(seconds < 1 ? 1 : 0))} ${unit}`;
}

/**
 * What is left, in seconds, and whether the work takes longer than was said before.
 * @typedef {{low: number, likely: number, high: number, overdue?: boolean}} Left
 */

/**
 * What a time left says some seconds later, if nothing else is known: less by these. Once they are
 * over, the work takes longer than expected, and twice as long; and so on.
 * @template {Left|null} T
 * @param {T} left
 * @param {number} seconds
 * @returns {T|Left}
 */
export function leftAfter(left, seconds) {
  if (!left) return left;
  let [passed, span] = [seconds, Math.max(left.likely, 1)];
  let overdue = left.overdue ?? false;
  for (; passed >= span; span *= 2) {
    passed -= span;
    overdue = true;
  }
  const within = passed === seconds; // of what was said
  const likely = within ? Math.min(span - passed, left.likely) : span - passed;
  const share = left.likely > 0 ? likely / left.likely : 1;
  return { low: share * left.low, likely, high: share * left.high, overdue };
}

/**
 * How long it still takes, such as "about 20 s left".
 * @param {Pick<Left, "likely"|"overdue">} left
 * @returns {string}
 */
export function leftInWords({ likely, overdue }) {
  const words = `about ${atLeastOne(likely)} left`;
  return overdue ? `longer than expected, ${words}` : words;
}

/**
 * The same with its range: "about 20 s left (12 s to 41 s)".
 * @param {Left} left
 * @returns {string}
 */
export function rangeInWords(left) {
  const [low, high] = [atLeastOne(left.low), atLeastOne(left.high)];
  return low === high ? leftInWords(left) : `${leftInWords(left)} (${low} to ${high})`;
}

/**
 * The state of a frame: "Preview, about 40 s left", "Refining, about 1.8 % error", "Done, 0.8 %
 * error".
 * @param {StateFacts} facts
 * @param {{target?: number, empty?: string}} [about] the relative error at which it is done, and
 *   what is said of a frame that shows no surface
 * @returns {string}
 */
export function frameInWords(facts, { target = 0, empty = "No surface in view" } = {}) {
  const { provisional, error, controls, timeLeft } = facts;
  if (!showsSurface(facts)) return empty;
  const known = error > 0 && error < PREVIEW;
  const wrong = known ? `${controls ? "" : "about "}${errorInWords(error)} error` : "";
  const reason = known ? reasonInWords(facts, target) : "";
  const left = provisional && timeLeft ? leftInWords(timeLeft) : "";
  return [!provisional ? "Done" : known ? "Refining" : "Preview", wrong, reason, left]
    .filter(Boolean)
    .join(", ");
}

/** Relative error from which on a picture is called a preview. */
export const PREVIEW = 0.9;

// error that 99 % of the pixels of a picture that is done stay below, over its target
const TAIL = 5;

/**
 * Why a picture is not done though its error is below the target; "" where that is not so.
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
 * Whether a frame shows any surface.
 * @param {Pick<Facts, "surface">} facts
 * @returns {boolean}
 */
export function showsSurface({ surface }) {
  return surface !== 0;
}

/**
 * What is said of a view whose picture shows no surface: why, and what to do.
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

/** @param {number} seconds */
function atLeastOne(seconds) {
  return timeInWords(Math.max(1, seconds));
}
