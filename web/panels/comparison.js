/**
 * Two shadings of one view side by side: left the view's own, right another one, and a divider that
 * is moved.
 */

import { find } from "../dom.js";
import { Polling } from "../net/polling.js";
import { shadingName } from "../view/format.js";

/** @typedef {"moving"|"coming"|"lost"|"provisional"|"final"} State of the right side */

// percent that an arrow moves the divider by; and one with shift, or a page key
const [STEP, STRIDE] = [2, 10];
/** @type {Record<State, string>} */
const WORDS = {
  moving: " · when the view rests",
  coming: " · drawing…",
  lost: " · not up to date",
  provisional: " · refining",
  final: "",
};

/**
 * The right side: a picture of the view as it is now, or none. While the view moves it is dim, for
 * drafts are of the left.
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

  /** The left side shows a picture of this shading. @param {string} shading */
  name(shading) {
    find(this.#root, ".left").textContent = shadingName(shading);
  }

  /** The view goes on changing, or rests. @param {boolean} moving */
  moving(moving) {
    this.#moving = moving;
    if (!this.#on) return;
    if (moving) this.#hide("moving");
    else if (this.#picture.hidden) this.#ask();
  }

  /** The view is as it was, but more is asked of its pictures; the present one stays meanwhile. */
  improve() {
    if (!this.#on || this.#moving) return;
    this.#mark("provisional");
    this.#polling.show(false);
  }

  get #on() {
    return this.#view.values.compare !== "";
  }

  #compare() {
    this.#root.hidden = !this.#on;
    this.#hide("moving");
    if (!this.#on) return;
    this.#divide(Number(find(this.#root, "#divider").ariaValueNow));
    if (!this.#moving) this.#ask();
  }

  #ask() {
    this.#mark("coming");
    this.#polling.show(false);
  }

  /** @param {{blob: Blob|null, facts: import("../net/schemas.js").Facts|null}} frame */
  async #show({ blob, facts }) {
    const alt = `The same isosurface; ${shadingName(this.#view.values.compare)}`;
    if (blob && !(await this.#picture.show(blob, alt))) return;
    this.#mark(facts?.provisional ? "provisional" : "final");
  }

  /** @param {State} state */
  #hide(state) {
    if (state !== "lost") this.#polling.stop();
    this.#picture.hide();
    this.#mark(state);
  }

  /** @param {State} state */
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
 * Where a key moves the divider to, in percent from the left; null for a key that does not.
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
 * Move the divider by pointer and keys.
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
    event.stopPropagation(); // the stage would turn the object
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
