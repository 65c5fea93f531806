/**
 * What the stage shows, and what the controls ask for: whether both are one view, and since when
 * they are not.
 */

import { CLOCK } from "./trouble.js";

/** @typedef {import("../view/model.js").Knobs} Knobs */
/** @typedef {import("./schemas.js").Facts} Facts */
/** @typedef {import("./trouble.js").Clock} Clock */

/**
 * @typedef {object} Asked a view that the controls ask for, or have asked for
 * @property {Knobs} values
 * @property {string} key the same for two views whose pictures are the same
 * @property {number} since when the controls came to it, milliseconds
 * @property {number} until when they left it; Infinity before that
 *
 * @typedef {object} ShownPicture a picture on the stage
 * @property {Asked} of the view that it was asked for
 * @property {boolean} draft
 * @property {boolean} sharp whether it has all of the screen's pixels
 * @property {Facts|null} facts
 * @property {number|null} [predicted] relative error of a picture that nobody measured, where it
 *   can be told
 *
 * @typedef {"loading"|"trouble"|"away"|"moving"|"updating"|"provisional"|"final"} State of the stage: from
 *   `moving` on there is
 *   a picture, and from `provisional` on it is the full one of the view that the controls ask for;
 *   `away`: the server is, and the page draws by itself
 */

/**
 * Compares the picture on the stage with the controls. All that the page says of its picture is
 * read here.
 */
export class Shown {
  #keyOf;
  #clock;
  /** @type {Asked} */
  #asked;
  /** @type {ShownPicture|null} */
  #picture = null;
  #moving = false;
  #lost = false;
  #away = false;
  /** @type {Set<() => void>} */
  #listeners = new Set();

  /**
   * @param {Knobs} values of the controls
   * @param {(values: Knobs) => string} keyOf gives the key of a view
   * @param {Clock} [clock]
   */
  constructor(values, keyOf, clock = CLOCK) {
    this.#keyOf = keyOf;
    this.#clock = clock;
    this.#asked = { values, key: keyOf(values), since: clock.now(), until: Infinity };
  }

  /** The view that the controls ask for. @returns {Asked} */
  get asked() {
    return this.#asked;
  }

  /**
   * The knobs of the picture on the stage; before the first one, those of the controls.
   * @returns {Knobs}
   */
  get values() {
    return (this.#picture?.of ?? this.#asked).values;
  }

  /**
   * The view that the picture on the stage is of; null before the first one.
   * @returns {Asked|null}
   */
  get pictureOf() {
    return this.#picture?.of ?? null;
  }

  /** @returns {State} */
  get state() {
    if (this.#lost) return "trouble";
    if (this.#away && this.#picture && this.facts?.provisional !== false) return "away";
    if (this.facts) return this.facts.provisional ? "provisional" : "final";
    if (!this.#picture) return "loading";
    return this.#moving ? "moving" : "updating";
  }

  /**
   * What may be said of the picture: nothing, unless it is the full one of the view that the
   * controls ask for.
   * @returns {Facts|null}
   */
  get facts() {
    return this.#picture && !this.#picture.draft && this.#isAsked(this.#picture.of)
      ? this.#picture.facts
      : null;
  }

  /**
   * The predicted error of the picture that the graphics card drew of the view that the controls
   * ask for.
   * @returns {number|null}
   */
  get predicted() {
    return this.#picture && this.#isAsked(this.#picture.of)
      ? (this.#picture.predicted ?? null)
      : null;
  }

  /** Whether the picture has all of the screen's pixels. @returns {boolean} */
  get sharp() {
    return this.#picture?.sharp ?? false;
  }

  /**
   * When the controls left the picture on the stage; Infinity where they have not.
   * @returns {number}
   */
  get leftAt() {
    return this.#picture && !this.#isAsked(this.#picture.of) ? this.#picture.of.until : Infinity;
  }

  /**
   * Since when the controls wait for a full picture; Infinity where they do not.
   * @returns {number}
   */
  get waitsSince() {
    return this.#lost || this.#away || this.facts ? Infinity : this.#asked.since;
  }

  /**
   * Whether a picture of a view would take the place of one that the controls ask for.
   * @param {Asked} of
   * @returns {boolean}
   */
  surpasses(of) {
    return this.#picture !== null && this.#isAsked(this.#picture.of) && !this.#isAsked(of);
  }

  /** Call `listener` whenever anything here has changed. @param {() => void} listener */
  subscribe(listener) {
    this.#listeners.add(listener);
  }

  /**
   * The controls are now these.
   * @param {Knobs} values
   * @returns {boolean} whether they ask for another picture
   */
  ask(values) {
    const key = this.#keyOf(values);
    const other = key !== this.#asked.key;
    if (other) this.#leave(values, key);
    else this.#asked.values = values;
    return other;
  }

  /** The page is left for another: what it shows is not what was asked for. */
  leave() {
    this.#leave(this.#asked.values, "");
  }

  /** The view goes on changing, or rests. @param {boolean} moving */
  move(moving) {
    this.#moving = moving;
    this.#tell();
  }

  /** A picture is on the stage now. @param {ShownPicture} picture */
  show(picture) {
    this.#picture = picture;
    this.#lost = false;
    this.#tell();
  }

  /**
   * The server is away, or back; while it is away the page draws by itself.
   * @param {boolean} away
   */
  part(away) {
    this.#away = away;
    this.#lost &&= !away;
    this.#tell();
  }

  /** There is no picture of the view that the controls ask for. */
  lose() {
    this.#lost = true;
    this.#tell();
  }

  /** @param {Knobs} values @param {string} key */
  #leave(values, key) {
    this.#asked.until = this.#clock.now();
    this.#asked = { values, key, since: this.#clock.now(), until: Infinity };
    if (this.#picture && this.#isAsked(this.#picture.of)) this.#picture.of = this.#asked;
    this.#tell();
  }

  /** @param {Asked} of */
  #isAsked({ key }) {
    return key === this.#asked.key;
  }

  #tell() {
    this.#listeners.forEach((listener) => listener());
  }
}
