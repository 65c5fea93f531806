/**
 * Compares the picture on the stage with the controls: if both show one view, and since when they
 * do not.
 */

import { leftAfter } from "../view/format.js";
import { CLOCK } from "./trouble.js";

/** @typedef {import("../view/model.js").Knobs} Knobs */
/** @typedef {import("./schemas.js").Facts} Facts */
/** @typedef {import("./trouble.js").Clock} Clock */

/**
 * @typedef {object} Asked a view that the controls ask for, or have asked for
 * @property {Knobs} values
 * @property {string} key equal for views whose pictures are the same
 * @property {number} since time at which the controls came to it, milliseconds
 * @property {number} until time at which the controls left it; Infinity before that
 *
 * @typedef {object} ShownPicture a picture on the stage
 * @property {Asked} of the view that it shows
 * @property {boolean} draft
 * @property {boolean} sharp true if it has all of the screen's pixels
 * @property {Facts|null} facts
 *
 * @typedef {object} Cover the card's picture, which lies over the server's
 * @property {Asked} of the view that it shows
 * @property {number|null} predicted its relative error; null if it cannot be predicted
 * @property {boolean} [shines] true if it shows shine, by few rays
 *
 * @typedef {"loading"|"trouble"|"away"|"moving"|"updating"|"provisional"|"final"} State state of
 *   the stage: from `moving` on there is a picture, and from `provisional` on it is the full
 *   picture of the view that the controls ask for; `away` means that the server does not answer,
 *   and the page draws by itself
 */

/**
 * Compares the picture on the stage with the controls. The page reads here everything that it says
 * about its picture.
 */
export class Shown {
  #keyOf;
  #clock;
  /** @type {Asked} */
  #asked;
  /** @type {ShownPicture|null} */
  #picture = null;
  /** @type {Cover|null} */
  #cover = null;
  #cameAt = 0; // time at which the server's picture came
  #moving = false;
  #lost = false;
  #away = false;
  /** @type {Set<() => void>} */
  #listeners = new Set();

  /**
   * @param {Knobs} values of the controls
   * @param {(values: Knobs) => string} keyOf returns the key of a view
   * @param {Clock} [clock]
   */
  constructor(values, keyOf, clock = CLOCK) {
    this.#keyOf = keyOf;
    this.#clock = clock;
    this.#asked = { values, key: keyOf(values), since: clock.now(), until: Infinity };
  }

  /** Return the view that the controls ask for. @returns {Asked} */
  get asked() {
    return this.#asked;
  }

  /**
   * Return the knobs of the picture on the stage; before the first picture, those of the controls.
   * @returns {Knobs}
   */
  get values() {
    return (this.pictureOf ?? this.#asked).values;
  }

  /**
   * Return the view that the picture on the stage shows; null before the first picture.
   * @returns {Asked|null}
   */
  get pictureOf() {
    return (this.#cover ?? this.#picture)?.of ?? null;
  }

  /** Return the state of the stage. @returns {State} */
  get state() {
    if (this.#lost) return "trouble";
    if (this.#away && this.#picture && this.facts?.provisional !== false) return "away";
    if (this.facts) return this.facts.provisional ? "provisional" : "final";
    if (!this.pictureOf) return "loading";
    return this.#moving ? "moving" : "updating";
  }

  /**
   * Return the facts of the picture; null unless it is the full picture of the view that the
   * controls ask for.
   *
   * While the card's picture covers a provisional one of the server, only the state of its light is
   * returned: its error belongs to a picture that nobody sees.
   *
   * @returns {Facts|null}
   */
  get facts() {
    const picture = this.#picture;
    if (!picture?.facts || picture.draft || !this.#isAsked(picture.of)) return null;
    if (!this.#cover) return picture.facts;
    const waits = picture.facts.provisional && !this.#moving && this.#isAsked(this.#cover.of);
    return waits ? { ...picture.facts, error: NaN, p99: null, p99_interval: null } : null;
  }

  /**
   * Return the estimated time until the picture is final, less the time since it was estimated.
   * @returns {import("../view/format.js").Left|null}
   */
  get left() {
    return leftAfter(this.facts?.timeLeft ?? null, (this.#clock.now() - this.#cameAt) / 1000);
  }

  /**
   * Return the predicted error of the card's picture, if it shows the view that the controls ask
   * for.
   * @returns {number|null}
   */
  get predicted() {
    return this.#cover && this.#isAsked(this.#cover.of) ? this.#cover.predicted : null;
  }

  /**
   * Return true if the card's picture shows the view that the controls ask for, with shine by few
   * rays.
   * @returns {boolean}
   */
  get shines() {
    return Boolean(this.#cover?.shines && this.#isAsked(this.#cover.of));
  }

  /** Return true if the picture has all of the screen's pixels. @returns {boolean} */
  get sharp() {
    return this.#picture?.sharp ?? false;
  }

  /**
   * Return the time at which the controls left the picture on the stage; Infinity if they have not.
   * @returns {number}
   */
  get leftAt() {
    const of = this.pictureOf;
    return of && !this.#isAsked(of) ? of.until : Infinity;
  }

  /**
   * Return the time since which the controls wait for a full picture; Infinity if they do not.
   * @returns {number}
   */
  get waitsSince() {
    return this.#lost || this.#away || this.facts ? Infinity : this.#asked.since;
  }

  /**
   * Return true if a picture of view `of` would replace a picture of the view that the controls ask
   * for.
   * @param {Asked} of
   * @returns {boolean}
   */
  surpasses(of) {
    const shown = this.pictureOf;
    return shown !== null && this.#isAsked(shown) && !this.#isAsked(of);
  }

  /** Call `listener` after every change. @param {() => void} listener */
  subscribe(listener) {
    this.#listeners.add(listener);
  }

  /**
   * Change the controls.
   * @param {Knobs} values
   * @returns {boolean} true if they ask for another picture
   */
  ask(values) {
    const key = this.#keyOf(values);
    const other = key !== this.#asked.key;
    if (other) this.#leave(values, key);
    else this.#asked.values = values;
    return other;
  }

  /**
   * Note that the page is left for another one: its picture no longer is the one that was asked
   * for.
   */
  leave() {
    this.#leave(this.#asked.values, "");
  }

  /** Note that the view goes on changing, or rests. @param {boolean} moving */
  move(moving) {
    this.#moving = moving;
    this.#tell();
  }

  /** Note that a picture of the server is on the stage. @param {ShownPicture} picture */
  show(picture) {
    this.#picture = picture;
    this.#cameAt = this.#clock.now();
    this.#lost = false;
    this.#tell();
  }

  /**
   * Note that the card's picture lies over the server's.
   * @param {Cover} cover
   */
  cover({ of, predicted, shines }) {
    const same = this.#cover && this.#cover.of === of && this.#cover.predicted === predicted;
    if (same && !this.#lost) return;
    this.#cover = { of, predicted, shines };
    this.#lost = false;
    this.#tell();
  }

  /**
   * Note that the card's picture is gone, so that the server's last one is seen, whatever view it
   * shows.
   */
  uncover() {
    if (!this.#cover) return;
    this.#cover = null;
    this.#tell();
  }

  /**
   * Note that the server is away, or back. While it is away the page draws by itself.
   * @param {boolean} away
   */
  part(away) {
    this.#away = away;
    this.#lost &&= !away;
    this.#tell();
  }

  /** Note that the view that the controls ask for cannot be drawn. */
  lose() {
    this.#lost = true;
    this.#tell();
  }

  /**
   * Change the view that the controls ask for. A picture that shows the new view already is counted
   * as asked for.
   * @param {Knobs} values
   * @param {string} key
   */
  #leave(values, key) {
    this.#asked.until = this.#clock.now();
    this.#asked = { values, key, since: this.#clock.now(), until: Infinity };
    for (const each of [this.#picture, this.#cover])
      if (each && this.#isAsked(each.of)) each.of = this.#asked;
    this.#tell();
  }

  /** Return true if the controls ask for a view. @param {Asked} of */
  #isAsked({ key }) {
    return key === this.#asked.key;
  }

  /** Call all listeners. */
  #tell() {
    this.#listeners.forEach((listener) => listener());
  }
}
