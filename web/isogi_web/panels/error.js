/**
 * The panel of the estimated error: its size, its history, and the time until the picture is final.
 */

import { find } from "../dom.js";
import { STATES } from "../net/schemas.js";
import {
  errorInWords,
  rangeInWords,
  shareInWords,
  showsSurface,
  timeInWords,
} from "../view/format.js";
import { Chart } from "./chart.js";

/** @typedef {import("../net/schemas.js").Facts} Facts */
/** @typedef {import("../view/model.js").Knobs} Knobs */

const MOST = 600; // moments that are kept: as many as a drawing can show
const WAITING = "Waiting for the picture of this view.";

/**
 * @typedef {object} Moment
 * @property {number} seconds since the view last changed
 * @property {number} error estimated relative RMSE
 * @property {import("../net/schemas.js").Coverage} coverage
 * @property {boolean} provisional
 */

/** The frames of one view at rest, in the order of their arrival. */
export class History {
  #clock;
  #start;
  /** @type {Moment[]} */
  #moments = [];

  /** @param {() => number} [clock] milliseconds */
  constructor(clock = () => performance.now()) {
    this.#clock = clock;
    this.#start = clock();
  }

  /** Forget all frames, as the view has changed. */
  begin() {
    this.#start = this.#clock();
    this.#moments = [];
  }

  /**
   * Add a frame that has just come. Frames after the first final one are ignored, as light does not
   * change any more; of very many frames, every other one is dropped.
   * @param {Pick<Facts, "error"|"coverage"|"provisional">} facts
   */
  add({ error, coverage, provisional }) {
    if (!Number.isFinite(error) || this.latest?.provisional === false) return;
    if (this.#moments.length >= MOST) this.#moments = this.#moments.filter((_, i) => i % 2 === 0);
    this.#moments.push({
      seconds: (this.#clock() - this.#start) / 1000,
      error,
      coverage,
      provisional,
    });
  }

  /** Return all moments, oldest first. @returns {Moment[]} */
  get moments() {
    return [...this.#moments];
  }

  /** Return the newest moment, if any. @returns {Moment|undefined} */
  get latest() {
    return this.#moments.at(-1);
  }
}

/** Shows the history of the view at rest. */
export class ErrorPanel {
  #root;
  #target;
  #chart;
  #history = new History();
  #light = "";
  /** @type {Facts|null} */
  #facts = null;

  /**
   * @param {HTMLElement} root holds a `.value`, a `.note`, a `.tail`, an `svg` and a `.legend`
   * @param {number} target relative error at which light counts as final
   */
  constructor(root, target) {
    this.#root = root;
    this.#target = target;
    this.#chart = new Chart(find(root, "svg", SVGSVGElement));
  }

  /**
   * Show the facts of the picture on the stage, and their history. A view in another light begins a
   * new history.
   * @param {Pick<import("../net/shown.js").Shown, "asked"|"facts"|"left">} shown
   */
  show({ asked, facts, left }) {
    const light = JSON.stringify(lightKnobs(asked.values));
    // Only time has passed: keep the chart.
    if (light === this.#light && facts === this.#facts) return this.#writeNote(facts, left);
    if (light !== this.#light) this.#history.begin();
    if (facts) this.#history.add(facts);
    this.#light = light;
    this.#facts = facts;
    this.#write(facts);
    this.#writeNote(facts, left);
  }

  /**
   * Show the progress of the picture, also while only time passes.
   * @param {Facts|null} facts of the picture
   * @param {Facts["timeLeft"]} left
   */
  #writeNote(facts, left) {
    const { latest } = this.#history;
    const note = find(this.#root, ".note");
    const words =
      latest && facts && Number.isFinite(facts.error)
        ? momentInWords({ ...facts, seconds: latest.seconds }, left)
        : WAITING;
    if (note.textContent !== words) note.textContent = words;
  }

  /** Show the error, the legend and the chart. @param {Facts|null} facts of the picture */
  #write(facts) {
    const { moments, latest } = this.#history;
    const known = latest && facts && Number.isFinite(facts.error);
    find(this.#root, ".value").textContent =
      known && showsSurface(facts) ? errorInWords(facts.error) : "";
    find(this.#root, ".tail").textContent = known ? tailInWords(facts) : "";
    find(this.#root, "svg", SVGSVGElement).setAttribute(
      "aria-label",
      courseInWords(moments, this.#target),
    );
    for (const state of STATES) {
      find(this.#root, `.legend .${state} b`).textContent = known
        ? legendShare(state, facts.coverage)
        : "";
    }
    this.#chart.show(moments, this.#target);
  }
}

/** Return the knobs that a view's light depends on. @param {Knobs} values */
function lightKnobs({ exposure, overlay, compare, background, measures, notes, rulers, ...rest }) {
  return rest;
}

/**
 * Describe the progress of a view, such as "after 3 s · about 20 s left (12 s to 41 s)".
 * @param {Moment} moment
 * @param {Facts["timeLeft"]} timeLeft
 * @returns {string}
 */
export function momentInWords({ seconds, provisional, error }, timeLeft) {
  const time = `after ${timeInWords(seconds)}`;
  if (!provisional) return error > 0 ? `done ${time}` : `done ${time} · nothing to estimate`;
  return timeLeft ? `${time} · ${rangeInWords(timeLeft)}` : time;
}

/**
 * Describe the error of the worst pixels, such as "1 % of pixels are off by more than 6.2 % (5.1 %
 * to 7.9 %)"; "" before it is measured.
 * @param {Pick<Facts, "p99"|"p99_interval">} facts
 * @returns {string}
 */
export function tailInWords({ p99, p99_interval: ends }) {
  if (p99 == null || !ends) return "";
  const [low, high] = ends.map(errorInWords);
  const range = ends[1] < 1 ? `${low} to ${high}` : `at least ${low}`;
  return `1 % of pixels are off by more than ${errorInWords(p99)} (${range})`;
}

/**
 * Describe the whole chart in one sentence.
 * @param {Moment[]} moments
 * @param {number} target relative error
 * @returns {string}
 */
export function courseInWords(moments, target) {
  const [first, last] = [moments.at(0), moments.at(-1)];
  if (!first || !last) return "Estimated error and coverage over time: nothing yet";
  const aim = target > 0 ? `, target ${errorInWords(target)}` : "";
  const error = `Estimated error from ${errorInWords(first.error)} to ${errorInWords(last.error)}${aim}`;
  const shares = `surface that is done from ${shareInWords(first.coverage.final)} to ${shareInWords(last.coverage.final)}`;
  return `${error}; ${shares}; over ${timeInWords(last.seconds)}`;
}

/**
 * Write a state's share of the surface. Shares that are not final are rounded up, as the server
 * does.
 * @param {import("../net/schemas.js").State} state
 * @param {import("../net/schemas.js").Coverage} coverage
 * @returns {string}
 */
export function legendShare(state, coverage) {
  return state === "final"
    ? shareInWords(coverage.final)
    : `${Math.ceil(100 * coverage[state] - 1e-9)} %`;
}
