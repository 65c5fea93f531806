/** The card of a point of the surface: facts about the point, next to its mark. */

import { find, textElement } from "../dom.js";
import { errorInWords, exactValue } from "../view/format.js";
import { placeInWords } from "../view/measures.js";

/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {import("../net/schemas.js").SurfacePoint} SurfacePoint */
/** @typedef {import("../view/marks.js").Marks} Marks */
/** @typedef {import("../view/rotation.js").Vec3} Vec3 */
/** @typedef {Record<string, string>} Rows names and values; empty values are left out */

const DIGITS = 2; // decimals of a voxel's indices
const OFF = 14; // pixels between a mark and its card
const EDGE = 8; // pixels between a card and the edge of the stage
const REST_MS = 600; // pause between two requests for the same point
const HIDDEN = "Behind the surface from here";

/** Shows one point at a time, and keeps its facts up to date with the light. */
export class PointCard {
  #card;
  #scene;
  #marks;
  #ask;
  /** @type {Vec3|null} */
  #point = null;
  #asked = 0; // number of requests, so that a slow answer does not replace a newer one
  #timer = 0;

  /** Called when another point is shown, or none. @type {() => void} */
  onChange = () => {};

  /** Called when a point is shown for the first time. @type {(point: SurfacePoint) => void} */
  onOpen = () => {};

  /**
   * @param {HTMLElement} card
   * @param {Scene} scene
   * @param {Marks} marks
   * @param {(right: number, up: number) => Promise<SurfacePoint|null>} ask returns the surface at a
   *   place of the picture, in heights of the picture from its middle
   */
  constructor(card, scene, marks, ask) {
    this.#card = card;
    this.#scene = scene;
    this.#marks = marks;
    this.#ask = ask;
    find(card, ".close").addEventListener("click", () => this.close());
  }

  /** Return the point that is shown; null if there is none. @returns {Vec3|null} */
  get point() {
    return this.#point;
  }

  /**
   * Show the point at a place of the picture; close the card if there is no surface.
   * @param {number} right distance to the right of the middle, heights of the picture
   * @param {number} up distance above the middle, heights of the picture
   * @returns {Promise<boolean>} false if there is no surface
   */
  async open(right, up) {
    const count = ++this.#asked;
    const found = await this.#ask(right, up);
    if (count !== this.#asked) return true;
    if (!found) {
      this.close();
      return false;
    }
    this.#point = found.position;
    this.#write(found);
    this.onOpen(found);
    this.#card.hidden = false;
    this.onChange();
    return true;
  }

  /** Hide the card. */
  close() {
    this.#asked += 1;
    clearTimeout(this.#timer);
    this.#timer = 0;
    this.#point = null;
    this.#card.hidden = true;
    this.onChange();
  }

  /** Request the point's light again soon, as the picture has become better. */
  refresh() {
    if (this.#point && !this.#timer) this.#timer = setTimeout(() => this.#again(), REST_MS);
  }

  /** Put the card next to its mark; the style sheet places docked cards. */
  place() {
    if (!this.#point || !this.#card.parentElement) return;
    const { clientWidth, clientHeight } = this.#card.parentElement;
    const [{ x, y }, { offsetWidth, offsetHeight }] = [this.#marks.spot(this.#point), this.#card];
    const left = x + OFF + offsetWidth + EDGE <= clientWidth ? x + OFF : x - OFF - offsetWidth;
    this.#card.style.left = `${within(left, EDGE, clientWidth - offsetWidth - EDGE)}px`;
    this.#card.style.top = `${within(y + OFF, EDGE, clientHeight - offsetHeight - EDGE)}px`;
    this.#card.toggleAttribute("data-low", y > clientHeight / 2);
    const hidden = this.#marks.hides(this.#point);
    this.#card.toggleAttribute("data-hidden", hidden);
    find(this.#card, ".note").textContent = hidden ? HIDDEN : "";
  }

  /** Request the point again, and show its light if the pixel still shows this point. */
  async #again() {
    this.#timer = 0;
    const point = this.#point;
    const count = this.#asked;
    if (!point || this.#marks.hides(point)) return;
    const place = this.#marks.place(point);
    const found = await this.#ask(place.right, place.up);
    if (!found || count !== this.#asked || !this.#same(found.position, point)) return;
    this.#write({ ...found, position: point });
  }

  /**
   * Return true if a pixel shows a point: the middle of the pixel may be up to two voxels away from
   * it.
   * @param {Vec3} a
   * @param {Vec3} b
   */
  #same(a, b) {
    return Math.hypot(...a.map((x, i) => x - b[i])) < 2 * Math.max(...this.#scene.volume.spacing);
  }

  /** Show the facts of a point. @param {SurfacePoint} point */
  #write(point) {
    const rows = Object.entries(pointRows(this.#scene, point)).filter(([, value]) => value);
    find(this.#card, "dl").replaceChildren(
      ...rows.flatMap(([name, value]) => [textElement("dt", name), textElement("dd", value)]),
    );
    find(this.#card, ".swatch").style.background = point.displayed;
    this.place();
  }
}

/**
 * Return the facts of a point in words.
 * @param {Pick<Scene, "volume">} scene
 * @param {SurfacePoint} point
 * @returns {Rows}
 */
export function pointRows(
  { volume },
  { position, sides, unit, voxel, value, wall, normal, light, displayed, state, error },
) {
  const place = placeInWords({ ...volume, unit }, position, sides);
  const indices = voxel.map((x) => minus(String(Number(x.toFixed(DIGITS))))).join(", ");
  return {
    Position: place,
    Voxel: indices === placeInWords({ ...volume, unit: "" }, position, sides) ? "" : indices,
    Value: value === null ? "" : minus(String(exactValue(value, volume.value_range))),
    Wall: wall === null ? "" : String(wall + 1),
    Normal: normal.map((x) => minus(x.toFixed(2).replace("-0.00", "0.00"))).join(", "),
    Light: `${light.map((x) => Number(x.toPrecision(3))).join(", ")} linear, ${displayed}`,
    Error: errorOf(state, error),
  };
}

/**
 * Write the error of a point.
 * @param {SurfacePoint["state"]} state
 * @param {number} error
 */
function errorOf(state, error) {
  if (state === "provisional") return "not known yet";
  if (error === 0) return ""; // the shading has no error
  return `${errorInWords(error)}${state === "final" ? "" : ", being refined"}`;
}

/** Write a number with a true minus sign. @param {string} number */
function minus(number) {
  return number.replace("-", "−");
}

/**
 * Limit a number to a range.
 * @param {number} x
 * @param {number} low
 * @param {number} high
 */
function within(x, low, high) {
  return Math.max(low, Math.min(high, x));
}
