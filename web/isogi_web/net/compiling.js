/**
 * Shows how far kernels are compiled, at the first start on a machine, in a line over the picture.
 */

import { find } from "../dom.js";
import { CLOCK } from "./trouble.js";

const LOOK_MS = 500; // time between two looks

/** @typedef {import("./api.js").Readiness} Readiness */
/** @typedef {NonNullable<Readiness["compiling"]>} Progress */

/**
 * Describe a compilation at the start of a server.
 * @param {Progress} compiling
 * @param {boolean} drawn true if pictures are already drawn, without light
 * @returns {string}
 */
export function compilingWords(compiling, drawn) {
  return progressWords(drawn ? "Light comes when isogi is compiled" : "Compiling", compiling);
}

/**
 * Describe the progress of a compilation.
 * @param {string} what the beginning of the sentence
 * @param {Progress} compiling
 * @returns {string}
 */
export function progressWords(what, { done, total, seconds }) {
  const left = seconds === undefined ? "" : `, about ${timeLeft(seconds)} left`;
  return `${what}, once on this machine: ${done} of ${total}${left}`;
}

/** Return a time in words, in seconds or minutes. @param {number} seconds */
function timeLeft(seconds) {
  return seconds < 90 ? `${Math.max(Math.round(seconds), 1)} s` : `${Math.round(seconds / 60)} min`;
}

/** A line that is shown while the server compiles. */
export class CompilingLine {
  #root;
  #ask;
  #clock;

  /**
   * @param {HTMLElement} root
   * @param {() => Promise<Readiness|null>} ask asks the server; null if it does not answer
   * @param {import("./trouble.js").Clock} [clock]
   */
  constructor(root, ask, clock = CLOCK) {
    this.#root = root;
    this.#ask = ask;
    this.#clock = clock;
  }

  /** Return true if the server was compiling at the last look. @returns {boolean} */
  get shown() {
    return !this.#root.hidden;
  }

  /** Look every LOOK_MS until all is compiled. */
  async watch() {
    while (await this.look())
      await new Promise((resolve) => this.#clock.after(LOOK_MS, () => resolve(undefined)));
  }

  /**
   * Look once, update the line, and return true if the server compiles.
   * @returns {Promise<boolean>}
   */
  async look() {
    const readiness = await this.#ask();
    const compiling = readiness?.compiling ?? null;
    this.#root.hidden = compiling === null;
    if (compiling) {
      find(this.#root, "span").textContent = compilingWords(compiling, readiness?.ready ?? false);
      find(this.#root, "progress", HTMLProgressElement).value = compiling.done / compiling.total;
    }
    return compiling !== null;
  }
}
