/**
 * Pictures by single requests: one is in flight, the newest view replaces older ones, drafts are
 * requested while it moves, and better pictures at rest.
 */

import { CLOCK, Trouble, retryDelay } from "./trouble.js";

/** @typedef {import("./loop.js").Answer} Answer */
/** @typedef {import("./loop.js").View} View */
/** @typedef {import("./schemas.js").Facts} Facts */
/** @typedef {import("./schemas.js").Frame} Frame */
/** @typedef {import("./trouble.js").Clock} Clock */

/**
 * @typedef {object} FrameOptions
 * @property {boolean} draft
 * @property {number} scale scale of the picture's sides, 1 unless it is a draft
 * @property {number} waitMs time that the server may wait for new light, milliseconds
 * @property {string|null} etag tag of the picture that is shown
 */

/**
 * @typedef {object} PollingHooks
 * @property {(answer: Answer, draft: boolean) => unknown} frame is called for each answer; `facts`
 *   are the latest ones if the answer had none
 * @property {(error: Error) => void} trouble is called if a request fails
 */

const WAIT_MS = 400; // time that the server may wait for new light before it refines a picture
const DRAFT_SCALE = 0.35; // scale of the sides of drafts
const RETRY_MS = [500, 1000, 2000, 4000]; // waits after the first failure, the second, …

/** Time that the server may wait for new light when a final picture is awaited, milliseconds. */
const FINAL_WAIT_MS = 3000;

/** Pause after an answer that came without a wait, or after a failure, milliseconds. */
const PAUSE_MS = 500;

/** Answers in a row, unchanged and without a wait, after which no more light is coming. */
const MOST_UNCHANGED = 4;

/** Requests frames one after the other, if no stream can be had. */
export class Polling {
  #ask;
  #hooks;
  #clock;
  #moving = false;
  #changed = false;
  /** @type {{draft: boolean, controller: AbortController, began: number}|null} */
  #flight = null;
  /** @type {{etag: string|null, facts: Facts|null}|null} */
  #shown = null;
  #unchanged = 0;
  #failures = 0;
  #timer = 0;

  /**
   * @param {(options: FrameOptions, signal: AbortSignal) => Promise<Frame & Pick<View, "of">>} ask
   *   sends one request
   * @param {PollingHooks} hooks
   * @param {Clock} [clock]
   */
  constructor(ask, hooks, clock = CLOCK) {
    this.#ask = ask;
    this.#hooks = hooks;
    this.#clock = clock;
  }

  /**
   * Request pictures of the current view. While it moves, a draft in flight is awaited first.
   * @param {boolean} moving true if the view goes on changing
   */
  show(moving) {
    this.#moving = moving;
    this.#shown = null;
    this.#unchanged = 0;
    if (this.#flight?.draft && moving) this.#changed = true;
    else this.#send();
  }

  /** Request nothing until the next `show`: the view moves, and the page draws it. */
  pause() {
    this.#shown = null;
    this.stop();
  }

  /** Cancel the request in flight, and send no other. */
  stop() {
    this.#clock.cancel(this.#timer);
    this.#flight?.controller.abort();
    this.#flight = null;
  }

  /** Continue, as the page is visible again or has a network. */
  resume() {
    if (!this.#flight && this.#shown?.facts?.provisional !== false) this.#send();
  }

  /** Request a picture of the current view in place of the one in flight. */
  async #send() {
    this.stop();
    const flight = {
      draft: this.#moving,
      controller: new AbortController(),
      began: this.#clock.now(),
    };
    this.#flight = flight;
    this.#changed = false;
    // Wait for the answer; a newer request may abort this one meanwhile.
    const { frame, error } = await this.#ask(
      this.#options(flight.draft),
      flight.controller.signal,
    ).then(
      (answer) => ({ frame: answer, error: null }),
      (reason) => ({ frame: null, error: reason }),
    );
    if (flight !== this.#flight) return; // a newer request has replaced this one
    this.#flight = null;
    if (frame) this.#arrived(flight.draft, frame, this.#clock.now() - flight.began);
    else this.#failed(error);
  }

  /** Return the options of the next request. @param {boolean} draft @returns {FrameOptions} */
  #options(draft) {
    if (draft) return { draft, scale: DRAFT_SCALE, waitMs: 0, etag: null };
    return { draft, scale: 1, waitMs: this.#shown ? WAIT_MS : 0, etag: this.#shown?.etag ?? null };
  }

  /**
   * Show an answer, and schedule the next request.
   * @param {boolean} draft
   * @param {Frame & Pick<View, "of">} frame
   * @param {number} elapsed milliseconds that the request took
   */
  #arrived(draft, frame, elapsed) {
    this.#failures = 0;
    this.#unchanged = frame.blob ? 0 : this.#unchanged + 1;
    const facts = frame.facts ?? this.#shown?.facts ?? null;
    if (!draft) this.#shown = { etag: frame.etag, facts };
    this.#hooks.frame({ blob: frame.blob, facts, of: frame.of }, draft);
    // A draft of an older view is followed by one of the newest; a provisional picture by a better
    // one.
    if (draft && this.#changed) this.#send();
    if (!draft && facts?.provisional) this.#later(refinementPause(elapsed, this.#unchanged));
  }

  /** Report a failure, and repeat the request later if that can help. @param {Error} error */
  #failed(error) {
    const delay = retryDelay(error, this.#failures, RETRY_MS);
    this.#failures += 1;
    this.#hooks.trouble(error);
    if (delay !== null) this.#later(delay);
  }

  /** Send a request after some time, if the page is visible then. @param {number} milliseconds */
  #later(milliseconds) {
    this.#clock.cancel(this.#timer);
    this.#timer = this.#clock.after(milliseconds, () => document.hidden || this.#send());
  }
}

/**
 * Return the pause before a provisional picture is requested again, in milliseconds.
 *
 * Rendering competes with baking: pause as long as the frame took, and longer if nothing was new.
 *
 * @param {number} elapsed milliseconds that the request took, including its wait for light
 * @param {number} unchanged answers in a row without a new picture
 * @returns {number}
 */
export function refinementPause(elapsed, unchanged) {
  return Math.min(2000, Math.max(60, elapsed - WAIT_MS, 100 * unchanged));
}

/**
 * Yield pictures of one view, each better than the one before, until the final one, even if the
 * server is away meanwhile.
 *
 * End early if no more light is coming: the server then answers without a wait, and foresees no
 * time until the picture is final.
 *
 * @param {(waitMs: number, etag: string|null) => Promise<Frame>} ask sends one request
 * @param {AbortSignal} signal
 * @param {(trouble: Trouble) => void} onTrouble is called when the server is away, or busy
 * @param {Clock} [clock]
 * @returns {AsyncGenerator<{blob: Blob, facts: Facts}, void>}
 * @throws {Error} if repeating a request cannot help, or on abort
 */
export async function* untilFinal(ask, signal, onTrouble, clock = CLOCK) {
  /** @type {Facts|null} */
  let facts = null;
  /** @type {string|null} */
  let etag = null;
  let unchanged = 0;
  let waitMs = 0;
  while (facts?.provisional !== false && unchanged < MOST_UNCHANGED) {
    const began = clock.now();
    try {
      const frame = await ask(waitMs, etag);
      etag = frame.etag;
      facts = frame.facts ?? facts;
      if (frame.blob && facts) yield { blob: frame.blob, facts };
      // An answer before half of the wait was not held back for light.
      const held = clock.now() - began > waitMs / 2;
      unchanged = frame.blob || held || frame.facts?.timeLeft ? 0 : unchanged + 1;
      waitMs = FINAL_WAIT_MS;
      // Do not flood a server that answers without a wait.
      if (!frame.blob && !held) await pause(PAUSE_MS, signal, clock);
    } catch (error) {
      const delay = retryDelay(error, 0, [PAUSE_MS]);
      if (delay === null) throw error;
      onTrouble(/** @type {Trouble} */ (error));
      await pause(delay, signal, clock);
    }
  }
}

/**
 * Wait, unless the signal is aborted.
 * @param {number} milliseconds
 * @param {AbortSignal} signal
 * @param {Clock} clock
 * @returns {Promise<void>}
 * @throws the signal's reason
 */
function pause(milliseconds, signal, clock) {
  return new Promise((resolve, reject) => {
    const timer = clock.after(milliseconds, resolve);
    signal.addEventListener(
      "abort",
      () => {
        clock.cancel(timer);
        reject(signal.reason);
      },
      { once: true },
    );
  });
}
