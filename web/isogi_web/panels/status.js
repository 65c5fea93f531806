/** The state of the picture in words and as a bar; short notices; and the panel for trouble. */

import { find } from "../dom.js";
import { STATES } from "../net/schemas.js";
import { CLOCK } from "../net/trouble.js";
import { PREVIEW, errorInWords, frameInWords, shareInWords, showsSurface } from "../view/format.js";

/** @typedef {import("../net/schemas.js").Facts} Facts */
/** @typedef {import("../net/shown.js").Shown} Shown */
/** @typedef {import("../net/shown.js").State} State */
/** @typedef {import("../net/trouble.js").Clock} Clock */
/** @typedef {import("../view/model.js").Knobs} Knobs */

const ALMOST = 0.99; // share that the bar shows at most before the picture is final
const OLD_MS = 300; // time after which a picture that the controls have left is dimmed
const LATE_MS = 600; // time after which the page says that a picture is still to come
const LAST = ": the picture is the last one received";

/**
 * Words for states without facts of a picture.
 * @type {Partial<Record<State, {badge: string, line: string}>>}
 */
const WORDS = {
  loading: { badge: "", line: "Loading the scene…" },
  trouble: { badge: "", line: "Not up to date: the picture is the last one received" },
  away: { badge: "", line: "The server is away" },
  moving: { badge: "Moving", line: "Moving" },
  updating: { badge: "Updating", line: "Updating: the picture of this view is on its way" },
};

/** Describes the picture on the stage, as long as the controls ask for this picture. */
export class Status {
  #root;
  #target;
  #emptyOf;
  #clock;
  #old;
  #late;
  #bar = { since: -1, done: 0 }; // share that the bar has shown of the current view

  /**
   * @param {ParentNode} root holds `#stage`, `#badge`, `#progress`, `#status-line`, `#announce`
   * @param {number} target relative error from which a picture has no badge
   * @param {(values: Knobs) => string} emptyOf returns the words for a view that shows no surface
   * @param {Clock} [clock]
   */
  constructor(root, target, emptyOf, clock = CLOCK) {
    this.#root = root;
    this.#target = target;
    this.#emptyOf = emptyOf;
    this.#clock = clock;
    const stage = find(root, "#stage");
    this.#old = markedFrom(stage, "data-old", clock);
    // An animation costs frames of the screen: begin it only when a picture is late.
    this.#late = markedFrom(stage, "data-late", clock);
  }

  /** Show the state of the picture. @param {Shown} shown */
  show(shown) {
    const { state, sharp, leftAt, waitsSince } = shown;
    const facts = shown.facts && { ...shown.facts, timeLeft: shown.left };
    const stage = find(this.#root, "#stage");
    const about = { target: this.#target, empty: this.#emptyOf(shown.values) };
    // Words that follow from the state alone, or else from the facts of the picture.
    const { badge, line } = WORDS[state] ?? wordsOf(/** @type {Facts} */ (facts), sharp, about);
    const more = state === "away" && facts ? LAST : drawnInWords(shown, state);
    stage.dataset.state = state;
    stage.toggleAttribute("data-busy", waitsSince < Infinity);
    this.#write("#status-line", line + more);
    this.#write("#badge", badge);
    const isKnown = facts && state !== "away";
    this.#write("#announce", isKnown ? announcement(facts, sharp, about) : "");
    this.#fill(facts, shown.asked.since);
    this.#old(leftAt + OLD_MS);
    this.#late(waitsSince + LATE_MS);
  }

  /** Write a text if it has changed. @param {string} selector @param {string} text */
  #write(selector, text) {
    const node = find(this.#root, selector);
    if (node.textContent !== text) node.textContent = text; // screen readers would repeat it
  }

  /**
   * Fill the bar. It never runs back while the controls rest.
   * @param {Facts|null} facts
   * @param {number} since time at which they came to this view, milliseconds
   */
  #fill(facts, since) {
    const done = facts ? doneOf(facts, (this.#clock.now() - since) / 1000) : 0;
    const before = since === this.#bar.since ? this.#bar.done : 0;
    // A view may lack light again: the bar of a picture that is not final is never full.
    const most = facts?.provisional === false ? 1 : ALMOST;
    this.#bar = { since, done: Math.min(Math.max(done, before), most) };
    const bar = find(this.#root, "#progress");
    const shares = facts && sharesOf(facts, this.#bar.done);
    for (const state of STATES)
      find(bar, `.${state}`).style.width = `${shares ? 100 * shares[state] : 0}%`;
    bar.ariaValueNow = shares && String(Math.floor(100 * shares.final));
    bar.ariaValueText = shares ? `${shareInWords(shares.final)} done` : "not known yet";
  }
}

/**
 * Return the share of the time to the final picture that has passed; 1 if the picture is final.
 * @param {Pick<Facts, "provisional"|"timeLeft">} facts
 * @param {number} seconds since the view was asked for
 * @returns {number} from 0 to 1
 */
export function doneOf({ provisional, timeLeft }, seconds) {
  if (!provisional) return 1;
  return timeLeft ? Math.min(seconds / Math.max(seconds + timeLeft.likely, 1e-3), ALMOST) : 0;
}

/**
 * Return the parts of the bar: the share that is done, and of the rest the shares with and without
 * light.
 * @param {Facts} facts
 * @param {number} done
 */
function sharesOf(facts, done) {
  // Of a picture without a surface, all has light.
  const lit = showsSurface(facts) ? 1 - facts.coverage.provisional : 1;
  return { final: done, converging: (1 - done) * lit, provisional: (1 - done) * (1 - lit) };
}

/**
 * Return a function that sets an attribute at a time, which may lie in the future.
 * @param {HTMLElement} node
 * @param {string} name of an attribute
 * @param {Clock} clock
 * @returns {(moment: number) => void} takes the time in milliseconds; Infinity removes the
 *   attribute
 */
function markedFrom(node, name, clock) {
  let due = Infinity;
  let timer = 0;
  return (moment) => {
    if (moment === due) return;
    const wait = moment - clock.now();
    due = moment;
    clock.cancel(timer);
    node.toggleAttribute(name, wait <= 0);
    if (wait > 0 && wait < Infinity)
      timer = clock.after(wait, () => node.toggleAttribute(name, true));
  };
}

/**
 * Describe the full picture of a view. A picture that was final and becomes sharper has no badge.
 * @param {Facts} facts
 * @param {boolean} sharp true if it has all of the screen's pixels
 * @param {{target: number, empty: string}} about see `frameInWords`
 * @returns {{badge: string, line: string}}
 */
export function wordsOf(facts, sharp, about) {
  const line = frameInWords(facts, about);
  return sharp && showsSurface(facts)
    ? { badge: "", line: line.replace(/^(Refining|Preview)/, "Sharpening") }
    : { badge: badge(facts, about.target), line };
}

/**
 * Describe a picture that the graphics card drew.
 * @param {number} error predicted relative error
 * @returns {string}
 */
export function predictedInWords(error) {
  return ` · drawn here, about ${errorInWords(error)} error (predicted)`;
}

/**
 * Describe a picture that is not the server's.
 * @param {Pick<Shown, "facts"|"predicted"|"shines">} shown
 * @param {State} state
 * @returns {string}
 */
function drawnInWords({ facts, predicted, shines }, state) {
  if (facts) return "";
  if (shines) return " · drawn here, shine by few rays";
  if (predicted) return predictedInWords(predicted);
  return state === "away" ? " · drawn here" : "";
}

/**
 * Return the badge of a picture that has not reached its target, or shows no surface; otherwise "".
 * @param {Pick<Facts, "provisional"|"error"|"surface">} facts
 * @param {number} target relative error
 * @returns {string}
 */
export function badge(facts, target) {
  const { provisional, error } = facts;
  if (!showsSurface(facts)) return "No surface";
  if (!provisional || error <= target) return "";
  return error < PREVIEW ? `Refining · ${errorInWords(error)} error` : "Preview";
}

/**
 * Return the words for screen readers. They change when light is everywhere, and at the end, not
 * with every frame.
 * @param {Facts} facts
 * @param {boolean} [sharp] true if the picture has all of the screen's pixels
 * @param {{target: number, empty: string}} [about] see `frameInWords`
 * @returns {string}
 */
export function announcement(facts, sharp = false, about) {
  if (!facts.provisional) return frameInWords(facts, about);
  return sharp
    ? "Sharpening"
    : `Refining, ${facts.coverage.provisional ? "not lit everywhere yet" : "lit everywhere"}`;
}

const GONE = 404; // HTTP status of a scene that the server no longer has
const READ_MS = 10_000; // time that a notice is shown

/** A sentence over the picture, which disappears by itself. */
export class Notice {
  #node;
  #timer = 0;

  /** @param {HTMLElement} node */
  constructor(node) {
    this.#node = node;
    this.say = this.say.bind(this);
  }

  /** Show a sentence; "" hides the notice. @param {string} words */
  say(words) {
    clearTimeout(this.#timer);
    this.#node.textContent = words;
    if (words) this.#timer = setTimeout(() => this.say(""), READ_MS);
  }
}

/**
 * The panel that reports trouble. It offers "Try now" if the page would ask again anyway.
 */
export class TroublePanel {
  #panel;

  /** Called by "Try now". @type {() => void} */
  onRetry = () => {};

  /** @param {HTMLElement} panel */
  constructor(panel) {
    this.#panel = panel;
    find(panel, "button").addEventListener("click", () => this.onRetry());
  }

  /**
   * Report trouble: over the whole picture, or in a strip if the page goes on drawing without the
   * server.
   * @param {Error & {title?: string, retry?: boolean, status?: number}} error
   * @param {boolean} [strip]
   */
  show({ title = "The page has a problem", message, retry = false, status }, strip = false) {
    this.#write("h2", strip ? `${title}: drawn here` : title);
    this.#write("p", message);
    this.#write("button", status === GONE ? "Open what it has" : "Try now");
    find(this.#panel, "button").hidden = !retry;
    this.#panel.toggleAttribute("data-strip", strip);
    this.#panel.hidden = false;
  }

  /** Hide the panel, as the trouble is over. */
  hide() {
    this.#panel.hidden = true;
  }

  /**
   * Wait for some time, or until the visitor presses "Try now".
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
   * Write a text if it has changed.
   * @param {string} selector
   * @param {string} text
   */
  #write(selector, text) {
    const node = find(this.#panel, selector);
    if (node.textContent !== text) node.textContent = text; // screen readers would repeat it
  }
}
