/** The state of the picture in words and as a bar; and the panel for when something is wrong. */

import { find } from "../dom.js";
import { STATES } from "../net/schemas.js";
import { PREVIEW, errorInWords, frameInWords, shareInWords, showsSurface } from "../view/format.js";

/** @typedef {import("../net/schemas.js").Facts} Facts */

/** Shows the facts of the frame on the stage. */
export class Status {
  #root;
  #target;
  #announced = "";

  /**
   * @param {ParentNode} root holds `#stage`, `#badge`, `#progress`, `#status-line`, `#announce`
   * @param {number} target relative error at which a picture is good enough to go without a badge
   */
  constructor(root, target) {
    this.#root = root;
    this.#target = target;
  }

  /**
   * Show a frame's facts.
   * @param {Facts} facts
   * @param {boolean} draft whether the view is still moving
   */
  show(facts, draft) {
    this.#write({
      state: draft ? "draft" : facts.provisional ? "provisional" : "final",
      line: draft ? "Preview" : frameInWords(facts),
      badge: badge(facts, this.#target),
    });
    this.#fill(facts);
    if (!draft) this.#announce(announcement(facts));
  }

  /** No new frame came: what is shown belongs to an earlier view. */
  stale() {
    this.#write({ state: "trouble", line: "Not up to date: the picture is the last one received", badge: "" });
  }

  /** @param {{state: string, line: string, badge: string}} texts */
  #write({ state, line, badge }) {
    find(this.#root, "#stage").dataset.state = state;
    find(this.#root, "#status-line").textContent = line;
    find(this.#root, "#badge").textContent = badge;
  }

  /** @param {Facts} facts */
  #fill({ coverage, provisional }) {
    const bar = find(this.#root, "#progress");
    const whole = provisional || showsSurface(coverage) ? coverage : { final: 1, converging: 0, provisional: 0 };
    for (const state of STATES) find(bar, `.${state}`).style.width = `${100 * whole[state]}%`;
    bar.setAttribute("aria-valuenow", String(Math.floor(100 * whole.final)));
    bar.setAttribute("aria-valuetext", `${shareInWords(whole.final)} done`);
  }

  /** @param {string} text */
  #announce(text) {
    if (text !== this.#announced) find(this.#root, "#announce").textContent = text;
    this.#announced = text;
  }
}

/**
 * What stands on a picture that is not within its target: it counts down to that.
 * @param {Pick<Facts, "provisional"|"error">} facts
 * @param {number} target relative error
 * @returns {string}
 */
export function badge({ provisional, error }, target) {
  if (!provisional || error <= target) return "";
  return error < PREVIEW ? `Refining · ${errorInWords(error)} error` : "Preview";
}

/**
 * What screen readers say: it changes at quarters and at the end, not at every frame.
 * @param {Facts} facts
 * @returns {string}
 */
export function announcement(facts) {
  const quarter = Math.floor(4 * facts.coverage.final) * 25;
  return facts.provisional ? `Refining, ${quarter} percent done` : frameInWords(facts);
}

const READ_MS = 10_000; // a sentence is read long before

/** A sentence over the picture, which goes by itself. */
export class Notice {
  #node;
  #timer = 0;

  /** @param {HTMLElement} node */
  constructor(node) {
    this.#node = node;
    this.say = this.say.bind(this);
  }

  /** Say something; nothing takes back what was said. @param {string} words */
  say(words) {
    clearTimeout(this.#timer);
    this.#node.textContent = words;
    if (words) this.#timer = setTimeout(() => this.say(""), READ_MS);
  }
}

/** The panel that says what is wrong; "Try now" is offered where the page would ask again anyway. */
export class TroublePanel {
  #panel;

  /** What "Try now" does. @type {() => void} */
  onRetry = () => {};

  /** @param {HTMLElement} panel */
  constructor(panel) {
    this.#panel = panel;
    find(panel, "button").addEventListener("click", () => this.onRetry());
  }

  /**
   * Show what is wrong.
   * @param {Error & {title?: string, retry?: boolean}} error
   */
  show({ title = "The page has a problem", message, retry = false }) {
    this.#write("h2", title);
    this.#write("p", message);
    find(this.#panel, "button").hidden = !retry;
    this.#panel.hidden = false;
  }

  /** All is well again. */
  hide() {
    this.#panel.hidden = true;
  }

  /**
   * Wait for some time, or until the person presses "Try now".
   * @param {number} milliseconds
   * @returns {Promise<void>}
   */
  patience(milliseconds) {
    return new Promise((resolve) => {
      this.onRetry = resolve;
      setTimeout(resolve, milliseconds);
    });
  }

  /**
   * @param {string} selector
   * @param {string} text
   */
  #write(selector, text) {
    const node = find(this.#panel, selector);
    if (node.textContent !== text) node.textContent = text; // said once, not at every try
  }
}
