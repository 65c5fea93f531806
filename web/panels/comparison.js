/**
 * Two shadings of one view side by side: the view's shading on the left, another one on the right,
 * and a divider that can be moved.
 */

import { find } from "../dom.js";
import { Polling } from "../net/polling.js";
import { shadingName } from "../view/format.js";

/** @typedef {"moving"|"coming"|"lost"|"provisional"|"final"} State of the right side */

/** Percent by which an arrow moves the divider, and an arrow with shift or a page key. */
const [STEP, STRIDE] = [2, 10];

/** Words behind the name of the right side's shading. @type {Record<State, string>} */
const WORDS = {
  moving: " · when the view rests",
  coming: " · drawing…",
  lost: " · not up to date",
  provisional: " · refining",
  final: "",
};

/**
 * The right side: a picture of the current view, or none. It is dimmed while the view moves, as
 * drafts are drawn on the left only.
 */
export class Comparison {
  #root;
  #picture;
  #polling;
  #view;
  #moving = false;

  /**
   * @param {HTMLElement} root holds two `.side`s and `#divider`
   * @param {import("../view/picture.js").Picture} picture shows the right side
   * @param {(options: import("../net/polling.js").FrameOptions, signal: AbortSignal)
   *   => Promise<import("../net/schemas.js").Frame & {of: import("../net/shown.js").Asked}>} ask
   * sends one request for the right side
   * @param {import("../view/model.js").ViewModel} view
   */
  constructor(root, picture, ask, view) {
    this.#root = root;
    this.#picture = picture;
    this.#view = view;
    this.#polling = new Polling(ask, {
      frame: (frame) => this.#show(frame),
      trouble: () => this.#hide("lost"),
    });
    attachDivider(find(root, "#divider"), (at) => this.#divide(at));
    document.addEventListener(
      "visibilitychange",
      () => this.#on && !document.hidden && this.#polling.resume(),
    );
    view.watch(
      ({ shading, compare }) => [shading, compare],
      () => this.#compare(),
    );
    this.#compare();
  }

  /** Name the shading of the picture on the left. @param {string} shading */
  name(shading) {
    find(this.#root, ".left").textContent = shadingName(shading);
  }

  /** Note that the view goes on changing, or rests. @param {boolean} moving */
  moving(moving) {
    this.#moving = moving;
    if (!this.#on) return;
    if (moving) this.#hide("moving");
    else if (this.#picture.hidden) this.#ask();
  }

  /** Request a better picture of the same view; the present one is shown meanwhile. */
  improve() {
    if (!this.#on || this.#moving) return;
    this.#mark("provisional");
    this.#polling.show(false);
  }

  /** Return true if shadings are compared. */
  get #on() {
    return this.#view.values.compare !== "";
  }

  /** Begin, change or end the comparison. */
  #compare() {
    this.#root.hidden = !this.#on;
    this.#hide("moving");
    if (!this.#on) return;
    this.#divide(Number(find(this.#root, "#divider").ariaValueNow));
    if (!this.#moving) this.#ask();
  }

  /** Request the picture of the right side. */
  #ask() {
    this.#mark("coming");
    this.#polling.show(false);
  }

  /**
   * Show a picture and its state.
   * @param {{blob: Blob|null, facts: import("../net/schemas.js").Facts|null}} frame
   */
  async #show({ blob, facts }) {
    const alt = `The same isosurface; ${shadingName(this.#view.values.compare)}`;
    if (blob && !(await this.#picture.show(blob, alt))) return;
    this.#mark(facts?.provisional ? "provisional" : "final");
  }

  /** Hide the picture. After trouble, requests continue. @param {State} state */
  #hide(state) {
    if (state !== "lost") this.#polling.stop();
    this.#picture.hide();
    this.#mark(state);
  }

  /** Show the state of the right side. @param {State} state */
  #mark(state) {
    this.#root.dataset.state = state;
    find(this.#root, ".right").textContent =
      `${shadingName(this.#view.values.compare)}${WORDS[state]}`;
  }

  /** Put the divider at a place. @param {number} at percent from the left */
  #divide(at) {
    const { shading, compare } = this.#view.values;
    this.#root.style.setProperty("--at", `${at}%`);
    const words = `${Math.round(at)} % ${shadingName(shading)}, ${Math.round(100 - at)} % ${shadingName(compare)}`;
    find(this.#root, "#divider").ariaValueText = words;
  }
}

/**
 * Return the place to which a key moves the divider, in percent from the left; null for other keys.
 * @param {{key: string, shiftKey: boolean}} event
 * @param {number} now
 * @returns {number|null}
 */
export function dividerPlace({ key, shiftKey }, now) {
  const step = shiftKey ? STRIDE : STEP;
  /** @type {Record<string, number>} */
  const places = {
    ArrowLeft: now - step,
    ArrowDown: now - step,
    ArrowRight: now + step,
    ArrowUp: now + step,
    PageDown: now - STRIDE,
    PageUp: now + STRIDE,
    Home: 0,
    End: 100,
  };
  return key in places ? Math.min(100, Math.max(0, places[key])) : null;
}

/**
 * Let pointer and keys move the divider.
 * @param {HTMLElement} divider
 * @param {(at: number) => void} onMove called with the percent from the left
 */
function attachDivider(divider, onMove) {
  /** @param {number} at */
  const move = (at) => {
    divider.ariaValueNow = String(at);
    onMove(at);
  };
  divider.addEventListener("pointerdown", (event) => {
    event.stopPropagation(); // on the stage a drag turns the object
    divider.setPointerCapture(event.pointerId);
  });
  divider.addEventListener("pointermove", (event) => {
    if (!divider.hasPointerCapture(event.pointerId) || !divider.parentElement) return;
    const { left, width } = divider.parentElement.getBoundingClientRect();
    const at = Math.round((1000 * (event.clientX - left)) / width) / 10;
    move(Math.min(100, Math.max(0, at)));
  });
  divider.addEventListener("dblclick", (event) => event.stopPropagation());
  divider.addEventListener("keydown", (event) => {
    const at = dividerPlace(event, Number(divider.ariaValueNow));
    if (at === null) return;
    event.preventDefault();
    event.stopPropagation();
    move(at);
  });
}
