/** The state of the picture in words and as a bar; and the panel for when something is wrong. */

import { find } from "../dom.js";
import { STATES } from "../net/schemas.js";
import { CLOCK } from "../net/trouble.js";
import { PREVIEW, errorInWords, frameInWords, shareInWords, showsSurface } from "../view/format.js";

/** @typedef {import("../net/schemas.js").Facts} Facts */
/** @typedef {import("../net/shown.js").Shown} Shown */
/** @typedef {import("../net/shown.js").State} State */
/** @typedef {import("../net/trouble.js").Clock} Clock */
/** @typedef {import("../view/model.js").Knobs} Knobs */

const ALMOST = 0.99; // the most that a bar shows of what is not done
const OLD_MS = 300; // after which a picture that the controls have left is dimmed
const LATE_MS = 600; // after which a person is told that a picture is still to come
const LAST = ": the picture is the last one received";
/** @type {Partial<Record<State, {badge: string, line: string}>>} */
const WORDS = {
  loading: { badge: "", line: "Loading the scene…" },
  trouble: { badge: "", line: "Not up to date: the picture is the last one received" },
  away: { badge: "", line: "The server is away" },
  moving: { badge: "Moving", line: "Moving" },
  updating: { badge: "Updating", line: "Updating: the picture of this view is on its way" },
};

/**
 * Says of the picture on the stage what is true of it, and nothing while the controls ask for
 * another.
 */
export class Status {
  #root;
  #target;
  #emptyOf;
  #clock;
  #old;
  #late;
  #bar = { since: -1, done: 0 }; // what it showed of the present picture

  /**
   * @param {ParentNode} root holds `#stage`, `#badge`, `#progress`, `#status-line`, `#announce`
   * @param {number} target relative error at which a picture is good enough to go without a badge
   * @param {(values: Knobs) => string} emptyOf what is said of a view that shows no surface
   * @param {Clock} [clock]
   */
  constructor(root, target, emptyOf, clock = CLOCK) {
    this.#root = root;
    this.#target = target;
    this.#emptyOf = emptyOf;
    this.#clock = clock;
    const stage = find(root, "#stage");
    this.#old = markedFrom(stage, "data-old", clock);
    // what moves there costs frames of the screen
    this.#late = markedFrom(stage, "data-late", clock);
  }

  /** Show how the picture stands to the controls. @param {Shown} shown */
  show(shown) {
    const { state, sharp, leftAt, waitsSince } = shown;
    const facts = shown.facts && { ...shown.facts, timeLeft: shown.left };
    const stage = find(this.#root, "#stage");
    const about = { target: this.#target, empty: this.#emptyOf(shown.values) };
    const { badge, line } = WORDS[state] ?? wordsOf(/** @type {Facts} */ (facts), sharp, about);
    const more = state === "away" && facts ? LAST : drawnInWords(shown, state);
    stage.dataset.state = state;
    stage.toggleAttribute("data-busy", waitsSince < Infinity);
    this.#write("#status-line", line + more);
    this.#write("#badge", badge);
    const news = facts && state !== "away";
    this.#write("#announce", news ? announcement(facts, sharp, about) : "");
    this.#fill(facts, shown.asked.since);
    this.#old(leftAt + OLD_MS);
    this.#late(waitsSince + LATE_MS);
  }

  /** @param {string} selector @param {string} text */
  #write(selector, text) {
    const node = find(this.#root, selector);
    if (node.textContent !== text) node.textContent = text; // or screen readers say it again
  }

  /**
   * Fill the bar; it never runs back while the controls rest.
   * @param {Facts|null} facts
   * @param {number} since when they came to this view, milliseconds
   */
  #fill(facts, since) {
    const done = facts ? doneOf(facts, (this.#clock.now() - since) / 1000) : 0;
    this.#bar = { since, done: since === this.#bar.since ? Math.max(done, this.#bar.done) : done };
    const bar = find(this.#root, "#progress");
    const shares = facts && sharesOf(facts, this.#bar.done);
    for (const state of STATES)
      find(bar, `.${state}`).style.width = `${shares ? 100 * shares[state] : 0}%`;
    bar.ariaValueNow = shares && String(Math.floor(100 * shares.final));
    bar.ariaValueText = shares ? `${shareInWords(shares.final)} done` : "not known yet";
  }
}

/**
 * How much of the time to the final picture is over: all of it where nothing is left to wait for.
 * @param {Pick<Facts, "provisional"|"timeLeft">} facts
 * @param {number} seconds since the view was asked for
 * @returns {number} from 0 to 1
 */
export function doneOf({ provisional, timeLeft }, seconds) {
  if (!provisional) return 1;
  return timeLeft ? Math.min(seconds / Math.max(seconds + timeLeft.likely, 1e-3), ALMOST) : 0;
}

/**
 * What a bar shows: what is done, and of the rest how much has light.
 * @param {Facts} facts
 * @param {number} done
 */
function sharesOf(facts, done) {
  const lit = showsSurface(facts) ? 1 - facts.coverage.provisional : 1;
  return { final: done, converging: (1 - done) * lit, provisional: (1 - done) * (1 - lit) };
}

/**
 * Mark a node from a moment on that may be still to come.
 * @param {HTMLElement} node
 * @param {string} name of an attribute
 * @param {Clock} clock
 * @returns {(moment: number) => void} Infinity takes the mark away
 */
function markedFrom(node, name, clock) {
  let [due, timer] = [Infinity, 0];
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
 * What is said of the full picture of a view. One that was done, and becomes sharp, has no badge.
 * @param {Facts} facts
 * @param {boolean} sharp whether it has all of the screen's pixels
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
 * What is said of a picture that the graphics card drew.
 * @param {number} error
 * @returns {string}
 */
export function predictedInWords(error) {
  return ` · drawn here, about ${errorInWords(error)} error (predicted)`;
}

/**
 * What is said of a picture that is not the server's.
 * @param {Pick<Shown, "facts"|"predicted">} shown
 * @param {State} state
 * @returns {string}
 */
function drawnInWords({ facts, predicted }, state) {
  if (facts) return "";
  if (predicted) return predictedInWords(predicted);
  return state === "away" ? " · drawn here" : "";
}

/**
 * What stands on a picture that is not within its target: it counts down to that; or on one that
 * shows nothing.
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
 * What screen readers say: it changes once light is everywhere and at the end, not at every frame.
 * @param {Facts} facts
 * @param {boolean} [sharp] whether the picture has all of the screen's pixels
 * @param {{target: number, empty: string}} [about] see `frameInWords`
 * @returns {string}
 */
export function announcement(facts, sharp = false, about) {
  if (!facts.provisional) return frameInWords(facts, about);
  return sharp
    ? "Sharpening"
    : `Refining, ${facts.coverage.provisional ? "not lit everywhere yet" : "lit everywhere"}`;
}

const GONE = 404; // status of a scene that is not there any more
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

/**
 * The panel that says what is wrong; "Try now" is offered where the page would ask again anyway.
 */
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
   * Show what is wrong: all over the picture, or in a strip, if the picture goes on without the
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
