/**
 * Requests light of texels for the card: the light that its view reads, most visible chunks first,
 * and raw transfer once the light is rotated.
 */

import { CLOCK } from "../net/trouble.js";
import { fromAngles } from "../view/rotation.js";
import { anglesOf } from "./view.js";

/** @typedef {import("../documents.js").CardChunk} CardChunk */
/** @typedef {import("../view/model.js").Knobs} Knobs */
/** @typedef {import("../view/rotation.js").Angles} Angles */

/**
 * @typedef {object} Wanted chunks that a view reads
 * @property {CardChunk[]} chunks most visible first
 * @property {Knobs} values
 * @property {boolean} moving
 * @property {Set<string>} asked requests that were made for this list: no chunk is requested twice,
 *   as a version that is newer than the list is named by the next one
 */

/**
 * @typedef {object} LightCard the methods of a card that take light
 * @property {(chunks: CardChunk[], turn: import("../card/light.js").Quaternion) => {light:
 *   string[], transfer: string[]}} lacking
 * @property {(answer: ArrayBuffer, turn: import("../card/light.js").Quaternion) => void} take
 */

/** Chunks of the first request of a list, so that the most visible ones arrive soon. */
const FIRST = 16;

/** Chunks of each later request. */
const TOGETHER = 64;

/** Time until converging light is requested again; it doubles with each request. */
const AGAIN_MS = 2000;

/** Supplies the card with the light of the views that it draws. */
export class Feed {
  #card;
  #ask;
  #onLight;
  /** Rotation of the light that the card's records are folded with. @type {Angles} */
  #turn;
  /** @type {Wanted|null} */
  #wanted = null;
  #clock;
  /**
   * Per place of a chunk whose light is not final: time of its next request, and the wait before
   * it.
   * @type {Map<string, {due: number, wait: number}>}
   */
  #here = new Map();
  /** Isovalue of the last view at rest. */
  #isovalue = NaN;
  #working = false;
  #closed = false;

  /**
   * @param {LightCard} card
   * @param {(what: "light"|"transfer", chunks: string[], turn: Angles, values: Knobs) =>
   *   Promise<ArrayBuffer>} ask requests chunks of one kind under a rotation, for a view
   * @param {Angles} turn rotation of the light at first
   * @param {() => void} onLight is called when the card has new light
   * @param {import("../net/trouble.js").Clock} [clock]
   */
  constructor(card, ask, turn, onLight, clock = CLOCK) {
    this.#card = card;
    this.#ask = ask;
    this.#turn = anglesOf(turn);
    this.#onLight = onLight;
    this.#clock = clock;
  }

  /**
   * Request the light that some chunks lack. A newer list replaces an older one that is still being
   * worked on.
   * @param {CardChunk[]} chunks that a view reads, most visible first
   * @param {Knobs} values of the view
   * @param {boolean} moving true if the view goes on changing
   */
  async bring(chunks, values, moving) {
    // Light of pinned surfaces is another at each isovalue: what comes for one says nothing about
    // when that of the next is due.
    if (!moving && values.isovalue !== this.#isovalue) {
      this.#here.clear();
      this.#isovalue = values.isovalue;
    }
    this.#wanted = { chunks, values, moving, asked: new Set() };
    if (this.#working) return;
    this.#working = true;
    try {
      while (this.#wanted && !this.#closed) await this.#step(this.#wanted);
    } finally {
      this.#working = false;
    }
  }

  /** Request nothing more, as the card shows another scene, or none. */
  close() {
    this.#closed = true;
  }

  /**
   * Request the next few chunks that the newest list lacks, and hand them to the card.
   * @param {Wanted} wanted
   */
  async #step(wanted) {
    const next = this.#next(wanted);
    if (!next) {
      // The list is done, unless a newer one came meanwhile.
      if (wanted === this.#wanted) this.#wanted = null;
      return;
    }
    next.chunks.forEach((name) => wanted.asked.add(`${next.what} ${name}`));
    const answer = await this.#ask(next.what, next.chunks, this.#turn, wanted.values);
    if (this.#closed) return;
    // An answer for a view that slid on says nothing about the light of the view that rests.
    const { values, moving } = this.#wanted ?? wanted;
    if (moving || values.isovalue === wanted.values.isovalue)
      next.chunks.forEach((name) => this.#note(placeOf(name)));
    this.#card.take(answer, fromAngles(this.#turn));
    this.#onLight();
  }

  /**
   * Choose the next request: chunks that the card lacks or whose light has become final; converging
   * light again, at growing intervals.
   *
   * Converging light is filtered while the server folds it. A view that rests under rotated light
   * is therefore folded by the server again, with the new rotation. Of final light, raw transfer is
   * requested, which serves all rotations.
   *
   * @param {Wanted} wanted
   * @returns {{what: "light"|"transfer", chunks: string[]}|null} null if nothing is lacking
   */
  #next({ chunks, values, moving, asked }) {
    // A view at rest under another rotation needs converging light folded again, for the filter.
    const isTurned = JSON.stringify(anglesOf(values)) !== JSON.stringify(this.#turn);
    if (isTurned && !moving && chunks.some(({ final }) => !final)) {
      this.#turn = anglesOf(values);
      this.#here.clear();
    }

    // Request light that is final or due again, then transfer of final light once the visitor
    // rotates it.
    const { light, transfer } = this.#card.lacking(chunks, fromAngles(this.#turn));
    const final = new Set(
      chunks.filter((each) => each.final).map(({ at, version }) => `${at}-${version}`),
    );
    const due = light.filter((name) => final.has(name) || this.#isDue(placeOf(name)));
    const lasting = isTurned ? transfer.filter((name) => final.has(name)) : [];
    // Each list of chunks asks only once for a chunk; the first request is small.
    for (const [what, names] of /** @type {const} */ ([
      ["light", due],
      ["transfer", lasting],
    ])) {
      const left = names.filter((name) => !asked.has(`${what} ${name}`));
      if (left.length) return { what, chunks: left.slice(0, asked.size ? TOGETHER : FIRST) };
    }
    return null;
  }

  /** Return true if converging light of a place may be requested now. @param {string} place */
  #isDue(place) {
    return this.#clock.now() >= (this.#here.get(place)?.due ?? -Infinity);
  }

  /** Note that light of a chunk was received: double its wait. @param {string} place */
  #note(place) {
    const wait = 2 * (this.#here.get(place)?.wait ?? AGAIN_MS / 2);
    this.#here.set(place, { due: this.#clock.now() + wait, wait });
  }
}

/**
 * Return the place of a chunk from its name, which is place-version.
 * @param {string} name
 * @returns {string}
 */
function placeOf(name) {
  return name.split("-")[0];
}
