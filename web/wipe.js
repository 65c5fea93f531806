/** Two shadings of one view side by side: left the view's own, right another one, and a divider that is moved. */

import { shadingName } from "./knobs.js";
import { Polling } from "./polling.js";

const [STEP, STRIDE] = [2, 10]; // percent that an arrow moves the divider by; and one with shift, or a page key
const WORDS = { moving: " · when the view rests", coming: " · drawing…", lost: " · not up to date", provisional: " · provisional", final: "" };

/** The right side: a picture of the view as it is now, or none. While the view moves it is dim, for drafts are of the left. */
export class Wipe {
  #root;
  #picture;
  #polling;
  #view;
  #moving = false;

  /**
   * @param {HTMLElement} root holds two `.side`s and `#divider`
   * @param {import("./picture.js").Picture} picture shows the right side
   * @param {Function} ask sends one request for the right side, as `Polling` wants it
   * @param {import("./view.js").ViewModel} view
   */
  constructor(root, picture, ask, view) {
    this.#root = root;
    this.#picture = picture;
    this.#view = view;
    this.#polling = new Polling(ask, { frame: (frame) => this.#show(frame), trouble: () => this.#hide("lost"), busy: () => {} });
    attachDivider(root.querySelector("#divider"), (at) => this.#tellShares(at));
    document.addEventListener("visibilitychange", () => this.#on && !document.hidden && this.#polling.resume());
    view.watch(({ shading, compare }) => [shading, compare], () => this.#compare());
    this.#compare();
  }

  /** The view goes on changing, or rests. @param {boolean} moving */
  moving(moving) {
    this.#moving = moving;
    if (!this.#on) return;
    if (moving) this.#hide("moving");
    else if (this.#picture.hidden) this.#ask();
  }

  get #on() {
    return this.#view.values.compare !== "";
  }

  #compare() {
    this.#root.hidden = !this.#on;
    this.#hide("moving");
    if (!this.#on) return;
    this.#root.querySelector(".left").textContent = shadingName(this.#view.values.shading);
    this.#tellShares(this.#root.querySelector("#divider").ariaValueNow);
    if (!this.#moving) this.#ask();
  }

  #ask() {
    this.#tell("coming");
    this.#polling.show(false);
  }

  async #show({ blob, facts }) {
    const alt = `The same isosurface; ${shadingName(this.#view.values.compare)}`;
    if (blob && !(await this.#picture.show(blob, alt))) return;
    this.#tell(facts?.provisional ? "provisional" : "final");
  }

  #hide(state) {
    if (state !== "lost") this.#polling.stop();
    this.#picture.hide();
    this.#tell(state);
  }

  #tell(state) {
    this.#root.dataset.state = state;
    this.#root.querySelector(".right").textContent = `${shadingName(this.#view.values.compare)}${WORDS[state]}`;
  }

  #tellShares(at) {
    const { shading, compare } = this.#view.values;
    this.#root.style.setProperty("--at", `${at}%`);
    const words = `${Math.round(at)} % ${shadingName(shading)}, ${Math.round(100 - at)} % ${shadingName(compare)}`;
    this.#root.querySelector("#divider").ariaValueText = words;
  }
}

/** Move the divider by pointer and keys; `told` hears of every percent from the left. */
function attachDivider(divider, told) {
  const move = (percent) => {
    divider.ariaValueNow = Math.min(100, Math.max(0, percent));
    told(divider.ariaValueNow);
  };
  divider.addEventListener("pointerdown", (event) => {
    event.stopPropagation(); // the stage would turn the object
    divider.setPointerCapture(event.pointerId);
  });
  divider.addEventListener("pointermove", (event) => {
    if (!divider.hasPointerCapture(event.pointerId)) return;
    const { left, width } = divider.parentElement.getBoundingClientRect();
    move(Math.round((1000 * (event.clientX - left)) / width) / 10);
  });
  divider.addEventListener("dblclick", (event) => event.stopPropagation());
  divider.addEventListener("keydown", (event) => {
    const now = Number(divider.ariaValueNow);
    const step = event.shiftKey ? STRIDE : STEP;
    const places = {
      ArrowLeft: now - step, ArrowDown: now - step, ArrowRight: now + step, ArrowUp: now + step,
      PageDown: now - STRIDE, PageUp: now + STRIDE, Home: 0, End: 100,
    };
    if (!(event.key in places)) return;
    event.preventDefault();
    event.stopPropagation();
    move(places[event.key]);
  });
}
