/** What the picture's facts say, in words and as a bar; and the panel for when something is wrong. */

import { errorInWords, leftInWords, shareInWords } from "./units.js";

/**
 * Put a frame's facts into words: "182 of 240 chunks final, noise 1.8 %, about 40 s left".
 * @param {import("./api.js").Facts} facts
 * @returns {string}
 */
export function inWords({ provisional, coverage, error, chunks, timeLeft }) {
  const noise = error > 0 && error < 1 ? `noise ${errorInWords(error)}` : "";
  if (!provisional) return [seen(coverage) ? "final" : "final, no surface in view", noise].filter(Boolean).join(", ");
  const left = timeLeft ? leftInWords(timeLeft) : "";
  return [`${chunks.final} of ${chunks.needed} chunks final`, noise, left].filter(Boolean).join(", ");
}

/** Shows the facts of the frame on the stage. */
export class Status {
  #root;
  #told = "";

  /** @param {Document|HTMLElement} root holds `#stage`, `#badge`, `#progress`, `#status-line`, `#announce` */
  constructor(root) {
    this.#root = root;
  }

  /**
   * Show a frame's facts.
   * @param {import("./api.js").Facts} facts
   * @param {boolean} draft whether the view is still moving
   */
  show(facts, draft) {
    const state = draft ? "draft" : facts.provisional ? "provisional" : "final";
    this.#find("#stage").dataset.state = state;
    this.#find("#status-line").textContent = draft ? `moving · ${inWords(facts)}` : inWords(facts);
    this.#find("#badge").textContent = facts.provisional ? `provisional · ${shareInWords(facts.coverage.final)} final` : "";
    this.#fill(facts);
    if (!draft) this.#announce(facts);
  }

  /** No new frame came: what is shown belongs to an earlier view. */
  stale() {
    this.#find("#stage").dataset.state = "trouble";
    this.#find("#status-line").textContent = "not up to date · the picture is the last one received";
    this.#find("#badge").textContent = "";
  }

  #fill({ coverage, provisional }) {
    const bar = this.#find("#progress");
    const whole = provisional || seen(coverage) ? coverage : { final: 1, converging: 0, provisional: 0 };
    for (const part of bar.children) part.style.width = `${100 * whole[part.className]}%`;
    bar.setAttribute("aria-valuenow", Math.floor(100 * whole.final));
    bar.setAttribute("aria-valuetext", `${shareInWords(whole.final)} final`);
  }

  /** Tell screen readers at quarters and at the end, not at every frame. */
  #announce(facts) {
    const quarter = Math.floor(4 * facts.coverage.final) * 25;
    const news = facts.provisional ? `Picture provisional, ${quarter} percent final` : `Picture ${inWords(facts)}`;
    if (news !== this.#told) this.#find("#announce").textContent = news;
    this.#told = news;
  }

  #find(selector) {
    return this.#root.querySelector(selector);
  }
}

/** The panel that says what is wrong; "Try now" is offered where the page would ask again anyway. */
export class TroublePanel {
  #panel;

  /** What "Try now" does. */
  onRetry = () => {};

  /** @param {HTMLElement} panel */
  constructor(panel) {
    this.#panel = panel;
    panel.querySelector("button").addEventListener("click", () => this.onRetry());
  }

  /**
   * Show what is wrong.
   * @param {{title?: string, detail?: string, message: string, retry?: boolean}} error
   */
  show({ title = "The page has a problem", detail, message, retry = false }) {
    this.#write("h2", title);
    this.#write("p", detail ?? message);
    this.#panel.querySelector("button").hidden = !retry;
    this.#panel.hidden = false;
  }

  /** All is well again. */
  hide() {
    this.#panel.hidden = true;
  }

  /**
   * Wait for some time, or until the person presses "Try now".
   * @param {number} milliseconds
   */
  async patience(milliseconds) {
    await new Promise((resolve) => {
      this.onRetry = resolve;
      setTimeout(resolve, milliseconds);
    });
  }

  #write(selector, text) {
    const node = this.#panel.querySelector(selector);
    if (node.textContent !== text) node.textContent = text; // said once, not at every try
  }
}

function seen(coverage) {
  return coverage.final + coverage.converging + coverage.provisional > 0;
}
