/**
 * The way from a notebook's page to the server: requests go to the kernel as messages, which hands
 * the answers back.
 */

import { troubleOf } from "../net/trouble.js";

/** @typedef {import("../net/schemas.js").FrameQuery} FrameQuery */

/**
 * @typedef {object} Model of a widget, as notebooks have it
 * @property {(name: string) => any} get
 * @property {(name: string, value: any) => void} set
 * @property {() => void} save_changes
 * @property {(message: object) => void} send
 * @property {(event: string, listener: (...given: any[]) => void) => void} on
 * @property {(event: string, listener: (...given: any[]) => void) => void} off
 *
 * @typedef {{number: number, status: number, detail: string}} Answer of the kernel, to the request
 *   of that number
 */

/** Asks the server by way of the kernel. */
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

  /** Take no more answers. */
  close() {
    this.#model.off("msg:custom", this.#came);
  }

  /** What a graphics card draws the scene from. @returns {import("../live/live.js").Source} */
  get source() {
    return {
      document: async (query) => read(await this.#ask(`card?${textOf(query)}`)),
      bytes: (href) => this.#ask(href),
      chunks: async (query) => read(await this.#ask(`card/chunks?${textOf(query)}`)).chunks,
      blocks: (what, chunks, query) =>
        this.#ask(`card/${what}/${chunks.join(",")}?${textOf(query)}`),
    };
  }

  /** Text of a shader's file. @param {string} name @returns {Promise<string>} */
  async readShader(name) {
    return new TextDecoder().decode(await this.#ask(`web/card/shaders/${name}`));
  }

  /**
   * Bytes at an address of the card's, below the scene's, or of a file of the page.
   * @param {string} path
   * @returns {Promise<ArrayBuffer>}
   * @throws {import("../net/trouble.js").Trouble} what the server reports
   */
  #ask(path) {
    const number = ++this.#number;
    return new Promise((done, failed) => {
      this.#waiting.set(number, { done, failed });
      this.#model.send({ number, path });
    });
  }

  /** @param {Answer} answer @param {DataView[]} buffers */
  #came = ({ number, status, detail }, buffers) => {
    const waiting = this.#waiting.get(number);
    if (!waiting) return; // another page with this widget has asked
    this.#waiting.delete(number);
    if (!buffers.length) waiting.failed(troubleOf({ status, detail }));
    else waiting.done(bytesOf(buffers[0]));
  };
}

/** @param {DataView} view @returns {ArrayBuffer} */
function bytesOf({ buffer, byteOffset, byteLength }) {
  return /** @type {ArrayBuffer} */ (buffer.slice(byteOffset, byteOffset + byteLength));
}

/** @param {ArrayBuffer} bytes @returns {any} */
function read(bytes) {
  return JSON.parse(new TextDecoder().decode(bytes));
}

/** @param {FrameQuery} query @returns {string} */
function textOf(query) {
  return new URLSearchParams(
    Object.entries(query).map(([name, value]) => [name, String(value)]),
  ).toString();
}
