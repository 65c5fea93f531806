/** Plays a time series in a loop: each step follows once the one before it has been shown. */

import { CLOCK } from "../net/trouble.js";

/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {import("../net/shown.js").Shown} Shown */
/** @typedef {import("../view/model.js").ViewModel} ViewModel */

const STEP_MS = 500; // time that a step is shown, at least

/** A button that plays the steps, and pauses. */
export class Player {
  #button;
  #view;
  #shown;
  #steps;
  #clock;
  #timer = 0;
  #due = false; // true once the current step was shown for long enough
  #step = NaN; // step that was set last

  /**
   * @param {HTMLButtonElement} button
   * @param {Scene} scene
   * @param {ViewModel} view
   * @param {Shown} shown
   * @param {import("../net/trouble.js").Clock} [clock]
   */
  constructor(button, scene, view, shown, clock = CLOCK) {
    this.#button = button;
    this.#view = view;
    this.#shown = shown;
    this.#steps = scene.volume.times ?? 1;
    this.#clock = clock;
    button.addEventListener("click", () => (this.plays ? this.pause() : this.play()));
    view.subscribe(({ time }) => time === this.#step || this.pause()); // the visitor chose another
    shown.subscribe(() => this.#go());
  }

  /** Return true while steps are being played. @returns {boolean} */
  get plays() {
    return this.#button.getAttribute("aria-pressed") === "true";
  }

  /** Play from the step that is shown, without waiting. */
  play() {
    this.#mark(true);
    this.#due = true;
    this.#go();
  }

  /** Pause at the step that is shown. */
  pause() {
    if (!this.plays) return;
    this.#clock.cancel(this.#timer);
    this.#mark(false);
  }

  /** Show the state on the button. @param {boolean} plays */
  #mark(plays) {
    this.#button.setAttribute("aria-pressed", String(plays));
    this.#button.textContent = plays ? "Pause" : "Play";
    this.#step = plays ? (this.#view.values.time ?? 0) : NaN;
  }

  /**
   * Show the next step if it is due and the picture of the last one is on the stage, so that no
   * step is skipped.
   */
  #go() {
    if (!this.plays || !this.#due || this.#shown.pictureOf !== this.#shown.asked) return;
    this.#due = false;
    this.#timer = this.#clock.after(STEP_MS, () => {
      this.#due = true;
      this.#go();
    });
    this.#step = (this.#step + 1) % this.#steps;
    this.#view.set({ time: this.#step });
  }
}
