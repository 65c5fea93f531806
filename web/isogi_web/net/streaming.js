/** Pictures by a stream: views are sent as they change, and pictures arrive as they are drawn. */

import { streamedFrame } from "./schemas.js";
import { CLOCK, lost, retryDelay, troubleOf } from "./trouble.js";

/** @typedef {import("./loop.js").Hooks} Hooks */
/** @typedef {import("./loop.js").View} View */
/** @typedef {import("./schemas.js").StreamMessage} StreamMessage */
/** @typedef {import("./trouble.js").Clock} Clock */
/** @typedef {import("./trouble.js").Trouble} Trouble */

const RETRY_MS = [300, 600, 1200, 2400, 4000]; // waits after the first failure, the second, …
const LONGEST_MS = 60_000; // longest time that a receipt may report
const IDLE = 4000; // close code of a stream that was idle for long
const LATER = 1013; // close code if another client needs the place
const OPEN = 1; // `WebSocket.OPEN`
const SILENT = 2; // handshakes that fail in a row before the server is asked for the reason by HTTP

/** Keeps one socket open, and opens it again when it is lost. */
export class Streaming {
  #open;
  #view;
  #hooks;
  #refused;
  #clock;
  #probe;
  /** @type {WebSocket|null} */
  #socket = null;
  #known = false; // true once a socket has opened
  #moving = false;
  #paused = false;
  #drawing = 0;
  #timer = 0;
  #failures = 0;
  #handshakes = 0; // handshakes that failed in a row
  #answers = false; // true if the server has answered by HTTP since
  #sent = 0; // id of the last view
  /** @type {Map<number, View["of"]>} views that were sent, by their ids */
  #asked = new Map();
  /** @type {StreamMessage|null} */
  #message = null;

  /**
   * @param {() => WebSocket} open
   * @param {(moving: boolean) => View} view returns the current view
   * @param {Hooks} hooks
   * @param {() => void} refused is called if no stream can be had
   * @param {Clock} [clock]
   * @param {(() => Promise<unknown>)|null} [probe] checks by HTTP that the server has the scene;
   *   throws the trouble
   */
  constructor(open, view, hooks, refused, clock = CLOCK, probe = null) {
    this.#open = open;
    this.#view = view;
    this.#hooks = hooks;
    this.#refused = refused;
    this.#clock = clock;
    this.#probe = probe;
  }

  /** Send the current view. @param {boolean} moving true if the view goes on changing */
  show(moving) {
    this.#moving = moving;
    this.#paused = false;
    cancelAnimationFrame(this.#drawing);
    if (moving)
      // Send no more often than the screen changes.
      this.#drawing = requestAnimationFrame(() => this.#send());
    else this.#send();
  }

  /**
   * Tell the server to draw nothing until the next `show`: the view moves, and the page draws it.
   */
  pause() {
    if (this.#paused) return;
    this.#paused = true;
    this.#moving = true;
    cancelAnimationFrame(this.#drawing);
    if (this.#socket) this.#send();
  }

  /** Try to connect again without waiting, as the page is visible again or has a network. */
  resume() {
    if (!this.#socket && this.#failures) this.#send();
  }

  /** Send the current view, or connect first. */
  #send() {
    this.#clock.cancel(this.#timer);
    if (!this.#socket) this.#connect();
    else if (this.#socket.readyState === OPEN) {
      const { query, chunks, of } = this.#view(this.#moving);
      this.#asked.set(++this.#sent, of);
      // Send optional fields only if they are set.
      const wishes = { ...(chunks && { chunks }), ...(this.#paused && { pictures: false }) };
      this.#socket.send(
        JSON.stringify({ id: this.#sent, view: query, moving: this.#moving, ...wishes }),
      );
    }
  }

  /** Open a socket, and follow its life. */
  #connect() {
    try {
      this.#socket = this.#open();
    } catch {
      this.#refused(); // the browser, or a policy, allows no sockets
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
    // The count is reset when the socket opens: if it is unchanged at the end, the handshake
    // failed.
    const before = ++this.#handshakes;
    this.#socket.onclose = ({ code, reason }) =>
      this.#known && this.#handshakes === before
        ? this.#unanswered()
        : this.#closed(code, reason);
  }

  /**
   * Keep the message that precedes a picture, or report its problem if it concerns the newest view.
   * @param {StreamMessage} message about the next picture, or with a problem in place of one
   */
  #announced(message) {
    this.#message = message;
    if (message.problem && (message.id ?? this.#sent) === this.#sent)
      this.#failed(troubleOf(message.problem));
  }

  /**
   * Show a picture, and send a receipt with the time that this took, by which the server paces
   * itself.
   * @param {Blob} data
   */
  async #came(data) {
    const socket = this.#socket;
    const message = this.#message;
    const came = this.#clock.now();
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

  /**
   * Return the view that was sent with an id, and forget older ones, which are no longer answered.
   * @param {number} id
   */
  #askedBy(id) {
    for (const each of this.#asked.keys()) if (each < id) this.#asked.delete(each);
    return /** @type {View["of"]} */ (this.#asked.get(id));
  }

  /**
   * Handle the end of a stream: connect again, unless it was idle or never opened.
   * @param {number} code
   * @param {string} reason
   */
  #closed(code, reason) {
    this.#socket = null;
    if (!this.#known) this.#refused();
    else if (code === LATER) this.#failed(troubleOf({ status: 429, detail: reason }));
    else if (code !== IDLE) this.#failed(lost());
  }

  /**
   * Handle a failed handshake. Browsers do not report the reason, so that the server is asked by
   * HTTP after a few.
   */
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
    if (this.#socket) return; // another socket was opened meanwhile
    if (error) this.#failed(error);
    else this.#welcome();
  }

  /**
   * Handle a server that answers by HTTP after failed handshakes: it is back, or something blocks
   * streams. Try once more, then give up the stream.
   */
  #welcome() {
    if (this.#answers) {
      this.#refused();
      return;
    }
    this.#answers = true;
    this.#send();
  }

  /** Report trouble, and try again later if that can help. @param {Trouble} error */
  #failed(error) {
    const delay = retryDelay(error, this.#failures, RETRY_MS);
    this.#failures += 1;
    this.#hooks.trouble(error);
    this.#clock.cancel(this.#timer);
    if (delay !== null) this.#timer = this.#clock.after(delay, () => this.#send());
  }
}
