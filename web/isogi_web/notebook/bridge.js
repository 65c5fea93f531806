/**
 * The connection of a notebook's page to the server: requests go to the kernel as messages, and the
 * kernel sends the answers back.
 */

import { troubleOf } from "../net/trouble.js";

/** @typedef {import("../net/schemas.js").FrameQuery} FrameQuery */

/**
 * @typedef {object} Model model of a widget, as notebooks define it
 * @property {(name: string) => any} get
 * @property {(name: string, value: any) => void} set
 * @property {() => void} save_changes
 * @property {(message: object) => void} send
 * @property {(event: string, listener: (...given: any[]) => void) => void} on
 * @property {(event: string, listener: (...given: any[]) => void) => void} off
 *
 * @typedef {{number: number, status: number, detail: string}} Answer the kernel's answer to the
 *   request with this number
 */

/** Sends requests to the server through the kernel. */
export class Bridge {
  #model;
  #number = 0;
  /** @type {Map<number, {done: (bytes: ArrayBuffer) => void, failed: (error: Error) => void}>} */
  #waiting = new Map();

  /** @param {Model} model */
  constructor(model) {
    this.#model = model;
    model.on("msg:custom", this.#came);
  }

  /** Ignore further answers. */
  close() {
    this.#model.off("msg:custom", this.#came);
  }

  /**
   * Return the requests by which a graphics card draws the scene.
   * @returns {import("../live/live.js").Source}
   */
  get source() {
    return {
      document: async (query) => read(await this.#ask(`card?${textOf(query)}`)),
      bytes: (href) => this.#ask(href),
      chunks: async (query) => read(await this.#ask(`card/chunks?${textOf(query)}`)).chunks,
      blocks: (what, chunks, query) =>
        this.#ask(`card/${what}/${chunks.join(",")}?${textOf(query)}`),
    };
  }

  /** Read a shader's file. @param {string} name @returns {Promise<string>} */
  async readShader(name) {
    return new TextDecoder().decode(await this.#ask(`web/card/shaders/${name}`));
  }

  /**
   * Request the bytes at an address below the scene's, or of a file of the page.
   * @param {string} path
   * @returns {Promise<ArrayBuffer>}
   * @throws {import("../net/trouble.js").Trouble} if the server reports a problem
   */
  #ask(path) {
    const number = ++this.#number;
    return new Promise((done, failed) => {
      this.#waiting.set(number, { done, failed });
      this.#model.send({ number, path });
    });
  }

  /**
   * Settle the request that an answer belongs to.
   * @param {Answer} answer
   * @param {DataView[]} buffers
   */
  #came = ({ number, status, detail }, buffers) => {
    const waiting = this.#waiting.get(number);
    if (!waiting) return; // the request of another page with this widget
    this.#waiting.delete(number);
    if (!buffers.length) waiting.failed(troubleOf({ status, detail }));
    else waiting.done(bytesOf(buffers[0]));
  };
}

/** Copy the bytes of a view. @param {DataView} view @returns {ArrayBuffer} */
function bytesOf({ buffer, byteOffset, byteLength }) {
  return /** @type {ArrayBuffer} */ (buffer.slice(byteOffset, byteOffset + byteLength));
}

/** Read JSON. @param {ArrayBuffer} bytes @returns {any} */
function read(bytes) {
  return JSON.parse(new TextDecoder().decode(bytes));
}

/** Write parameters as the query of an address. @param {FrameQuery} query @returns {string} */
function textOf(query) {
  return new URLSearchParams(
    Object.entries(query).map(([name, value]) => [name, String(value)]),
  ).toString();
}
