/** What came when: the estimated error and the coverage since the view last changed. */

const MOST = 600; // moments kept; a drawing tells no more apart

/**
 * @typedef {object} Moment
 * @property {number} seconds since the view last changed
 * @property {number} error estimated relative RMSE
 * @property {{final: number, converging: number, provisional: number}} coverage shares of the surface pixels
 * @property {boolean} provisional
 */

/** The frames of one view at rest, in the order in which they came. */
export class History {
  #clock;
  #start;
  #moments = [];

  /** @param {() => number} [clock] milliseconds */
  constructor(clock = () => performance.now()) {
    this.#clock = clock;
    this.#start = clock();
  }

  /** The view has changed: forget what came before. */
  begin() {
    this.#start = this.#clock();
    this.#moments = [];
  }

  /**
   * Note a frame that has just come. After the first final one nothing changes, so no more are kept; of very many,
   * every other one is.
   * @param {import("./api.js").Facts} facts
   */
  add({ error, coverage, provisional }) {
    if (!Number.isFinite(error) || (!provisional && this.latest?.provisional === false)) return;
    if (this.#moments.length >= MOST) this.#moments = this.#moments.filter((_, i) => i % 2 === 0);
    this.#moments.push({ seconds: (this.#clock() - this.#start) / 1000, error, coverage, provisional });
  }

  /** All moments, oldest first. @returns {Moment[]} */
  get moments() {
    return [...this.#moments];
  }

  /** The newest moment, if any. @returns {Moment|undefined} */
  get latest() {
    return this.#moments.at(-1);
  }
}
