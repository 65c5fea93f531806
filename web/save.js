/** The panel that saves the picture of the view, in full resolution and final. */

import { withNotes } from "./png.js";
import { inWords } from "./status.js";
import { errorInWords } from "./units.js";
import { untilFinal } from "./waiting.js";

const WIDTHS = [1920, 3840];
const LONGEST_SIDE = 4096;
const LEAST_WIDTH = 1920; // what is offered first

/**
 * Sizes to choose from, all of the shape of the picture shown.
 * @param {{width: number, height: number}} shown
 * @returns {{width: number, height: number, name: string}[]} narrowest first
 */
export function sizesFor(shown) {
  const wide = (width, name) => ({ width, height: Math.round((shown.height * width) / shown.width), name });
  const all = [wide(shown.width, "as seen"), wide(2 * shown.width, "twice"), ...WIDTHS.map((width) => wide(width, ""))];
  return all.filter(({ width, height }) => Math.max(width, height) <= LONGEST_SIDE).sort((a, b) => a.width - b.width);
}

/** Asks for one picture at a time, beside those on the stage, and hands it to the browser as a file. */
export class Saver {
  #panel;
  #scene;
  #told;
  #work = null;
  #best = null;

  /**
   * @param {HTMLElement} panel a popover that holds `#save-size`, `#save-progress`, a `.note` and three buttons
   * @param {object} scene answer of `readScene`
   * @param {{link: () => string, query: () => Record<string, string|number>, file: () => string, alt: () => string}} told
   *   the address of the page with the view in it, the parameters of the picture shown, the name of its file without
   *   an ending, and what it shows
   */
  constructor(panel, scene, told) {
    this.#panel = panel;
    this.#scene = scene;
    this.#told = told;
    panel.addEventListener("beforetoggle", ({ newState }) => newState === "open" && this.#offer());
    panel.addEventListener("keydown", ({ key }) => key === "Escape" && this.#close());
    this.#on("#save-start", () => this.#start());
    this.#on("#save-now", () => this.#finish());
    this.#on("#save-close", () => this.#close());
  }

  #offer() {
    if (this.#work) return;
    const sizes = sizesFor(this.#told.query());
    const first = sizes.find(({ width }) => width >= LEAST_WIDTH) ?? sizes.at(-1);
    const options = sizes.map(({ width, height, name }) => {
      const text = [`${width} × ${height}`, name].filter(Boolean).join(", ");
      return new Option(text, `${width}×${height}`, false, width === first.width);
    });
    this.#find("#save-size").replaceChildren(...options);
    this.#say("");
  }

  async #start() {
    const [width, height] = this.#find("#save-size").value.split("×").map(Number);
    const { link, query, file, alt } = this.#told;
    const work = { controller: new AbortController(), size: `${width} × ${height}`, link: link(), file: file(), alt: alt() };
    const { signal } = work.controller;
    this.#begin(work);
    try {
      const pictures = untilFinal(this.#scene.id, { ...query(), width, height, f: "png" }, signal, ({ detail }) => this.#say(detail));
      for await (const picture of pictures) this.#came(picture);
      if (this.#best.facts.provisional) this.#say(`No more light is coming: ${inWords(this.#best.facts)}.`);
      else await this.#finish();
    } catch (error) {
      if (signal.aborted) return;
      this.#end(error.detail ?? error.message);
    }
  }

  #begin(work) {
    this.#work = work;
    this.#best = null;
    this.#show({ busy: true });
    this.#say("Asking for the picture…");
  }

  #came(picture) {
    this.#best = picture;
    this.#find("#save-progress").value = picture.facts.coverage.final;
    this.#find("#save-now").hidden = false;
    this.#say(`${inWords(picture.facts)}.`);
  }

  /** Hand over the best picture that came. */
  async #finish() {
    const [{ blob, facts }, { link, file, alt, size }] = [this.#best, this.#work];
    const name = `${file}${facts.provisional ? "-provisional" : ""}.png`;
    const state = [size, inWords(facts), this.#missed(facts)].filter(Boolean).join(", ");
    download(await withNotes(blob, { Title: latin(alt), Software: "isogi", Source: link, Comment: latin(state) }), name);
    this.#end(`Saved ${name}: ${state}.`);
  }

  #missed({ provisional, error }) {
    const { target_error: target } = this.#scene;
    return provisional || error > target ? `the target of ${errorInWords(target)} is not reached` : "";
  }

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

  #show({ busy }) {
    this.#find("#save-size").disabled = this.#find("#save-start").disabled = busy;
    this.#find("#save-progress").hidden = !busy;
    this.#find("#save-progress").value = 0;
    this.#find("#save-now").hidden = true;
    this.#find("#save-close").textContent = busy ? "Stop" : "Close";
  }

  #say(words) {
    this.#find(".note").textContent = words;
  }

  #on(button, listener) {
    this.#find(button).addEventListener("click", listener);
  }

  #find(selector) {
    return this.#panel.querySelector(selector);
  }
}

/** What PNG's notes can hold. */
function latin(text) {
  return text.replaceAll("\u2019", "'").replace(/[^\u0000-\u00ff]/g, "?");
}

function download(blob, name) {
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}
