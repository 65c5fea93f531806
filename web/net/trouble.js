/** What can be wrong with a request, and when to ask again. */

const NO_ANSWER = "The page keeps asking and continues by itself when the server is back.";

/**
 * @typedef {object} Clock
 * @property {() => number} now milliseconds
 * @property {(milliseconds: number, run: () => void) => number} after calls `run` later; gives what
 *   cancels it
 * @property {(timer: number) => void} cancel
 */

/** The browser's clock. @type {Clock} */
export const CLOCK = {
  now: () => performance.now(),
  after: (milliseconds, run) => setTimeout(run, milliseconds),
  cancel: (timer) => clearTimeout(timer),
};

/**
 * A problem that the server reports, or that it does not answer. `retry` is whether asking again
 * can help.
 */
export class Trouble extends Error {
  /**
   * @param {string} title what is wrong, in a few words
   * @param {string} detail one sentence for a person
   * @param {{status?: number, retry?: boolean, after?: number}} [facts] `after` in seconds
   */
  constructor(title, detail, { status = 0, retry = false, after = 0 } = {}) {
    super(detail);
    this.title = title;
    this.detail = detail;
    this.status = status;
    this.retry = retry;
    this.after = after;
  }
}

/** The trouble that there is no answer at all. @returns {Trouble} */
export function lost() {
  return new Trouble("The server does not answer", NO_ANSWER, { retry: true });
}

/**
 * The trouble that a problem document of the server reports.
 * @param {{status?: number, detail?: unknown}} problem
 * @param {number} [after] seconds after which to ask again
 * @returns {Trouble}
 */
export function troubleOf({ status = 0, detail }, after = 0) {
  const retry = status >= 500 || status === 429;
  const title = retry ? "The server cannot draw this now" : "This view cannot be drawn";
  return new Trouble(
    title,
    typeof detail === "string" ? detail : `It answered with status ${status}.`,
    { status, retry, after },
  );
}

/**
 * Milliseconds until the next try: those that the server asks for, else longer after each failure.
 * @param {unknown} error
 * @param {number} failures how many came before it
 * @param {number[]} waits milliseconds after the first failure, the second, and so on; the last is
 *   kept
 * @returns {number|null} null where asking again cannot help
 */
export function retryDelay(error, failures, waits) {
  if (!(error instanceof Trouble && error.retry)) return null;
  return error.after > 0 ? error.after * 1000 : waits[Math.min(failures, waits.length - 1)];
}
