/** Reading the picture: clicks show a point, or measure between points; the list of what was measured. */

import { find, textElement } from "../dom.js";
import { MOST, measureInWords } from "../view/measures.js";

/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {import("../view/marks.js").Marks} Marks */
/** @typedef {import("../view/marks.js").FindSurface} FindSurface */
/** @typedef {import("../view/measures.js").Measure} Measure */
/** @typedef {import("../view/model.js").ViewModel} ViewModel */
/** @typedef {import("../view/rotation.js").Vec3} Vec3 */
/** @typedef {import("./point.js").PointCard} PointCard */

const FULL = `A link holds ${MOST} measures: remove one first.`;
const EMPTY = "There is no surface in the middle of the picture.";
const MISSED = "There is no surface: click another place.";
/** What is asked for, by the number of points that there are. */
const ASKED = [
  "Click the first point.",
  "Click the second point.",
  "Click a third point for an angle, or stop.",
];

/** What clicks on the picture do. */
export class Reading {
  #card;
  #marks;
  #view;
  #pick;
  #say;
  #hint;
  /** @type {Vec3[]|null} */
  #measured = null; // points of the measure that is being made; null while clicks show points

  /**
   * @param {HTMLElement} hint says what to click, and holds a button that stops
   * @param {PointCard} card
   * @param {Marks} marks
   * @param {ViewModel} view
   * @param {FindSurface} pick
   * @param {(words: string) => void} say
   */
  constructor(hint, card, marks, view, pick, say) {
    this.#hint = hint;
    this.#card = card;
    this.#marks = marks;
    this.#view = view;
    this.#pick = pick;
    this.#say = say;
    find(hint, "button").addEventListener("click", () => this.stop());
    card.onChange = () => this.#show();
    view.watch(({ isovalue }) => isovalue, () => card.close());
    view.watch(({ measures }) => measures, () => this.#show());
    this.#show();
  }

  /**
   * A click: shows the point there, or makes it one of the measure.
   * @param {number} right of the middle, in heights of the picture
   * @param {number} up of the middle, in heights of the picture
   */
  async click(right, up) {
    if (!this.#measured) {
      await this.#card.open(right, up); // a click beside the surface only closes the card
      return;
    }
    const point = await this.#pick(this.#view.values, right, up);
    if (!point) this.#say(MISSED);
    else if (this.#measured) this.#add(this.#measured, point);
  }

  /** The same as a click in the middle of the picture, for those who use keys: it says where nothing is there. */
  async middle() {
    if (this.#measured) await this.click(0, 0);
    else if (!(await this.#card.open(0, 0))) this.#say(EMPTY);
  }

  /** Measure from the point that is shown, if one is; or stop measuring. */
  measure() {
    if (this.#measured) return this.stop();
    if (this.#view.values.measures.length >= MOST) return this.#say(FULL);
    this.#measured = this.#card.point ? [this.#card.point] : [];
    this.#card.close();
  }

  /** Measure no further, or remove the card. What was measured stays. */
  stop() {
    this.#measured = null;
    this.#card.close();
  }

  /**
   * @param {Vec3[]} measured points so far
   * @param {Vec3} point
   */
  #add(measured, point) {
    const points = [...measured, point];
    const others = this.#view.values.measures.slice(0, measured.length > 1 ? -1 : undefined); // a distance becomes an angle
    this.#measured = points.length < ASKED.length ? points : null;
    if (points.length > 1) this.#view.set({ measures: [...others, points] });
    this.#show();
  }

  #show() {
    const [measures, started] = [this.#view.values.measures, this.#measured?.slice(0, 1) ?? []];
    if (this.#measured && this.#measured.length > 1 && !measures.length) this.#measured = null; // it was removed
    this.#hint.hidden = !this.#measured;
    find(this.#hint, "span").textContent = this.#measured ? ASKED[this.#measured.length] : "";
    this.#marks.show([...(this.#card.point ? [this.#card.point] : []), ...started, ...measures.flat()], measures);
  }
}

/**
 * Keep the list of measures up with the view.
 * @param {HTMLElement} panel holds a list; it is hidden while there is nothing in it
 * @param {Pick<Scene, "volume">} scene
 * @param {ViewModel} view
 */
export function attachMeasures(panel, { volume }, view) {
  const draw = () => {
    const { measures } = view.values;
    panel.hidden = !measures.length;
    find(panel, "ol").replaceChildren(...measures.map((points, n) => {
      const words = measureInWords(volume, points);
      const button = Object.assign(textElement("button", "×"), { type: "button", ariaLabel: `Remove ${words}` });
      button.addEventListener("click", () => view.set({ measures: measures.filter((_, i) => i !== n) }));
      const item = textElement("li", `${points.length > 2 ? "Angle" : "Distance"} ${words}`);
      item.append(button);
      return item;
    }));
  };
  view.watch(({ measures }) => measures, draw);
  draw();
}
