/**
 * The panel that saves the final picture of the view, in the resolution that the visitor chooses.
 */

import { find } from "../dom.js";
import { errorInWords, frameInWords, leftAfter } from "../view/format.js";
import { readFrame } from "./api.js";
import { withNotes } from "./bytes.js";
import { untilFinal } from "./polling.js";
import { Sheet, stripsOf, whole, worstOf } from "./strips.js";

/** @typedef {import("./request.js").Description} Description */
/** @typedef {import("./schemas.js").Facts} Facts */
/** @typedef {import("./schemas.js").Scene} Scene */
/** @typedef {{blob: Blob, facts: Facts}} Picture */
/**
 * @typedef {object} Work one picture
 * @property {AbortController} controller stops it
 * @property {AbortController} hurry ends it with the best picture that is there
 * @property {import("./strips.js").Stamp|null} stamp shapes that are drawn over it, at a corner
 * @property {Picture|null} ready the picture, if it is on the stage and final
 * @property {string} size
 * @property {string} link
 * @property {string} file
 * @property {string} alt
 * @property {string} empty the words for a picture that shows no surface
 */

const WIDTHS = [1920, 3840, 7680]; // widths that are offered, pixels
const LONGEST_SIDE = 8192; // pixels that the server draws at most along a side
const SECOND_MS = 1000;

/**
 * Return the sizes to choose from, all with the proportions of the picture shown.
 * @param {{width: number, height: number}} shown
 * @param {boolean} [ready] true if that picture is final, so that it can be saved without a request
 * @returns {{width: number, height: number, name: string}[]} the size of the picture shown first,
 *   then others by their width
 */
export function sizesFor(shown, ready = false) {
  /** @type {(width: number, name: string) => {width: number, height: number, name: string}} */
  const wide = (width, name) => ({
    width,
    height: Math.round((shown.height * width) / shown.width),
    name,
  });
  const others = [wide(2 * shown.width, "twice"), ...WIDTHS.map((width) => wide(width, ""))]
    .filter(({ width, height }) => Math.max(width, height) <= LONGEST_SIDE)
    .filter(({ width }) => width !== shown.width)
    .sort((a, b) => a.width - b.width);
  return [wide(shown.width, ready ? "as seen, at once" : "as seen"), ...others];
}

/**
 * Requests one picture at a time, independently of those on the stage, and hands it to the browser
 * as a file.
 */
export class Saver {
  #panel;
  #scene;
  #description;
  /** @type {Work|null} */
  #work = null;

  /**
   * @param {HTMLElement} panel a popover that holds `#save-size`, `#save-progress`, a `.note` and
   *   three buttons
   * @param {Scene} scene
   * @param {Description} description of the view
   */
  constructor(panel, scene, description) {
    this.#panel = panel;
    this.#scene = scene;
    this.#description = description;
    panel.addEventListener("beforetoggle", ({ newState }) => newState === "open" && this.#offer());
    document.addEventListener("keydown", ({ key }) => key === "Escape" && this.#hide());
    find(panel, "#save-start").addEventListener("click", () => this.#start());
    find(panel, "#save-now").addEventListener("click", () => this.#work?.hurry.abort());
    find(panel, "#save-close").addEventListener("click", () => this.#close());
  }

  /** List the sizes when the panel opens. */
  #offer() {
    if (this.#work) return;
    const ready = this.#description.ready();
    const sizes = sizesFor(ready ?? this.#description.query(), ready !== null);
    const options = sizes.map(({ width, height, name }) => {
      const text = [`${width} × ${height}`, name].filter(Boolean).join(", ");
      return new Option(text, `${width}×${height}`);
    });
    find(this.#panel, "#save-size").replaceChildren(...options);
    // Offer the legend only if the picture has one.
    const box = this.#box("legend");
    const coloured = this.#description.legend({ width: 1, height: 1 }) !== null;
    /** @type {HTMLElement} */ (box.parentElement).hidden = !coloured;
    box.checked &&= coloured;
    this.#say("");
  }

  /**
   * Return the check box of something that may be drawn over the picture.
   * @param {"rulers"|"legend"} name
   */
  #box(name) {
    return find(this.#panel, `#save-${name}`, HTMLInputElement);
  }

  /** Begin to save the view as it is now. */
  async #start() {
    const [width, height] = find(this.#panel, "#save-size", HTMLSelectElement)
      .value.split("×")
      .map(Number);
    const { link, query, ready, file, alt, empty, rulers, legend } = this.#description;
    // Keep the view of this moment: it may change while the picture is made.
    const over = [
      ...(this.#box("rulers").checked ? [rulers] : []),
      ...(this.#box("legend").checked ? [legend] : []),
    ];
    const stamp = over.length ? stampOf(over, { width, height }) : null;
    const controller = new AbortController();
    const hurry = new AbortController();
    const work = {
      controller,
      hurry,
      stamp,
      ready: readyAt(ready(), { width, height }),
      size: `${width} × ${height}`,
      link: link(),
      file: file(),
      alt: alt(),
      empty: empty(),
    };
    this.#begin(work);
    try {
      await this.#make({ ...query(), width, height, f: "png" }, { width, height }, work);
    } catch (error) {
      if (!controller.signal.aborted) this.#end(/** @type {Error} */ (error).message);
    }
  }

  /**
   * Request a picture, strip by strip, join the strips, and save it.
   * @param {import("./schemas.js").FrameQuery} query
   * @param {{width: number, height: number}} size
   * @param {Work} work
   */
  async #make(query, size, work) {
    const strips = work.ready ? [whole(size)] : stripsOf(size);
    // A picture in one piece without a stamp is saved as the server encoded it.
    if (strips.length === 1 && !work.stamp)
      return this.#finish(await this.#refine(query, work, 0, 1), work);
    /** @type {Facts[]} */
    const known = [];
    const sheet = new Sheet(size);
    for (const [n, strip] of strips.entries()) {
      const part = strips.length > 1 ? { ...query, strip: strip.rows.join(",") } : query;
      const { blob, facts } = await this.#refine(part, work, n, strips.length);
      await sheet.add(blob, strip);
      known.push(facts);
    }
    this.#say("Putting the picture together…");
    if (work.stamp) sheet.stamp(work.stamp, query.background === "light");
    await this.#finish({ blob: await sheet.file(), facts: worstOf(known) }, work);
  }

  /**
   * Return the best picture of strip `n`: the final one, unless the visitor is in a hurry.
   * @param {import("./schemas.js").FrameQuery} query
   * @param {Work} work
   * @param {number} n
   * @param {number} strips number of strips
   * @returns {Promise<Picture>}
   */
  async #refine(query, { controller: { signal }, hurry, ready, empty }, n, strips) {
    if (ready) return ready;
    const about = { target: this.#scene.target_error, empty };
    /** @type {Picture|null} */
    let best = null;
    const stop = new AbortController();
    const over = AbortSignal.any([signal, stop.signal]);

    // Words about the part, and the request for it.
    const part = strips > 1 ? `Part ${n + 1} of ${strips}: ` : "";
    /** @type {(waitMs: number, etag: string|null) => Promise<import("./schemas.js").Frame>} */
    const ask = (waitMs, etag) =>
      readFrame(this.#scene.id, { ...query, wait_ms: waitMs }, { etag, signal: over });

    // Race the final picture against a visitor in a hurry, who takes the best one so far.
    const hurried = new Promise((resolve) =>
      hurry.signal.addEventListener("abort", () => best && resolve(best)),
    );
    let since = 0; // time at which the best picture came
    let away = false; // true if the server is away
    const tell = () => {
      if (!best || away) return;
      const timeLeft = leftAfter(best.facts.timeLeft, (performance.now() - since) / 1000);
      this.#say(`${part}${frameInWords({ ...best.facts, timeLeft }, about)}.`);
    };
    const troubled = (/** @type {{detail: string}} */ { detail }) => {
      away = true;
      this.#say(detail);
    };
    const timer = setInterval(tell, SECOND_MS);
    const refined = async () => {
      for await (const picture of untilFinal(ask, over, troubled)) {
        best = picture;
        since = performance.now();
        away = false;
        find(this.#panel, "#save-progress", HTMLProgressElement).value =
          (n + (1 - picture.facts.coverage.provisional) / 2) / strips;
        find(this.#panel, "#save-now").hidden = hurry.signal.aborted;
        tell();
        if (hurry.signal.aborted) break;
      }
      return best;
    };
    return Promise.race([hurried, refined()]).finally(() => {
      clearInterval(timer);
      stop.abort();
    });
  }

  /** Show that a picture is being made. @param {Work} work */
  #begin(work) {
    this.#work = work;
    this.#show({ busy: true });
    this.#say("Asking for the picture…");
  }

  /**
   * Save a picture with notes about it, and say so.
   * @param {Picture} picture
   * @param {Work} work
   */
  async #finish({ blob, facts }, { link, file, alt, size, hurry, empty }) {
    const name = `${file}${facts.provisional ? "-preview" : ""}.png`;
    const ended = facts.provisional && !hurry.signal.aborted ? "no more light is coming" : "";
    const state = [frameInWords(facts, { empty }), size, this.#missed(facts), ended]
      .filter(Boolean)
      .join(", ");
    download(
      await withNotes(blob, {
        Title: latin(alt),
        Software: "isogi",
        Source: link,
        Comment: latin(state),
      }),
      name,
    );
    this.#end(`Saved ${name}: ${state}.`);
  }

  /** Return words if a picture has not reached its target, otherwise "". @param {Facts} facts */
  #missed({ provisional, error }) {
    const { target_error: target } = this.#scene;
    return provisional || error > target
      ? `the target of ${errorInWords(target)} is not reached`
      : "";
  }

  /** Stop the work, and show some words. @param {string} words */
  #end(words) {
    this.#work?.controller.abort();
    this.#work = null;
    this.#show({ busy: false });
    this.#say(words);
  }

  /** Hide the panel unless another popover is to be hidden first; saving continues. */
  #hide() {
    const open = [...document.querySelectorAll(":popover-open")];
    if (open.length === 1 && open[0] === this.#panel) this.#panel.hidePopover();
  }

  /** Stop the work, or close the panel. */
  #close() {
    if (this.#work) this.#end("Stopped, nothing is saved.");
    else this.#panel.hidePopover();
  }

  /** Show or hide the parts of the panel that belong to work. @param {{busy: boolean}} state */
  #show({ busy }) {
    const progress = find(this.#panel, "#save-progress", HTMLProgressElement);
    find(this.#panel, "#save-size", HTMLSelectElement).disabled = busy;
    find(this.#panel, "#save-start", HTMLButtonElement).disabled = busy;
    progress.hidden = !busy;
    progress.value = 0;
    find(this.#panel, "#save-now").hidden = true;
    find(this.#panel, "#save-close").textContent = busy ? "Stop" : "Close";
  }

  /** Show some words. @param {string} words */
  #say(words) {
    find(this.#panel, ".note").textContent = words;
  }
}

/**
 * Return the picture on the stage if it is final and of this size.
 * @param {ReturnType<Description["ready"]>} ready
 * @param {{width: number, height: number}} size
 * @returns {Picture|null}
 */
function readyAt(ready, { width, height }) {
  return ready && ready.width === width && ready.height === height ? ready : null;
}

/** Width of pictures up to which a stamp is drawn in their pixels; in wider ones it grows. */
const STAMPED_WIDTH = 960;

/**
 * Return scale bar, axes and legend for a picture of some size.
 * @param {(Description["rulers"]|Description["legend"])[]} wanted functions that return the shapes
 *   that the visitor wants
 * @param {{width: number, height: number}} size pixels
 * @returns {import("./strips.js").Stamp}
 */
function stampOf(wanted, { width, height }) {
  const scale = Math.max(1, width / STAMPED_WIDTH);
  const all = wanted
    .map((shapes) => shapes({ width: width / scale, height: height / scale }))
    .filter((shapes) => shapes !== null);
  const areas = all.flatMap((shapes) => shapes.areas ?? []);
  return {
    shapes: {
      lines: all.flatMap(({ lines }) => lines),
      words: all.flatMap(({ words }) => words),
      areas,
    },
    scale,
  };
}

/** Replace characters that PNG's notes cannot hold. @param {string} text */
function latin(text) {
  return text.replaceAll("\u2019", "'").replace(/[^\u0000-\u00ff]/g, "?");
}

/**
 * Hand a file to the browser.
 * @param {Blob} blob
 * @param {string} name
 */
export function download(blob, name) {
  const link = Object.assign(document.createElement("a"), {
    href: URL.createObjectURL(blob),
    download: name,
  });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}
