/** The panel that saves the picture of the view, in full resolution and final. */

import { find } from "../dom.js";
import { errorInWords, frameInWords } from "../view/format.js";
import { samplesFor } from "../view/picture.js";
import { readFrame } from "./api.js";
import { withNotes } from "./png.js";
import { untilFinal } from "./polling.js";
import { Trouble } from "./trouble.js";

/** @typedef {import("./request.js").Description} Description */
/** @typedef {import("./schemas.js").Facts} Facts */
/** @typedef {import("./schemas.js").Scene} Scene */
/** @typedef {{controller: AbortController, size: string, link: string, file: string, alt: string}} Work one picture */

const WIDTHS = [1920, 3840];
const LONGEST_SIDE = 4096;
const LEAST_WIDTH = 1920; // what is offered first

/**
 * Sizes to choose from, all of the shape of the picture shown.
 * @param {{width: number, height: number}} shown
 * @returns {{width: number, height: number, name: string}[]} narrowest first
 */
export function sizesFor(shown) {
  /** @type {(width: number, name: string) => {width: number, height: number, name: string}} */
  const wide = (width, name) => ({ width, height: Math.round((shown.height * width) / shown.width), name });
  const all = [wide(shown.width, "as seen"), wide(2 * shown.width, "twice"), ...WIDTHS.map((width) => wide(width, ""))];
  return all.filter(({ width, height }) => Math.max(width, height) <= LONGEST_SIDE).sort((a, b) => a.width - b.width);
}

/** Asks for one picture at a time, beside those on the stage, and hands it to the browser as a file. */
export class Saver {
  #panel;
  #scene;
  #description;
  /** @type {Work|null} */
  #work = null;
  /** @type {{blob: Blob, facts: Facts}|null} */
  #best = null;

  /**
   * @param {HTMLElement} panel a popover that holds `#save-size`, `#save-progress`, a `.note` and three buttons
   * @param {Scene} scene
   * @param {Description} description of the view
   */
  constructor(panel, scene, description) {
    this.#panel = panel;
    this.#scene = scene;
    this.#description = description;
    panel.addEventListener("beforetoggle", ({ newState }) => newState === "open" && this.#offer());
    panel.addEventListener("keydown", ({ key }) => key === "Escape" && this.#close());
    find(panel, "#save-start").addEventListener("click", () => this.#start());
    find(panel, "#save-now").addEventListener("click", () => this.#finish());
    find(panel, "#save-close").addEventListener("click", () => this.#close());
  }

  #offer() {
    if (this.#work) return;
    const sizes = sizesFor(this.#description.query());
    const first = sizes.find(({ width }) => width >= LEAST_WIDTH) ?? sizes.at(-1);
    const options = sizes.map(({ width, height, name }) => {
      const text = [`${width} × ${height}`, name].filter(Boolean).join(", ");
      return new Option(text, `${width}×${height}`, false, width === first?.width);
    });
    find(this.#panel, "#save-size").replaceChildren(...options);
    this.#say("");
  }

  async #start() {
    const [width, height] = find(this.#panel, "#save-size", HTMLSelectElement).value.split("×").map(Number);
    const { link, query, file, alt } = this.#description;
    const controller = new AbortController();
    this.#begin({ controller, size: `${width} × ${height}`, link: link(), file: file(), alt: alt() });
    const wanted = { ...query(), antialias: samplesFor({ width, height }), width, height, f: "png" };
    await this.#refine(wanted, controller.signal);
  }

  /**
   * @param {import("./schemas.js").FrameQuery} query
   * @param {AbortSignal} signal
   * @returns {Promise<void>}
   */
  async #refine(query, signal) {
    /** @type {(waitMs: number, etag: string|null) => Promise<import("./schemas.js").Frame>} */
    const ask = (waitMs, etag) => readFrame(this.#scene.id, { ...query, wait_ms: waitMs }, { etag, signal });
    try {
      for await (const picture of untilFinal(ask, signal, ({ detail }) => this.#say(detail))) this.#came(picture);
      if (this.#best?.facts.provisional) this.#say(`No more light is coming: ${frameInWords(this.#best.facts)}.`);
      else await this.#finish();
    } catch (error) {
      const { antialias, ...plain } = query;
      if (antialias !== 1 && error instanceof Trouble && error.status === 422) return this.#refine({ ...plain, antialias: 1 }, signal);
      if (!signal.aborted) this.#end(/** @type {Error} */ (error).message);
    }
  }

  /** @param {Work} work */
  #begin(work) {
    this.#work = work;
    this.#best = null;
    this.#show({ busy: true });
    this.#say("Asking for the picture…");
  }

  /** @param {{blob: Blob, facts: Facts}} picture */
  #came(picture) {
    this.#best = picture;
    find(this.#panel, "#save-progress", HTMLProgressElement).value = picture.facts.coverage.final;
    find(this.#panel, "#save-now").hidden = false;
    this.#say(`${frameInWords(picture.facts)}.`);
  }

  /** Hand over the best picture that came. */
  async #finish() {
    if (!this.#best || !this.#work) return;
    const [{ blob, facts }, { link, file, alt, size }] = [this.#best, this.#work];
    const name = `${file}${facts.provisional ? "-preview" : ""}.png`;
    const state = [frameInWords(facts), size, this.#missed(facts)].filter(Boolean).join(", ");
    download(await withNotes(blob, { Title: latin(alt), Software: "isogi", Source: link, Comment: latin(state) }), name);
    this.#end(`Saved ${name}: ${state}.`);
  }

  /** @param {Facts} facts */
  #missed({ provisional, error }) {
    const { target_error: target } = this.#scene;
    return provisional || error > target ? `the target of ${errorInWords(target)} is not reached` : "";
  }

  /** @param {string} words */
  #end(words) {
    this.#work?.controller.abort();
    this.#work = null;
    this.#show({ busy: false });
    this.#say(words);
  }

  #close() {
    if (this.#work) this.#end("Stopped, nothing is saved.");
    else this.#panel.hidePopover();
  }

  /** @param {{busy: boolean}} state */
  #show({ busy }) {
    const progress = find(this.#panel, "#save-progress", HTMLProgressElement);
    find(this.#panel, "#save-size", HTMLSelectElement).disabled = busy;
    find(this.#panel, "#save-start", HTMLButtonElement).disabled = busy;
    progress.hidden = !busy;
    progress.value = 0;
    find(this.#panel, "#save-now").hidden = true;
    find(this.#panel, "#save-close").textContent = busy ? "Stop" : "Close";
  }

  /** @param {string} words */
  #say(words) {
    find(this.#panel, ".note").textContent = words;
  }
}

/** What PNG's notes can hold. @param {string} text */
function latin(text) {
  return text.replaceAll("\u2019", "'").replace(/[^\u0000-\u00ff]/g, "?");
}

/**
 * @param {Blob} blob
 * @param {string} name
 */
function download(blob, name) {
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}
