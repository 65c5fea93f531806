/** The way by requests: one in flight, the newest view wins, drafts while moving, refinement at rest. */

const WAIT_MS = 400; // how long the server may hold a refinement back for new light
const DRAFT_SCALES = [0.25, 0.35, 0.5, 0.7, 1]; // few sizes, so that the server can keep its G-buffer
const [DRAFT_QUICK_MS, DRAFT_SLOW_MS] = [45, 130]; // a draft within these keeps its size
const RETRY_MS = [500, 1000, 2000, 4000];

/** Asks for a frame again and again; for where no stream can be had. */
export class Polling {
  #ask;
  #hooks;
  #moving = false;
  #changed = false;
  #flight = null;
  #shown = null;
  #rung = 2;
  #quiet = 0;
  #failures = 0;
  #nextTimer = 0;

  /**
   * @param {(wish: {draft: boolean, scale: number, waitMs: number, etag: string|null}, signal: AbortSignal)
   *   => Promise<{blob: Blob|null, etag: string|null, facts: object|null}>} ask sends one request
   * @param {{frame: Function, trouble: Function, busy: Function}} hooks `frame({blob, facts}, draft)` with the
   *   latest facts also where the answer had none, `trouble(error)`, `busy(boolean)`
   */
  constructor(ask, hooks) {
    this.#ask = ask;
    this.#hooks = hooks;
  }

  /** The view is now another one; show it. @param {boolean} moving whether it goes on changing */
  show(moving) {
    this.#moving = moving;
    this.#shown = null;
    this.#quiet = 0;
    if (this.#flight?.draft && moving) this.#changed = true;
    else this.#send();
  }

  /** What was asked for is wanted no more. */
  stop() {
    clearTimeout(this.#nextTimer);
    this.#flight?.controller.abort();
    this.#flight = null;
  }

  /** The page is seen again, or has a network: ask on. */
  resume() {
    if (!this.#flight && this.#shown?.facts?.provisional !== false) this.#send();
  }

  async #send() {
    clearTimeout(this.#nextTimer);
    this.#flight?.controller.abort();
    const flight = { draft: this.#moving, controller: new AbortController(), began: performance.now() };
    this.#flight = flight;
    this.#changed = false;
    this.#hooks.busy(true);
    const outcome = await this.#attempt(flight);
    if (flight !== this.#flight) return; // a newer request took over
    this.#flight = null;
    this.#hooks.busy(false);
    if (outcome.error) this.#failed(outcome.error);
    else this.#arrived(flight, outcome.frame, performance.now() - flight.began);
  }

  async #attempt(flight) {
    const refining = !flight.draft && this.#shown !== null;
    const wish = {
      draft: flight.draft, scale: flight.draft ? DRAFT_SCALES[this.#rung] : 1,
      waitMs: refining ? WAIT_MS : 0, etag: refining ? this.#shown.etag : null,
    };
    try {
      return { frame: await this.#ask(wish, flight.controller.signal) };
    } catch (error) {
      return { error };
    }
  }

  #arrived(flight, frame, elapsed) {
    this.#failures = 0;
    this.#quiet = frame.blob ? 0 : this.#quiet + 1;
    const facts = frame.facts ?? this.#shown?.facts ?? null;
    if (!flight.draft) this.#shown = { etag: frame.etag, facts };
    this.#hooks.frame({ blob: frame.blob, facts }, flight.draft);
    if (flight.draft) this.#afterDraft(elapsed);
    else this.#afterFull(elapsed);
  }

  #afterDraft(elapsed) {
    const rung = this.#rung + (elapsed < DRAFT_QUICK_MS) - (elapsed > DRAFT_SLOW_MS);
    this.#rung = Math.min(DRAFT_SCALES.length - 1, Math.max(0, rung));
    if (this.#changed) this.#send();
  }

  #afterFull(elapsed) {
    if (!this.#shown.facts?.provisional) return;
    // Rendering competes with baking: pause as long as the frame itself took, longer when nothing is new.
    this.#later(Math.min(2000, Math.max(60, elapsed - WAIT_MS, 100 * this.#quiet)));
  }

  #failed(error) {
    const wait = error.after > 0 ? error.after * 1000 : RETRY_MS[Math.min(this.#failures, RETRY_MS.length - 1)];
    this.#failures += 1;
    this.#hooks.trouble(error);
    if (error.retry) this.#later(wait);
  }

  #later(milliseconds) {
    clearTimeout(this.#nextTimer);
    this.#nextTimer = setTimeout(() => document.hidden || this.#send(), milliseconds);
  }
}
