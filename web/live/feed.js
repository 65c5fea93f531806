/**
 * Light of texels for the card: what its view reads, most visible first, and as transfer once the
 * light is turned.
 */

import { CLOCK } from "../net/trouble.js";
import { fromAngles } from "../view/rotation.js";
import { anglesOf } from "./view.js";

/** @typedef {import("../documents.js").CardChunk} CardChunk */
/** @typedef {import("../view/model.js").Knobs} Knobs */
/** @typedef {import("../view/rotation.js").Angles} Angles */

/**
 * @typedef {object} Wanted what a view reads
 * @property {CardChunk[]} chunks most visible first
 * @property {Knobs} values
 * @property {boolean} moving
 * @property {Set<string>} asked what was asked for: a chunk that grew meanwhile comes with a
 *   version of the next list
 */

/**
 * @typedef {object} LightCard what of a card takes light
 * @property {(chunks: CardChunk[], turn: import("../card/light.js").Quaternion) => {light:
 *   string[], transfer: string[]}} lacking
 * @property {(answer: ArrayBuffer, turn: import("../card/light.js").Quaternion) => void} take
 */

// chunks of a request: the most visible ones are soon on the screen
const [FIRST, TOGETHER] = [16, 64];
const AGAIN_MS = 2000; // until light that converges is brought again; each time twice as long

/** Keeps the light on a card up with the views that it draws. */
export class Feed {
  #card;
  #ask;
  #onLight;
  /** How the light is turned that the records are folded by. @type {Angles} */
  #turn;
  /** @type {Wanted|null} */
  #wanted = null;
  #clock;
  /**
   * When light of a chunk may be brought again that is not final, and how long that waited, by its
   * place.
   * @type {Map<string, {due: number, wait: number}>}
   */
  #here = new Map();
  #working = false;
  #closed = false;

  /**
   * @param {LightCard} card
   * @param {(what: "light"|"transfer", chunks: string[], turn: Angles) => Promise<ArrayBuffer>} ask
   * @param {Angles} turn of the light at first
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
   * Bring what some chunks lack; the newest list counts.
   * @param {CardChunk[]} chunks that a view reads, most visible first
   * @param {Knobs} values of the view
   * @param {boolean} moving
   */
  async bring(chunks, values, moving) {
    this.#wanted = { chunks, values, moving, asked: new Set() };
    if (this.#working) return;
    this.#working = true;
    try {
      while (this.#wanted && !this.#closed) await this.#step(this.#wanted);
    } finally {
      this.#working = false;
    }
  }

  /** Bring nothing more: the card shows another scene, or none. */
  close() {
    this.#closed = true;
  }

  /** Bring the next few chunks that the newest list lacks. @param {Wanted} wanted */
  async #step(wanted) {
    const next = this.#next(wanted);
    if (!next) {
      if (wanted === this.#wanted) this.#wanted = null;
      return;
    }
    next.chunks.forEach((name) => wanted.asked.add(`${next.what} ${name}`));
    const answer = await this.#ask(next.what, next.chunks, this.#turn);
    if (this.#closed) return;
    next.chunks.forEach((name) => this.#note(placeOf(name)));
    this.#card.take(answer, fromAngles(this.#turn));
    this.#onLight();
  }

  /**
   * What to ask for next: chunks of which nothing is here, or that are final, and others ever more
   * rarely. Light that
   * converges is filtered as it is folded, and so a view at rest in a turned light has it folded
   * once more; of light that
   * is final transfer serves all turns.
   * @param {Wanted} wanted
   * @returns {{what: "light"|"transfer", chunks: string[]}|null}
   */
  #next({ chunks, values, moving, asked }) {
    const isTurned = JSON.stringify(anglesOf(values)) !== JSON.stringify(this.#turn);
    if (isTurned && !moving && chunks.some(({ final }) => !final)) {
      this.#turn = anglesOf(values);
      this.#here.clear();
    }
    const { light, transfer } = this.#card.lacking(chunks, fromAngles(this.#turn));
    const final = new Set(
      chunks.filter((each) => each.final).map(({ at, version }) => `${at}-${version}`),
    );
    const due = light.filter((name) => final.has(name) || this.#isDue(placeOf(name)));
    const lasting = isTurned ? transfer.filter((name) => final.has(name)) : [];
    for (const [what, names] of /** @type {const} */ ([
      ["light", due],
      ["transfer", lasting],
    ])) {
      const left = names.filter((name) => !asked.has(`${what} ${name}`));
      if (left.length) return { what, chunks: left.slice(0, asked.size ? TOGETHER : FIRST) };
    }
    return null;
  }

  /** Whether light that converges is to be brought. @param {string} place */
  #isDue(place) {
    return this.#clock.now() >= (this.#here.get(place)?.due ?? -Infinity);
  }

  /** Light of a chunk was brought. @param {string} place */
  #note(place) {
    const wait = 2 * (this.#here.get(place)?.wait ?? AGAIN_MS / 2);
    this.#here.set(place, { due: this.#clock.now() + wait, wait });
  }
}

/** The place of a chunk that is named with its version. @param {string} name @returns {string} */
function placeOf(name) {
  return name.split("-")[0];
}
