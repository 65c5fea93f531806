/**
 * Who draws: the visitor's card what moves, as far as it can; the server what rests, and all else.
 * Nobody chooses.
 */

import { Refusal } from "../card/device.js";
import { Trouble } from "../net/trouble.js";
import { MOST_DIFFER, pixelsOf, shareThatDiffers } from "./check.js";
import { Feed } from "./feed.js";
import {
  albedoOf,
  anglesOf,
  cardView,
  chunksQuery,
  documentQuery,
  lightQuery,
  viewNear,
} from "./view.js";

/** @typedef {import("../card/card.js").Card} Card */
/** @typedef {import("../documents.js").Card} CardFacts */
/** @typedef {import("../net/schemas.js").FrameQuery} FrameQuery */
/** @typedef {import("../documents.js").CardChunk} CardChunk */
/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {import("../view/model.js").Knobs} Knobs */
/** @typedef {import("../view/rotation.js").Angles} Angles */

const LIST_MS = 1000; // between two lists of chunks that a moving view reads
const MOST_KNOWN = 256; // lists that are kept
const SLOW_MS = 250; // that a card of no use is busy with a picture, of as few pixels as it draws
const SLOW_PICTURES = 4; // in a row, after which the server draws
const FADED_MS = 200; // after which nobody sees the card's picture any more

/**
 * @typedef {object} Source what the server is asked for
 * @property {(query: FrameQuery) => Promise<CardFacts>} document
 * @property {(href: string) => Promise<ArrayBuffer>} bytes
 * @property {(query: FrameQuery) => Promise<CardChunk[]>} chunks
 * @property {(what: "light"|"transfer", chunks: string[], query: FrameQuery) =>
 *   Promise<ArrayBuffer>} blocks
 *
 * @typedef {{key: string, look: string, albedo: import("../view/rotation.js").Vec3, facts:
 *   NonNullable<CardFacts["scene"]>, feed: Feed}} Loaded
 *   what the card has, what of a view that depends on, also but for the albedo, and that
 *
 * @typedef {object} LiveHooks
 * @property {() => Card} open opens the card; throws a Refusal where there is none
 * @property {() => {width: number, height: number}} size of the card's picture, pixels
 * @property {() => HTMLImageElement|null} [picture] the server's picture that is on the stage
 * @property {() => void} drawn the card's picture of the newest view is on the stage
 * @property {() => void} [gone] the card's picture is on the stage no more
 * @property {() => void} lost the card draws no more: the server is to draw the view that moves
 * @property {(reason: string) => void} refused why the card does not draw, which was asked for by
 *   force, or has drawn until now
 */

/** Draws the views of one scene by the card, as far as it can. */
export class Live {
  #canvas;
  #scene;
  #source;
  #hooks;
  #choice;
  /** @type {Card|null} */
  #card = null;
  /** @type {Promise<Card>|null} */
  #opening = null;
  /** @type {Loaded|null} */
  #loaded = null;
  /** What the newest list names. @type {CardChunk[]} */
  #chunks = [];
  /**
   * Lists of all final light, by what they were asked for by: asking once more would tell nothing
   * new.
   * @type {Map<string, CardChunk[]>}
   */
  #known = new Map();
  #preparing = "";
  #refused = false;
  /** @type {Knobs|null} */
  #values = null;
  #moving = false;
  #waiting = false; // for a picture of the newest view
  #frame = 0;
  #listed = -LIST_MS;
  /**
   * The view at rest by which the card is checked, since when, and whether the card has begun it.
   * @type {{values: Knobs, since: number, begun: boolean}|null}
   */
  #check = null;
  #isChecked = false;
  #busy = Infinity; // since when
  #slow = 0;

  /**
   * @param {HTMLCanvasElement} canvas over the server's picture
   * @param {Scene} scene
   * @param {Source} source
   * @param {LiveHooks} hooks
   * @param {string|null} choice "card", "server", or null for the page's own
   */
  constructor(canvas, scene, source, hooks, choice) {
    this.#canvas = canvas;
    this.#scene = scene;
    this.#source = source;
    this.#hooks = hooks;
    this.#choice = choice;
    this.#refused = choice === "server";
  }

  /**
   * Whether the card draws this view while it moves: also in another albedo, as predicted, but not
   * under the colours of errors.
   * @param {Knobs} values
   * @returns {boolean}
   */
  draws(values) {
    if (this.#refused || this.#card?.lost || !this.#loaded) return false;
    if (values.overlay === "error") return false; // colours that only the server knows
    return (
      this.#has(values) ||
      (this.#loaded.look === this.#lookOf(values) &&
        this.#loaded.albedo.every((share) => share > 0))
    );
  }

  /** Whether the card has the light of this view. @param {Knobs} values @returns {boolean} */
  #has(values) {
    return this.#loaded?.key === this.#keyOf(values);
  }

  /**
   * The error of the card's pictures, as far as it can be predicted: once light of all that the
   * view reads is here, and
   * final, by the light's target and what the plan expects besides.
   * @returns {number|null}
   */
  get predicted() {
    if (
      !this.#card ||
      !this.#loaded ||
      !this.#values ||
      !this.#has(this.#values) ||
      !this.#chunks.length
    )
      return null;
    if (!this.#chunks.every(({ final }) => final)) return null;
    const here = this.#card.drawing?.texels.chunks;
    const { target, expected } = this.#loaded.facts;
    return this.#chunks.every(({ at, version }) => here?.get(at)?.version === version)
      ? Math.hypot(target, expected)
      : null;
  }

  /** Whether the card's picture is on the stage. @returns {boolean} */
  get shows() {
    return !this.#canvas.hidden && !this.#canvas.hasAttribute("data-faded");
  }

  /** The view is now this one. @param {Knobs} values */
  show(values) {
    this.#values = values;
    this.#check = null;
    if (!this.draws(values)) {
      this.#hide();
      return;
    }
    this.#waiting = true;
    this.#animate();
    this.#list();
  }

  /** The view goes on changing, or rests. @param {boolean} moving */
  move(moving) {
    this.#moving = moving;
    if (!moving && this.shows) this.#animate();
  }

  /**
   * The server's picture of a view at rest is there, under the card's: lay it open where it shows
   * light all over, and
   * have the card ready for what comes next.
   * @param {Knobs} values
   * @param {{provisional?: boolean, coverage: {provisional: number}}|null} facts
   * @param {CardChunk[]} [chunks] that it reads, where the server named them
   */
  rest(values, facts, chunks) {
    const card = this.draws(values) && this.#has(values);
    this.#values = values;
    if (values.overlay !== "none" || facts?.provisional === false || facts?.coverage.provisional === 0)
      this.#fade();
    if (card && chunks) this.#bring(chunks);
    else if (card) this.#list(true);
    else this.#prepare(values);
    if (!card || this.shows || this.#isChecked || values.overlay !== "none") return;
    if (this.#check?.values !== values)
      this.#check = { values, since: performance.now(), begun: false };
    this.#animate();
  }

  /** Have the card take on what a view shows. @param {Knobs} values */
  async #prepare(values) {
    const key = this.#keyOf(values);
    if (values.shading !== "gi" || this.#refused || this.#preparing === key || this.#card?.lost)
      return;
    this.#preparing = key;
    try {
      const card = this.#card ?? (await (this.#opening ??= this.#open()));
      const { scene: facts, reason } = await this.#source.document(
        documentQuery(this.#scene, values),
      );
      if (!facts) return this.#decline(reason);
      const slabs = await Promise.all(
        facts.volume.slabs.map(({ href }) => this.#source.bytes(href)),
      );
      if (this.#preparing !== key) return;
      this.#loaded?.feed.close();
      this.#loaded = null;
      this.#known.clear();
      await card.load(facts, slabs);
      this.#isChecked = false;
      const ask = (
        /** @type {"light"|"transfer"} */ what,
        /** @type {string[]} */ chunks,
        /** @type {Angles} */ turn,
      ) =>
        this.#source.blocks(
          what,
          chunks,
          lightQuery(this.#scene, values, what === "light" ? turn : null),
        );
      this.#loaded = {
        key,
        look: this.#lookOf(values),
        albedo: albedoOf(this.#scene, values),
        facts,
        feed: new Feed(card, ask, anglesOf(values), () => this.#refresh()),
      };
      this.#list(true);
    } catch (error) {
      this.#preparing = "";
      this.#opening = null;
      if (error instanceof Refusal) this.#refuse(error.message);
      // the server's pictures say what is wrong with it
      else if (!(error instanceof Trouble)) throw error;
    }
  }

  /** Open the card, and see if it is of use; who asks for it by force has seen that. */
  async #open() {
    const card = this.#hooks.open();
    card.onlost = (forGood) => this.#lose(forGood);
    card.onrestored = () => this.#refresh();
    if (this.#choice !== "card" && !(await card.isQuick()))
      throw new Refusal("This browser draws WebGL slowly: the server is faster, and draws.");
    this.#card = card;
    return card;
  }

  /** This card does not draw, now and later. @param {string} reason */
  #refuse(reason) {
    this.#refused = true;
    this.#hide();
    this.#decline(reason);
  }

  /** Say why the card does not draw, to those who asked for it. @param {string} reason */
  #decline(reason) {
    if (this.#choice === "card") this.#hooks.refused(reason);
  }

  /** @param {boolean} forGood whether it was lost again and again */
  #lose(forGood) {
    this.#hide();
    this.#hooks.lost();
    if (!forGood) return;
    this.#refused = true;
    this.#hooks.refused("The graphics card was lost twice within a minute: the server draws.");
  }

  /** Draw the view once more: there is more light. */
  #refresh() {
    if (this.#check) this.#check.begun = false;
    if (!this.#values || !(this.shows || this.#check)) return;
    this.#waiting = this.shows;
    this.#animate();
  }

  #animate() {
    if (!this.#frame) this.#frame = requestAnimationFrame(() => this.#draw());
  }

  /** One frame of the screen: the newest view, or the one at rest a little better. */
  #draw() {
    this.#frame = 0;
    if (!this.#values || !this.#card || !this.#loaded || !this.draws(this.#values)) return;
    if (!this.#waiting) {
      if (!this.shows) this.#prove(this.#card);
      else if (!this.#moving && this.#card.refine()) this.#animate();
      return;
    }
    if (this.#drawn(this.#card, this.#loaded, this.#values)) this.#put();
    else this.#busy = Math.min(this.#busy, performance.now());
    this.#animate();
  }

  /**
   * Have the card draw a view, unless it is busy.
   * @param {Card} card
   * @param {Loaded} loaded
   * @param {Knobs} values
   * @returns {boolean} whether it does
   */
  #drawn(card, { facts, albedo }, values) {
    return card.draw(cardView(this.#scene, facts, values, albedo), this.#hooks.size());
  }

  /**
   * Check the card at the first rest, under the server's picture: once it has the light of that, it
   * draws the view as well as it can, and both are compared.
   * @param {Card} card
   */
  #prove(card) {
    const check = this.#check;
    if (!check || !this.#loaded || this.#moving || this.predicted === null) return;
    const isSeen = performance.now() - check.since < FADED_MS;
    if (!isSeen && !check.begun) check.begun = this.#drawn(card, this.#loaded, check.values);
    if (!check.begun || card.refine()) {
      this.#animate();
      return;
    }
    const server = pixelsOf(this.#hooks.picture?.() ?? null, this.#canvas);
    const share = server && shareThatDiffers(card.read(), server, this.#canvas, this.predicted);
    if (share === null) return; // another picture of the server may tell
    this.#check = null;
    this.#isChecked = true;
    if (share <= MOST_DIFFER) return;
    const reason = `The graphics card draws ${Math.round(100 * share)} % of the pixels unlike the server: the server draws.`;
    this.#leave(reason);
    this.#hooks.refused(reason);
  }

  /** The newest view is drawn: show it. */
  #put() {
    this.#waiting = false;
    this.#canvas.hidden = false;
    this.#canvas.removeAttribute("data-faded");
    this.#hooks.drawn();
    this.#time();
  }

  /** Leave pictures to the server where the card takes long for many in a row. */
  #time() {
    this.#slow = performance.now() - this.#busy > SLOW_MS ? this.#slow + 1 : 0;
    this.#busy = Infinity;
    if (this.#slow < SLOW_PICTURES || this.#choice === "card") return;
    this.#leave("The graphics card is too slow.");
  }

  /** Leave all pictures to the server, also that of the view that moves. @param {string} reason */
  #leave(reason) {
    this.#refuse(reason);
    this.#hooks.lost();
  }

  /** Ask which chunks the view reads: of one that moves now and then. @param {boolean} [now] */
  async #list(now = false) {
    const values = this.#values;
    const time = performance.now();
    if (!values || (!now && time - this.#listed < LIST_MS)) return;
    this.#listed = time;
    try {
      this.#bring(
        await this.#listOf(
          chunksQuery(this.#scene, now ? values : viewNear(values), this.#hooks.size()),
        ),
      );
    } catch (error) {
      if (!(error instanceof Trouble)) throw error;
    }
  }

  /** The chunks that a view reads. @param {FrameQuery} query @returns {Promise<CardChunk[]>} */
  async #listOf(query) {
    const key = JSON.stringify(query);
    const known = this.#known.get(key);
    if (known) return known;
    const chunks = await this.#source.chunks(query);
    if (this.#known.size === MOST_KNOWN) this.#known.clear();
    if (chunks.length && chunks.every(({ final }) => final)) this.#known.set(key, chunks);
    return chunks;
  }

  /** @param {CardChunk[]} chunks */
  #bring(chunks) {
    if (!this.#loaded || !this.#values) return;
    this.#chunks = chunks;
    this.#loaded.feed.bring(chunks, this.#values, this.#moving).catch((error) => {
      // of trouble, the next list asks again
      if (!(error instanceof Trouble)) this.#leave(error.message);
    });
  }

  /** What the card has depends on it. @param {Knobs} values */
  #keyOf(values) {
    return JSON.stringify(documentQuery(this.#scene, values));
  }

  /** What the card has depends on it, but for the albedo. @param {Knobs} values */
  #lookOf(values) {
    return this.#keyOf({ ...values, albedo: undefined });
  }

  /** Let the server's picture through, softly; what still waited to be drawn would lie over it. */
  #fade() {
    this.#waiting = false;
    this.#canvas.setAttribute("data-faded", "");
    this.#hooks.gone?.();
  }

  #hide() {
    this.#canvas.hidden = true;
    this.#hooks.gone?.();
  }
}
