/**
 * The frame loop: shows the view through a stream if it can be had, otherwise by single requests.
 */

import { Polling } from "./polling.js";
import { Streaming } from "./streaming.js";
import { CLOCK } from "./trouble.js";

/** @typedef {import("./polling.js").FrameOptions} FrameOptions */
/** @typedef {import("./schemas.js").Facts} Facts */
/** @typedef {import("./schemas.js").Frame} Frame */
/** @typedef {import("./schemas.js").FrameQuery} FrameQuery */
/** @typedef {import("../documents.js").CardChunk} CardChunk */
/** @typedef {import("./shown.js").Asked} Asked */

const SETTLE_MS = 200; // time without a change after which a view is at rest

/**
 * @typedef {{query: FrameQuery, chunks?: boolean, of: Asked}} View the parameters of a picture;
 *   true in `chunks` to list the chunks that it reads; and the view that it shows
 * @typedef {{blob: Blob|null, facts: Facts|null, chunks?: CardChunk[], of: Asked}} Answer a
 *   picture, null if it has not changed; its facts; the chunks that it reads, if they were asked
 *   for; and the view that it shows
 *
 * @typedef {object} Hooks functions that the loop calls
 * @property {(answer: Answer, draft: boolean) => Promise<void>} frame is called for each answer;
 *   `facts` are the latest ones if the answer had none; the promise is fulfilled once the picture
 *   is shown
 * @property {(error: Error) => void} trouble is called if a request fails
 * @property {(moving: boolean) => void} moving is called when the view begins to change, or rests
 *
 * @typedef {object} Server
 * @property {() => WebSocket} open opens a socket
 * @property {(moving: boolean) => View} view returns the current view
 * @property {(options: FrameOptions, signal: AbortSignal) => Promise<Frame & Pick<View, "of">>} ask
 *   sends one request
 * @property {() => boolean} [drafts] returns true if the server draws the moving view
 * @property {() => Promise<unknown>} [probe] checks by HTTP that the server has the scene; throws
 *   the trouble
 */

/** Shows a view that may change at any time: drafts while it moves, full pictures at rest. */
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
    // Begin with a stream; if none can be had, continue with single requests.
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

  /** Note that the view has changed, and may go on changing: show drafts until it rests. */
  change() {
    this.#moving = true;
    this.#hooks.moving(true);
    this.#clock.cancel(this.#timer);
    this.#timer = this.#clock.after(SETTLE_MS, () => this.settle());
    this.#show();
  }

  /** Let the server draw the moving view, as the page no longer does. */
  redraw() {
    this.#show();
  }

  /** Request a better picture of the same view. */
  improve() {
    if (!this.#moving) this.#transport.show(false);
  }

  /** Note that the view rests, and request the full picture now. */
  settle() {
    this.#clock.cancel(this.#timer);
    this.#moving = false;
    this.#hooks.moving(false);
    this.#show();
  }

  /** Request a picture of the view, unless it moves and the page draws it. */
  #show() {
    if (this.#moving && !this.#drafts()) this.#transport.pause();
    else this.#transport.show(this.#moving);
  }
}
