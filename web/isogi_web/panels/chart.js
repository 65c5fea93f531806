/**
 * Draws the history of a picture: the error on a logarithmic axis, and below it the coverage, over
 * the same seconds.
 */

import { find, svgElement } from "../dom.js";
import { STATES } from "../net/schemas.js";
import { errorInWords, niceStep } from "../view/format.js";

/** @typedef {import("./error.js").Moment} Moment */
/**
 * @typedef {Moment & {lasts?: boolean}} Drawn a moment; `lasts` marks the end of the axis, to which
 *   the final state is extended
 */
/** @typedef {import("../net/schemas.js").State} State */
/** @typedef {{at: number, label: string}} Tick */
/** @typedef {(value: number) => number} Scale maps seconds, an error or a share to pixels */

const [LEFT, RIGHT] = [46, 14]; // margins, pixels
const ERROR = { top: 20, bottom: 112 }; // place of the error's diagram, pixels
const SHARES = { top: 142, bottom: 184 }; // place of the coverage's diagram, pixels
const ROOM = 1.1; // length of the time axis over the newest moment, at least

/** Units of the time axis: seconds, and name. @type {[number, string][]} */
const UNITS = [
  [3600, "hours"],
  [60, "minutes"],
  [1, "seconds"],
];
const MOST_TICKS = 6; // ticks of an axis

/** A chart that fills the width of its SVG element, in pixels. */
export class Chart {
  #svg;
  #layer;
  /** @type {{moments: Moment[], target: number}} */
  #shown = { moments: [], target: NaN };

  /** @param {SVGSVGElement} svg holds the hatches, and a `g` to draw in */
  constructor(svg) {
    this.#svg = svg;
    this.#layer = find(svg, "g", SVGGElement);
    new ResizeObserver(() => this.#draw()).observe(svg);
  }

  /**
   * Draw a history.
   * @param {Moment[]} moments
   * @param {number} target relative error, drawn as a line; NaN for none
   */
  show(moments, target) {
    this.#shown = { moments, target };
    this.#draw();
  }

  /** Draw the history at the current width. */
  #draw() {
    const { moments, target } = this.#shown;
    const time = timeAxis(ROOM * (moments.at(-1)?.seconds ?? 0));
    const width = this.#svg.clientWidth;
    /** @type {Scale} */
    const x = (seconds) => LEFT + (Math.max(width - RIGHT - LEFT, 0) * seconds) / time.end;
    const lasting = held(moments, time.end);
    this.#layer.replaceChildren(
      ...drawTime(time, x),
      ...drawError(
        lasting.filter(({ error }) => error > 0),
        target,
        x,
      ),
      ...drawShares(lasting, x),
    );
  }
}

/**
 * Extend the final state to the end of the axis, as it does not change any more.
 * @param {Moment[]} moments
 * @param {number} end seconds
 * @returns {Drawn[]}
 */
function held(moments, end) {
  const last = moments.at(-1);
  return last && !last.provisional ? [...moments, { ...last, seconds: end, lasts: true }] : moments;
}

/**
 * Return an axis of time from 0 to the first tick at or after `seconds`, in a suitable unit.
 * @param {number} seconds
 * @returns {{end: number, unit: string, ticks: Tick[]}} `end` and `at` in seconds
 */
export function timeAxis(seconds) {
  const [size, unit] = UNITS.find(([length]) => seconds >= 2 * length) ?? UNITS[2];
  const length = Math.max(1, seconds / size);
  const step = niceStep(length, MOST_TICKS - 1);
  const count = Math.ceil(length / step - 1e-9);
  const ticks = Array.from({ length: count + 1 }, (_, i) => ({
    at: i * step * size,
    label: short(i * step),
  }));
  return { end: count * step * size, unit, ticks };
}

/**
 * Return a logarithmic axis around some relative errors. It begins a little below the least at 1, 2
 * or 5 times a power of ten, and ends at 1 or 5 times one.
 * @param {number[]} errors those that are not above zero are left out
 * @returns {{low: number, high: number, ticks: Tick[]}}
 */
export function errorAxis(errors) {
  const seen = errors.filter((error) => error > 0);
  const [least, most] = seen.length ? [Math.min(...seen), Math.max(...seen)] : [0.01, 1];
  const all = niceNumbers(Math.floor(Math.log10(least)) - 1, Math.ceil(Math.log10(most)) + 1);
  // Begin at least 20 % below the least error.
  const low = /** @type {number} */ (all.findLast((each) => each <= 0.8 * least));
  const ends = all.filter((_, i) => i % 3 !== 1); // 1 and 5 times a power of ten
  const high = /** @type {number} */ (ends.find((each) => each >= most * (1 - 1e-9)));
  const within = all.filter((each) => each >= low && each <= high);
  // If there are too many ticks, keep powers of ten and the end.
  const ticks =
    within.length > MOST_TICKS
      ? within.filter((each) => each === high || isPowerOfTen(each))
      : within;
  return { low, high, ticks: ticks.map((at) => ({ at, label: `${short(100 * at)} %` })) };
}

/**
 * Return 1, 2 and 5 times the powers of ten from `first` to `last`.
 * @param {number} first
 * @param {number} last
 */
function niceNumbers(first, last) {
  const powers = Array.from({ length: last - first + 1 }, (_, i) => first + i);
  return powers.flatMap((power) => [1, 2, 5].map((factor) => Number(`${factor}e${power}`)));
}

/** Return true if a number is a power of ten. @param {number} number */
function isPowerOfTen(number) {
  return Number.isInteger(Number(Math.log10(number).toFixed(9)));
}

/** Write a number with three digits at most. @param {number} number */
function short(number) {
  return String(Number(number.toPrecision(3)));
}

/**
 * Draw the labels and the name of the time axis.
 * @param {{end: number, unit: string, ticks: Tick[]}} axis
 * @param {Scale} x
 */
function drawTime({ end, unit, ticks }, x) {
  const labels = ticks.map(({ at, label }) =>
    svgElement("text", { x: x(at), y: SHARES.bottom + 15, class: "x" }, label),
  );
  const name = svgElement(
    "text",
    { x: x(end / 2), y: SHARES.bottom + 31, class: "x" },
    `${unit} since the view changed`,
  );
  // Each state lies on top of the states that are better.
  return [...labels, name];
}

/**
 * Draw the error over time, its axis, and its target.
 * @param {Drawn[]} moments
 * @param {number} target
 * @param {Scale} x
 */
function drawError(moments, target, x) {
  const axis = errorAxis([...moments.map(({ error }) => error), target]);
  /** @type {Scale} */
  const share = (error) => Math.log(error / axis.low) / Math.log(axis.high / axis.low);
  /** @type {Scale} */
  const y = (error) => ERROR.bottom - (ERROR.bottom - ERROR.top) * share(error);
  const points = moments.map(({ seconds, error }) => [x(seconds).toFixed(1), y(error).toFixed(1)]);
  const newest = points[moments.findLastIndex(({ lasts }) => !lasts)];
  return [
    svgElement("text", { x: LEFT, y: ERROR.top - 9 }, "error, log scale"),
    ...drawTicks(axis.ticks, y),
    ...(target > 0 ? drawTarget(target, y(target)) : []),
    svgElement("polyline", { class: "error", points: points.join(" ") }),
    ...(newest
      ? [svgElement("circle", { class: "newest", cx: newest[0], cy: newest[1], r: 3.5 })]
      : []),
  ];
}

/**
 * Draw the target as a line.
 * @param {number} target
 * @param {number} y pixels
 */
function drawTarget(target, y) {
  const under = y - ERROR.top < 12; // above the line is the name of the axis
  const label = { class: "target", x: LEFT + 6, y: under ? y + 13 : y - 5 };
  return [
    svgElement("path", { class: "target", d: `M${LEFT} ${y}H10000` }),
    svgElement("text", label, `target ${errorInWords(target)}`),
  ];
}

/**
 * Draw the coverage over time as stacked areas.
 * @param {Drawn[]} moments
 * @param {Scale} x
 */
function drawShares(moments, x) {
  /** @type {Scale} */
  const y = (share) => SHARES.bottom - (SHARES.bottom - SHARES.top) * Math.min(share, 1);
  const ticks = [
    { at: 0, label: "0 %" },
    { at: 1, label: "100 %" },
  ];
  return [
    svgElement("text", { x: LEFT, y: SHARES.top - 9 }, "share of the surface"),
    ...drawTicks(ticks, y),
    ...STATES.map((state, i) =>
      drawArea(
        state,
        moments,
        x,
        (moment) => y(upTo(moment, i)),
        (moment) => y(upTo(moment, i + 1)),
      ),
    ),
  ];
}

/** Add the shares of the first `count` states. @param {Moment} moment @param {number} count */
function upTo({ coverage }, count) {
  return STATES.slice(0, count).reduce((sum, state) => sum + coverage[state], 0);
}

/**
 * Draw the area of one state.
 * @param {State} state
 * @param {Drawn[]} moments
 * @param {Scale} x
 * @param {(moment: Moment) => number} lower
 * @param {(moment: Moment) => number} upper
 */
function drawArea(state, moments, x, lower, upper) {
  /** @type {(moment: Moment, y: (moment: Moment) => number) => string} */
  const point = (moment, y) => `${x(moment.seconds).toFixed(1)},${y(moment).toFixed(1)}`;
  const outline = [
    ...moments.map((each) => point(each, upper)),
    ...moments.toReversed().map((each) => point(each, lower)),
  ];
  /** @type {Record<string, string>} */
  const fill = state === "final" ? {} : { fill: `url(#hatch-${state})` };
  return svgElement("polygon", { class: state, points: outline.join(" "), ...fill });
}

/**
 * Draw ticks with grid lines.
 * @param {Tick[]} ticks
 * @param {Scale} y
 */
function drawTicks(ticks, y) {
  return ticks.flatMap(({ at, label }) => [
    svgElement("path", { class: "grid", d: `M${LEFT} ${crisp(y(at))}H10000` }),
    svgElement("text", { class: "y", x: LEFT - 7, y: y(at) + 4 }, label),
  ]);
}

/** Return the middle of a pixel, at which a thin line is sharp. @param {number} length */
function crisp(length) {
  return Math.round(length) + 0.5;
}
