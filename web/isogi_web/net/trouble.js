/** Troubles that a request can meet, and the time of the next try. */

const NO_ANSWER = "The page keeps asking and continues by itself when the server is back.";

/**
 * @typedef {object} Clock
 * @property {() => number} now current time, milliseconds
 * @property {(milliseconds: number, run: () => void) => number} after calls `run` later; returns
 *   the timer
 * @property {(timer: number) => void} cancel stops a timer
 */

/** The browser's clock. @type {Clock} */
export const CLOCK = {
  now: () => performance.now(),
  after: (milliseconds, run) => setTimeout(run, milliseconds),
  cancel: (timer) => clearTimeout(timer),
};

/**
 * A problem that the server reports, or the lack of an answer. `retry` is true if another request
 * may succeed.
 */
export class Trouble extends Error {
  /**
   * @param {string} title what is wrong, in a few words
   * @param {string} detail one sentence for a person
   * @param {{status?: number, retry?: boolean, after?: number}} [facts] `status` of HTTP, 0 without
   *   an answer; `after` in seconds
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

/** Return the trouble that the server does not answer. @returns {Trouble} */
export function lost() {
  return new Trouble("The server does not answer", NO_ANSWER, { retry: true });
}

/**
 * Return the trouble that a problem document of the server reports.
 * @param {{status?: number, detail?: unknown}} problem
 * @param {number} [after] seconds after which to try again
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
 * Return the milliseconds until the next try: those that the server asks for, otherwise longer
 * after each failure.
 * @param {unknown} error
 * @param {number} failures failures before this one
 * @param {number[]} waits milliseconds after the first failure, the second, and so on; the last one
 *   repeats
 * @returns {number|null} null if another try cannot help
 */
export function retryDelay(error, failures, waits) {
  if (!(error instanceof Trouble && error.retry)) return null;
  return error.after > 0 ? error.after * 1000 : waits[Math.min(failures, waits.length - 1)];
}
