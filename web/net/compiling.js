/** How far kernels are compiled, at the first start on a machine: a line over the picture. */

import { find } from "../dom.js";
import { CLOCK } from "./trouble.js";

const LOOK_MS = 500;

/** @typedef {import("./api.js").Readiness} Readiness */
/** @typedef {NonNullable<Readiness["compiling"]>} Progress */

/**
 * What a person reads of a compilation at the start of a server.
 * @param {Progress} compiling
 * @param {boolean} drawn whether pictures are drawn already, without light
 * @returns {string}
 */
export function compilingWords(compiling, drawn) {
  return progressWords(drawn ? "Light comes when isogi is compiled" : "Compiling", compiling);
}

/**
 * What is compiled, and how far that is.
 * @param {string} what
 * @param {Progress} compiling
 * @returns {string}
 */
export function progressWords(what, { done, total, seconds }) {
  const left = seconds === undefined ? "" : `, about ${timeLeft(seconds)} left`;
  return `${what}, once on this machine: ${done} of ${total}${left}`;
}

/** @param {number} seconds */
function timeLeft(seconds) {
  return seconds < 90 ? `${Math.max(Math.round(seconds), 1)} s` : `${Math.round(seconds / 60)} min`;
}

/** Shows the line while there is something to compile. */
export class CompilingLine {
  #root;
  #ask;
  #clock;

  /**
   * @param {HTMLElement} root
   * @param {() => Promise<Readiness|null>} ask how ready the server is; null where it does not
   *   answer
   * @param {import("./trouble.js").Clock} [clock]
   */
  constructor(root, ask, clock = CLOCK) {
    this.#root = root;
    this.#ask = ask;
    this.#clock = clock;
  }

  /** Whether the server compiled when it was last looked at. */
  get shown() {
    return !this.#root.hidden;
  }

  /** Look again and again until all is compiled. */
  async watch() {
    while (await this.look())
      await new Promise((resolve) => this.#clock.after(LOOK_MS, () => resolve(undefined)));
  }

  /** Look once: whether the server compiles. @returns {Promise<boolean>} */
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
