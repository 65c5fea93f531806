/** The frame loop: shows the view by a stream where there is one, else by single requests. */

import { Polling } from "./polling.js";
import { Streaming } from "./streaming.js";
import { CLOCK } from "./trouble.js";

/** @typedef {import("./polling.js").FrameOptions} FrameOptions */
/** @typedef {import("./schemas.js").Facts} Facts */
/** @typedef {import("./schemas.js").Frame} Frame */
/** @typedef {import("./schemas.js").FrameQuery} FrameQuery */
/** @typedef {import("../documents.js").CardChunk} CardChunk */
/** @typedef {import("./shown.js").Asked} Asked */

const SETTLE_MS = 200; // a view that has not changed for this long is at rest

/**
 * @typedef {{query: FrameQuery, chunks?: boolean, of: Asked}} View the parameters of a picture,
 *   whether to name the
 *   chunks that it reads, and the view that they are of
 * @typedef {{blob: Blob|null, facts: Facts|null, chunks?: CardChunk[], of: Asked}} Answer a
 *   picture, where it is a new
 *   one, the chunks that it reads, where they were asked for, and its view
 *
 * @typedef {object} Hooks what the loop calls
 * @property {(answer: Answer, draft: boolean) => Promise<void>} frame a picture came; `facts` are
 *   the latest also where
 *   the answer had none; it is settled once the picture is shown
 * @property {(error: Error) => void} trouble
 * @property {(moving: boolean) => void} moving whether the view goes on changing
 *
 * @typedef {object} Server
 * @property {() => WebSocket} open opens a socket
 * @property {(moving: boolean) => View} view as it is now, which goes over it
 * @property {(options: FrameOptions, signal: AbortSignal) => Promise<Frame & Pick<View, "of">>} ask
 *   sends one request
 * @property {() => boolean} [drafts] whether the view is drawn by the server while it moves
 * @property {() => Promise<unknown>} [probe] asks by HTTP if the server has the scene; throws what is
 *   wrong
 */

/** Shows a view that may change at any time. */
export class FrameLoop {
  /** @type {Streaming|Polling} */
  #transport;
  #hooks;
  #clock;
  #drafts;
  #moving = false;
  #timer = 0;

  /**
   * @param {Server} server
   * @param {Hooks} hooks
   * @param {import("./trouble.js").Clock} [clock]
   */
  constructor({ open, view, ask, drafts = () => true, probe }, hooks, clock = CLOCK) {
    this.#hooks = hooks;
    this.#clock = clock;
    this.#drafts = drafts;
    this.#transport = new Streaming(
      open,
      view,
      hooks,
      () => {
        this.#transport = new Polling(ask, hooks, clock);
        this.#show();
      },
      clock,
      probe,
    );
    document.addEventListener(
      "visibilitychange",
      () => document.hidden || this.#transport.resume(),
    );
    window.addEventListener("online", () => this.#transport.resume());
  }

  /** The view has changed, and may go on changing: show drafts until it rests. */
  change() {
    this.#moving = true;
    this.#hooks.moving(true);
    this.#clock.cancel(this.#timer);
    this.#timer = this.#clock.after(SETTLE_MS, () => this.settle());
    this.#show();
  }

  /** The page no longer draws what moves: the server is to. */
  redraw() {
    this.#show();
  }

  /** The view is as it was, but more is asked of its picture. */
  improve() {
    if (!this.#moving) this.#transport.show(false);
  }

  /** The view rests: ask for the full picture now. */
  settle() {
    this.#clock.cancel(this.#timer);
    this.#moving = false;
    this.#hooks.moving(false);
    this.#show();
  }

  /** Have the view drawn: one that moves by the page itself, where the server need not. */
  #show() {
    if (this.#moving && !this.#drafts()) this.#transport.pause();
    else this.#transport.show(this.#moving);
  }
}
