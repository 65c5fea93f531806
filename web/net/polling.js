/**
 * Pictures by single requests: one in flight, the newest view wins, drafts while moving, refinement
 * at rest.
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
 * @property {number} scale of the picture's sides, 1 unless it is a draft
 * @property {number} waitMs how long the server may hold the picture back for new light
 * @property {string|null} etag of the picture that is shown
 */

/**
 * @typedef {object} PollingHooks
 * @property {(answer: Answer, draft: boolean) => unknown} frame a picture came; `facts` are the
 *   latest also where the
 *   answer had none
 * @property {(error: Error) => void} trouble
 */

const WAIT_MS = 400; // how long the server may hold a refinement back for new light
const DRAFT_SCALE = 0.35; // of the sides of a picture that moves
const RETRY_MS = [500, 1000, 2000, 4000];

// how long the server may hold back the next picture on the way to the final one
const FINAL_WAIT_MS = 3000;
// between two requests where the server has nothing to wait for, or does not answer
const PAUSE_MS = 500;
// answers in a row without anything new, and without a wait, after which no light is coming
const MOST_UNCHANGED = 4;

/** Asks for a frame again and again; for where no stream can be had. */
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

  /** The view is now another one; show it. @param {boolean} moving whether it goes on changing */
  show(moving) {
    this.#moving = moving;
    this.#shown = null;
    this.#unchanged = 0;
    if (this.#flight?.draft && moving) this.#changed = true;
    else this.#send();
  }

  /** The view moves, and the page draws it by itself: ask for none until the next is shown. */
  pause() {
    this.#shown = null;
    this.stop();
  }

  /** Give up the request in flight, and send no other. */
  stop() {
    this.#clock.cancel(this.#timer);
    this.#flight?.controller.abort();
    this.#flight = null;
  }

  /** The page is seen again, or has a network: ask on. */
  resume() {
    if (!this.#flight && this.#shown?.facts?.provisional !== false) this.#send();
  }

  async #send() {
    this.stop();
    const flight = {
      draft: this.#moving,
      controller: new AbortController(),
      began: this.#clock.now(),
    };
    this.#flight = flight;
    this.#changed = false;
    const { frame, error } = await this.#ask(
      this.#options(flight.draft),
      flight.controller.signal,
    ).then(
      (answer) => ({ frame: answer, error: null }),
      (reason) => ({ frame: null, error: reason }),
    );
    if (flight !== this.#flight) return; // a newer request took over
    this.#flight = null;
    if (frame) this.#arrived(flight.draft, frame, this.#clock.now() - flight.began);
    else this.#failed(error);
  }

  /** @param {boolean} draft @returns {FrameOptions} */
  #options(draft) {
    if (draft) return { draft, scale: DRAFT_SCALE, waitMs: 0, etag: null };
    return { draft, scale: 1, waitMs: this.#shown ? WAIT_MS : 0, etag: this.#shown?.etag ?? null };
  }

  /**
   * @param {boolean} draft
   * @param {Frame & Pick<View, "of">} frame
   * @param {number} elapsed milliseconds
   */
  #arrived(draft, frame, elapsed) {
    this.#failures = 0;
    this.#unchanged = frame.blob ? 0 : this.#unchanged + 1;
    const facts = frame.facts ?? this.#shown?.facts ?? null;
    if (!draft) this.#shown = { etag: frame.etag, facts };
    this.#hooks.frame({ blob: frame.blob, facts, of: frame.of }, draft);
    if (draft && this.#changed) this.#send();
    if (!draft && facts?.provisional) this.#later(refinementPause(elapsed, this.#unchanged));
  }

  /** @param {Error} error */
  #failed(error) {
    const delay = retryDelay(error, this.#failures, RETRY_MS);
    this.#failures += 1;
    this.#hooks.trouble(error);
    if (delay !== null) this.#later(delay);
  }

  /** @param {number} milliseconds */
  #later(milliseconds) {
    this.#clock.cancel(this.#timer);
    this.#timer = this.#clock.after(milliseconds, () => document.hidden || this.#send());
  }
}

/**
 * Milliseconds until a provisional picture is asked for again. Rendering competes with baking:
 * pause as long as the
 * frame itself took, longer when nothing is new.
 * @param {number} elapsed milliseconds that the request took, its wait for light included
 * @param {number} unchanged answers in a row without a new picture
 * @returns {number}
 */
export function refinementPause(elapsed, unchanged) {
  return Math.min(2000, Math.max(60, elapsed - WAIT_MS, 100 * unchanged));
}

/**
 * Pictures of one view, each better than the one before, however long that takes and through losses
 * of the server; the
 * last is final, unless no more light is coming: the server then waits for none, and foresees no
 * time until it is final.
 * @param {(waitMs: number, etag: string|null) => Promise<Frame>} ask sends one request
 * @param {AbortSignal} signal
 * @param {(trouble: Trouble) => void} onTrouble called when the server is away, or busy
 * @param {Clock} [clock]
 * @returns {AsyncGenerator<{blob: Blob, facts: Facts}, void>}
 */
export async function* untilFinal(ask, signal, onTrouble, clock = CLOCK) {
  /** @type {{etag: string|null, facts: Facts|null}} */
  let { etag, facts } = { etag: null, facts: null };
  let [unchanged, waitMs] = [0, 0];
  while (facts?.provisional !== false && unchanged < MOST_UNCHANGED) {
    const began = clock.now();
    try {
      const frame = await ask(waitMs, etag);
      ({ etag, facts } = { etag: frame.etag, facts: frame.facts ?? facts });
      if (frame.blob && facts) yield { blob: frame.blob, facts };
      const held = clock.now() - began > waitMs / 2;
      unchanged = frame.blob || held || frame.facts?.timeLeft ? 0 : unchanged + 1;
      waitMs = FINAL_WAIT_MS;
      // a server that answers at once is not asked at once again
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
 * @param {number} milliseconds
 * @param {AbortSignal} signal
 * @param {Clock} clock
 * @returns {Promise<void>}
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
