/** Pictures by a stream: views go out as they change, and pictures come in as they are drawn. */

import { streamedFrame } from "./schemas.js";
import { CLOCK, lost, retryDelay, troubleOf } from "./trouble.js";

/** @typedef {import("./loop.js").Hooks} Hooks */
/** @typedef {import("./loop.js").View} View */
/** @typedef {import("./schemas.js").StreamMessage} StreamMessage */
/** @typedef {import("./trouble.js").Clock} Clock */
/** @typedef {import("./trouble.js").Trouble} Trouble */

const RETRY_MS = [300, 600, 1200, 2400, 4000];
const LONGEST_MS = 60_000; // longer than this a receipt may not report
const IDLE = 4000; // the code that a stream is closed with when nothing was said for long
const LATER = 1013; // the one when another client needs its place
const OPEN = 1; // `WebSocket.OPEN`
const SILENT = 2; // handshakes in a row that fail, before the server is asked why by HTTP

/** Keeps one socket open, and opens it anew when it is lost. */
export class Streaming {
  #open;
  #view;
  #hooks;
  #refused;
  #clock;
  #probe;
  /** @type {WebSocket|null} */
  #socket = null;
  #known = false;
  #moving = false;
  #paused = false;
  #drawing = 0;
  #timer = 0;
  #failures = 0;
  #handshakes = 0; // that failed in a row
  #answers = false; // whether the server has answered by HTTP since
  #sent = 0;
  /** @type {Map<number, View["of"]>} views that were sent, by their ids */
  #asked = new Map();
  /** @type {StreamMessage|null} */
  #message = null;

  /**
   * @param {() => WebSocket} open
   * @param {(moving: boolean) => View} view as it is now
   * @param {Hooks} hooks
   * @param {() => void} refused is called when no stream can be had
   * @param {Clock} [clock]
   * @param {(() => Promise<unknown>)|null} [probe] asks by HTTP if the server has the scene; throws what
   *   is wrong
   */
  constructor(open, view, hooks, refused, clock = CLOCK, probe = null) {
    this.#open = open;
    this.#view = view;
    this.#hooks = hooks;
    this.#refused = refused;
    this.#clock = clock;
    this.#probe = probe;
  }

  /** The view is now another one; show it. @param {boolean} moving whether it goes on changing */
  show(moving) {
    this.#moving = moving;
    this.#paused = false;
    cancelAnimationFrame(this.#drawing);
    if (moving)
      // no more often than the screen changes
      this.#drawing = requestAnimationFrame(() => this.#send());
    else this.#send();
  }

  /**
   * The view moves, and the page draws it by itself: the server is to draw none until the next is
   * shown.
   */
  pause() {
    if (this.#paused) return;
    this.#paused = true;
    this.#moving = true;
    cancelAnimationFrame(this.#drawing);
    if (this.#socket) this.#send();
  }

  /** The page is seen again, or has a network: try at once, if there is no stream. */
  resume() {
    if (!this.#socket && this.#failures) this.#send();
  }

  #send() {
    this.#clock.cancel(this.#timer);
    if (!this.#socket) this.#connect();
    else if (this.#socket.readyState === OPEN) {
      const { query, chunks, of } = this.#view(this.#moving);
      this.#asked.set(++this.#sent, of);
      const wishes = { ...(chunks && { chunks }), ...(this.#paused && { pictures: false }) };
      this.#socket.send(
        JSON.stringify({ id: this.#sent, view: query, moving: this.#moving, ...wishes }),
      );
    }
  }

  #connect() {
    try {
      this.#socket = this.#open();
    } catch {
      this.#refused(); // a browser, or a policy, without sockets
      return;
    }
    this.#socket.binaryType = "blob";
    this.#socket.onopen = () => {
      this.#known = true;
      this.#handshakes = 0;
      this.#answers = false;
      this.#send();
    };
    this.#socket.onmessage = ({ data }) =>
      typeof data === "string" ? this.#announced(JSON.parse(data)) : this.#came(data);
    const before = ++this.#handshakes; // until it opens
    this.#socket.onclose = ({ code, reason }) =>
      this.#known && this.#handshakes === before
        ? this.#unanswered()
        : this.#closed(code, reason);
  }

  /**
   * @param {StreamMessage} message about the picture that comes next, or a problem in place of one
   */
  #announced(message) {
    this.#message = message;
    if (message.problem && (message.id ?? this.#sent) === this.#sent)
      this.#failed(troubleOf(message.problem));
  }

  /** @param {Blob} data */
  async #came(data) {
    const [socket, message, came] = [this.#socket, this.#message, this.#clock.now()];
    if (!socket || !message) return;
    this.#failures = 0;
    await this.#hooks.frame(
      { ...streamedFrame(message, data), of: this.#askedBy(message.id) },
      message.draft,
    );
    if (socket.readyState !== OPEN) return;
    socket.send(
      JSON.stringify({ shown: message.id, took: Math.min(this.#clock.now() - came, LONGEST_MS) }),
    );
  }

  /** The view that was sent with an id; those before it are answered no more. @param {number} id */
  #askedBy(id) {
    for (const each of this.#asked.keys()) if (each < id) this.#asked.delete(each);
    return /** @type {View["of"]} */ (this.#asked.get(id));
  }

  /** @param {number} code @param {string} reason */
  #closed(code, reason) {
    this.#socket = null;
    if (!this.#known) this.#refused();
    else if (code === LATER) this.#failed(troubleOf({ status: 429, detail: reason }));
    else if (code !== IDLE) this.#failed(lost());
  }

  /** A handshake failed, and browsers do not say why: the server does by HTTP. */
  async #unanswered() {
    this.#socket = null;
    if (!this.#probe || this.#handshakes < SILENT) {
      this.#failed(lost());
      return;
    }
    const error = await this.#probe().then(
      () => null,
      (reason) => reason,
    );
    if (this.#socket) return; // another one is on its way
    if (error) this.#failed(error);
    else this.#welcome();
  }

  /** The server answers by HTTP: it is back, or lets no stream through. */
  #welcome() {
    if (this.#answers) {
      this.#refused();
      return;
    }
    this.#answers = true;
    this.#send();
  }

  /** Say what is wrong, and try again where that can help. @param {Trouble} error */
  #failed(error) {
    const delay = retryDelay(error, this.#failures, RETRY_MS);
    this.#failures += 1;
    this.#hooks.trouble(error);
    this.#clock.cancel(this.#timer);
    if (delay !== null) this.#timer = this.#clock.after(delay, () => this.#send());
  }
}
