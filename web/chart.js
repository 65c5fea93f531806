/** Draws a history: the error on a logarithmic axis, and under it the coverage, over the same seconds. */

import { errorAxis, timeAxis } from "./axes.js";
import { make } from "./svg.js";
import { errorInWords } from "./units.js";

const [LEFT, RIGHT] = [46, 14]; // margins, pixels
const ERROR = { top: 20, bottom: 112 };
const SHARES = { top: 142, bottom: 184 };
const ROOM = 1.1; // how far the time axis goes beyond the newest moment, at least
const STATES = ["final", "converging", "provisional"]; // from the bottom up, as light becomes final

/** A chart that fills the width of its SVG element, pixel for pixel. */
export class Chart {
  #svg;
  #layer;
  #shown = { moments: [], target: NaN };

  /** @param {SVGSVGElement} svg holds the hatches, and a `g` to draw in */
  constructor(svg) {
    this.#svg = svg;
    this.#layer = svg.querySelector("g");
    new ResizeObserver(() => this.#draw()).observe(svg);
  }

  /**
   * Draw a history.
   * @param {import("./history.js").Moment[]} moments
   * @param {number} target relative error, drawn as a line; NaN for none
   */
  show(moments, target) {
    this.#shown = { moments, target };
    this.#draw();
  }

  #draw() {
    const { moments, target } = this.#shown;
    const time = timeAxis(ROOM * (moments.at(-1)?.seconds ?? 0));
    const width = this.#svg.clientWidth;
    const x = (seconds) => LEFT + (Math.max(width - RIGHT - LEFT, 0) * seconds) / time.end;
    const lasting = held(moments, time.end);
    this.#layer.replaceChildren(
      ...drawTime(time, x),
      ...drawError(lasting.filter(({ error }) => error > 0), target, x),
      ...drawShares(lasting, x),
    );
  }
}

/** What is final stays so: its last moment lasts until the end of the axis. */
function held(moments, end) {
  const last = moments.at(-1);
  return last && !last.provisional ? [...moments, { ...last, seconds: end, lasts: true }] : moments;
}

function drawTime({ end, unit, ticks }, x) {
  const labels = ticks.map(({ at, label }) => make("text", { x: x(at), y: SHARES.bottom + 15, class: "x" }, label));
  const name = make("text", { x: x(end / 2), y: SHARES.bottom + 31, class: "x" }, `${unit} since the view changed`);
  return [...labels, name];
}

function drawError(moments, target, x) {
  const axis = errorAxis([...moments.map(({ error }) => error), target]);
  const share = (error) => Math.log(error / axis.low) / Math.log(axis.high / axis.low);
  const y = (error) => ERROR.bottom - (ERROR.bottom - ERROR.top) * share(error);
  const points = moments.map(({ seconds, error }) => [x(seconds).toFixed(1), y(error).toFixed(1)]);
  const newest = points[moments.findLastIndex(({ lasts }) => !lasts)];
  return [
    make("text", { x: LEFT, y: ERROR.top - 9 }, "error, log scale"),
    ...drawTicks(axis.ticks, y),
    ...(target > 0 ? drawTarget(target, y(target)) : []),
    make("polyline", { class: "error", points: points.join(" ") }),
    ...(newest ? [make("circle", { class: "newest", cx: newest[0], cy: newest[1], r: 3.5 })] : []),
  ];
}

function drawTarget(target, y) {
  const under = y - ERROR.top < 12; // the axis has its name there
  return [
    make("path", { class: "target", d: `M${LEFT} ${y}H10000` }),
    make("text", { class: "target", x: LEFT + 6, y: under ? y + 13 : y - 5 }, `target ${errorInWords(target)}, for every texel`),
  ];
}

function drawShares(moments, x) {
  const y = (share) => SHARES.bottom - (SHARES.bottom - SHARES.top) * Math.min(share, 1);
  const ticks = [{ at: 0, label: "0 %" }, { at: 1, label: "100 %" }];
  return [
    make("text", { x: LEFT, y: SHARES.top - 9 }, "share of the surface"),
    ...drawTicks(ticks, y),
    ...STATES.map((state, i) => drawArea(state, moments, x, (moment) => y(upTo(moment, i)), (moment) => y(upTo(moment, i + 1)))),
  ];
}

/** Sum of the shares of the first `count` states. */
function upTo({ coverage }, count) {
  return STATES.slice(0, count).reduce((sum, state) => sum + coverage[state], 0);
}

function drawArea(state, moments, x, lower, upper) {
  const point = (moment, y) => `${x(moment.seconds).toFixed(1)},${y(moment).toFixed(1)}`;
  const outline = [...moments.map((each) => point(each, upper)), ...moments.toReversed().map((each) => point(each, lower))];
  const fill = state === "final" ? {} : { fill: `url(#hatch-${state})` };
  return make("polygon", { class: state, points: outline.join(" "), ...fill });
}

function drawTicks(ticks, y) {
  return ticks.flatMap(({ at, label }) => [
    make("path", { class: "grid", d: `M${LEFT} ${crisp(y(at))}H10000` }),
    make("text", { class: "y", x: LEFT - 7, y: y(at) + 4 }, label),
  ]);
}

/** The middle of a pixel, where a thin line is sharp. */
function crisp(length) {
  return Math.round(length) + 0.5;
}
