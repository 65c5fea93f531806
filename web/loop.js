/** The frame loop: tells one of two ways what is to be shown, a stream where there is one, else single requests. */

import { Polling } from "./polling.js";
import { Streaming } from "./streaming.js";

const SETTLE_MS = 200; // a view that has not changed for this long is at rest

/**
 * @typedef {object} Hooks what a way tells
 * @property {(frame: {blob: Blob|null, facts: object|null}, draft: boolean) => Promise<void>} frame a picture came;
 *   `facts` are the latest also where the answer had none; it is settled once the picture is shown
 * @property {(error: Error) => void} trouble
 * @property {(moving: boolean) => void} moving whether the view goes on changing
 * @property {(busy: boolean) => void} busy whether the newest view waits for its first picture
 */

/** Shows a view that may change at any time. */
export class FrameLoop {
  #way;
  #hooks;
  #moving = false;
  #settleTimer = 0;

  /**
   * @param {{open: Function, view: Function, ask: Function}} server `open()` opens a socket and `view()` tells the
   *   parameters that go over it, `ask(wish, signal)` sends one request; see `Streaming` and `Polling`
   * @param {Hooks} hooks
   */
  constructor({ open, view, ask }, hooks) {
    this.#hooks = hooks;
    this.#way = new Streaming(open, view, hooks, () => {
      this.#way = new Polling(ask, hooks);
      this.#way.show(this.#moving);
    });
    document.addEventListener("visibilitychange", () => document.hidden || this.#way.resume());
    window.addEventListener("online", () => this.#way.resume());
  }

  /** The view has changed, and may go on changing: show drafts until it rests. */
  change() {
    this.#moving = true;
    this.#hooks.moving(true);
    clearTimeout(this.#settleTimer);
    this.#settleTimer = setTimeout(() => this.settle(), SETTLE_MS);
    this.#way.show(true);
  }

  /** The view rests: ask for the full picture now. */
  settle() {
    clearTimeout(this.#settleTimer);
    this.#moving = false;
    this.#hooks.moving(false);
    this.#way.show(false);
  }
}
