/**
 * What the stage shows, and what the controls ask for: whether both are one view, and since when
 * they are not.
 */

import { leftAfter } from "../view/format.js";
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
 *
 * @typedef {object} Cover the card's picture, which lies over the server's
 * @property {Asked} of the view that it is of
 * @property {number|null} predicted its relative error, where it can be told
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
  /** @type {Cover|null} */
  #cover = null;
  #cameAt = 0; // when the picture came
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
    return (this.pictureOf ?? this.#asked).values;
  }

  /**
   * The view that the picture on the stage is of; null before the first one.
   * @returns {Asked|null}
   */
  get pictureOf() {
    return (this.#cover ?? this.#picture)?.of ?? null;
  }

  /** @returns {State} */
  get state() {
    if (this.#lost) return "trouble";
    if (this.#away && this.#picture && this.facts?.provisional !== false) return "away";
    if (this.facts) return this.facts.provisional ? "provisional" : "final";
    if (!this.pictureOf) return "loading";
    return this.#moving ? "moving" : "updating";
  }

  /**
   * What may be said of the picture: nothing, unless it is the full one of the view that the
   * controls ask for. Where the card's lies over it, as it is not lit all over, that is how far its
   * light is, and not its error, which is of what nobody sees.
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
   * The time until the picture is done, as what was said of it stands now: it becomes less while
   * nothing comes.
   * @returns {import("../view/format.js").Left|null}
   */
  get left() {
    return leftAfter(this.facts?.timeLeft ?? null, (this.#clock.now() - this.#cameAt) / 1000);
  }

  /**
   * The predicted error of the picture that the graphics card drew of the view that the controls
   * ask for.
   * @returns {number|null}
   */
  get predicted() {
    return this.#cover && this.#isAsked(this.#cover.of) ? this.#cover.predicted : null;
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
    const of = this.pictureOf;
    return of && !this.#isAsked(of) ? of.until : Infinity;
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
    const shown = this.pictureOf;
    return shown !== null && this.#isAsked(shown) && !this.#isAsked(of);
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

  /** A picture of the server is on the stage now. @param {ShownPicture} picture */
  show(picture) {
    this.#picture = picture;
    this.#cameAt = this.#clock.now();
    this.#lost = false;
    this.#tell();
  }

  /**
   * The card's picture lies over the server's now.
   * @param {Cover} cover
   */
  cover({ of, predicted }) {
    const same = this.#cover && this.#cover.of === of && this.#cover.predicted === predicted;
    if (same && !this.#lost) return;
    this.#cover = { of, predicted };
    this.#lost = false;
    this.#tell();
  }

  /** The card's picture is gone: the server's last one is seen, whatever that is of. */
  uncover() {
    if (!this.#cover) return;
    this.#cover = null;
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
    for (const each of [this.#picture, this.#cover])
      if (each && this.#isAsked(each.of)) each.of = this.#asked;
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
