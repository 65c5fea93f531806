/** The way by stream: views go out as they change, and pictures come in as they are drawn. */

import { lost, pictureOf, troubleOf } from "./api.js";

const RETRY_MS = [300, 600, 1200, 2400, 4000];
const LONGEST_MS = 60_000; // longer than this a receipt may not tell
const IDLE = 4000; // the code that a stream is closed with when nothing was said for long

/** Keeps one socket open, and opens it anew when it is lost. */
export class Streaming {
  #open;
  #view;
  #hooks;
  #refused;
  #socket = null;
  #known = false;
  #moving = false;
  #drawing = 0;
  #timer = 0;
  #failures = 0;
  #sent = 0;
  #facts = null;

  /**
   * @param {() => WebSocket} open
   * @param {() => object} view the parameters of the full picture as they are now
   * @param {import("./loop.js").Hooks} hooks
   * @param {() => void} refused is called when no stream can be had from the start
   */
  constructor(open, view, hooks, refused) {
    this.#open = open;
    this.#view = view;
    this.#hooks = hooks;
    this.#refused = refused;
  }

  /** The view is now another one; show it. @param {boolean} moving whether it goes on changing */
  show(moving) {
    this.#moving = moving;
    this.#hooks.busy(true);
    cancelAnimationFrame(this.#drawing);
    if (moving) this.#drawing = requestAnimationFrame(() => this.#send()); // no more often than the screen changes
    else this.#send();
  }

  /** The page is seen again, or has a network: try at once, if there is no stream. */
  resume() {
    if (!this.#socket && this.#failures) this.#send();
  }

  #send() {
    clearTimeout(this.#timer);
    if (!this.#socket) this.#connect();
    else if (this.#socket.readyState === WebSocket.OPEN) {
      this.#sent += 1;
      this.#socket.send(JSON.stringify({ id: this.#sent, view: this.#view(), moving: this.#moving }));
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
      this.#send();
    };
    this.#socket.onmessage = ({ data }) => (typeof data === "string" ? this.#told(JSON.parse(data)) : this.#came(data));
    this.#socket.onclose = ({ code }) => this.#closed(code);
  }

  #told(message) {
    this.#facts = message;
    if (message.problem) this.#failed(troubleOf(message.problem));
  }

  async #came(data) {
    const [socket, facts, came] = [this.#socket, this.#facts, performance.now()];
    this.#failures = 0;
    const shown = this.#hooks.frame(pictureOf(facts, data), facts.draft);
    if (facts.id === this.#sent) this.#hooks.busy(false);
    await shown;
    if (socket.readyState !== WebSocket.OPEN) return;
    socket.send(JSON.stringify({ shown: facts.id, took: Math.min(performance.now() - came, LONGEST_MS) }));
  }

  #closed(code) {
    this.#socket = null;
    if (!this.#known) this.#refused();
    else if (code !== IDLE) this.#failed(lost());
  }

  /** Say what is wrong, and try again where that can help. @param {import("./api.js").Trouble} error */
  #failed(error) {
    const wait = error.after > 0 ? error.after * 1000 : RETRY_MS[Math.min(this.#failures, RETRY_MS.length - 1)];
    this.#failures += 1;
    this.#hooks.busy(false);
    this.#hooks.trouble(error);
    clearTimeout(this.#timer);
    if (error.retry) this.#timer = setTimeout(() => this.#send(), wait);
  }
}
