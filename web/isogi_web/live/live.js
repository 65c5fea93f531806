/**
 * Chooses the part that draws: the visitor's card draws moving views as far as it can, and the
 * server draws views at rest and everything else. The visitor need not choose.
 */

import { Refusal } from "../card/device.js";
import { isDrawn, isLocal, slabsOf } from "../card/document.js";
import { Trouble } from "../net/trouble.js";
import {
  AROUND_SHINY,
  MOST_DIFFER,
  MOST_DIFFER_SHINY,
  pixelsOf,
  shareThatDiffers,
} from "./check.js";
import { Feed } from "./feed.js";
import {
  albedoOf,
  cardView,
  chunksQuery,
  documentQuery,
  lightQuery,
  turnOf,
  viewNear,
} from "./view.js";

/** @typedef {import("../card/card.js").Card} Card */
/** @typedef {import("../documents.js").Card} CardFacts */
/** @typedef {import("../net/schemas.js").FrameQuery} FrameQuery */
/** @typedef {import("../documents.js").CardChunk} CardChunk */
/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {import("../view/model.js").Knobs} Knobs */
/** @typedef {import("../view/rotation.js").Angles} Angles */

const LIST_MS = 1000; // time between two lists of chunks of a moving view
const MOST_KNOWN = 256; // lists that are kept
const SLOW_MS = 250; // time that a card may be busy with one picture, at its smallest share
const SLOW_PICTURES = 4; // slow pictures in a row after which the server draws
const FADED_MS = 200; // time after which the card's picture has faded out

/**
 * @typedef {object} Source requests to the server
 * @property {(query: FrameQuery) => Promise<CardFacts>} document
 * @property {(href: string) => Promise<ArrayBuffer>} bytes
 * @property {(query: FrameQuery) => Promise<CardChunk[]>} chunks
 * @property {(what: "light"|"transfer", chunks: string[], query: FrameQuery) =>
 *   Promise<ArrayBuffer>} blocks
 *
 * @typedef {{key: string, look: string, albedo: import("../view/rotation.js").Vec3, facts:
 *   NonNullable<CardFacts["scene"]>, feed: Feed}} Loaded
 *   a scene on the card: the parameters that it depends on, the same without the albedo, the albedo
 *   of its light, and its document
 *
 * @typedef {object} LiveHooks
 * @property {() => Card} open opens the card; throws a Refusal if there is none
 * @property {() => {width: number, height: number}} size of the card's picture, pixels
 * @property {() => HTMLImageElement|null} [picture] returns the server's picture on the stage
 * @property {() => void} drawn is called when the card's picture of the newest view is on the stage
 * @property {() => void} [gone] is called when the card's picture has left the stage
 * @property {() => void} lost is called when the card draws no more, so that the server must draw
 *   the moving view
 * @property {(reason: string) => void} refused is called with the reason if the card does not draw
 *   although the address asks for it, or if it stops drawing
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
  /** Chunks of the newest list. @type {CardChunk[]} */
  #chunks = [];
  /** Isovalue that this list was asked for. */
  #listedAt = NaN;
  /**
   * Lists whose light is all final, by their request: the server would send the same list again.
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
   * The view at rest that the card is checked with, the time since then, and true once the card has
   * begun to draw it.
   * @type {{values: Knobs, since: number, begun: boolean}|null}
   */
  #check = null;
  /**
   * Shadings whose pictures were found right, with and without shine: each has a part of the shaders.
   * @type {Set<string>}
   */
  #checked = new Set();
  #unlit = false; // true while the scene was shown by local models alone: no light was asked for
  #final = false; // true if the server's picture at rest is final
  #busy = Infinity; // time since which the card refuses new pictures
  #slow = 0; // slow pictures in a row

  /**
   * @param {HTMLCanvasElement} canvas lies over the server's picture
   * @param {Scene} scene
   * @param {Source} source
   * @param {LiveHooks} hooks
   * @param {string|null} choice "card" or "server" to force one of them, null to let the page
   *   choose
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
   * Return true if the card draws this view while it moves. A view in another albedo is drawn too,
   * as a prediction; the colours of errors are not.
   * @param {Knobs} values
   * @returns {boolean}
   */
  draws(values) {
    if (this.#refused || this.#card?.lost || !this.#loaded) return false;
    if (values.overlay === "error") return false; // only the server knows the errors
    if (!isDrawn(values.shading) || this.#card?.refuses(values.shading)) return false;
    if (this.#unlit && !isLocal(values.shading)) return false; // its light was not asked for yet
    return (
      this.#has(values) ||
      (this.#loaded.look === this.#lookOf(values) &&
        this.#loaded.albedo.every((share) => share > 0))
    );
  }

  /**
   * Return true if the card has the light of this view.
   * @param {Knobs} values
   * @returns {boolean}
   */
  #has(values) {
    return this.#loaded?.key === this.#keyOf(values);
  }

  /**
   * Predict the relative error of the card's pictures: that of their light. Local models have none,
   * and of shine, which few rays show, it is not known.
   * @returns {number|null} null if it cannot be predicted
   */
  get predicted() {
    return this.shines ? null : this.#lightError;
  }

  /** Return true if the card's pictures show shine, by few rays. @returns {boolean} */
  get shines() {
    return Boolean(this.#values && this.#shinesIn(this.#values));
  }

  /** Return true if the card's picture of a view shows shine. @param {Knobs} values */
  #shinesIn({ shading, strength }) {
    return Boolean(this.#loaded?.facts.shine) && !isLocal(shading) && strength !== 0;
  }

  /** Return the name of what a check of a view's picture finds right. @param {Knobs} values */
  #checkedBy(values) {
    return this.#shinesIn(values) ? `${values.shading} shine` : values.shading;
  }

  /**
   * Predict the relative error of the light of the card's pictures: from the target of the light
   * and the error that the plan expects besides, once final light of all chunks of the view is
   * here.
   * @returns {number|null} null if it cannot be predicted
   */
  get #lightError() {
    if (!this.#card || !this.#loaded || !this.#values || !this.#has(this.#values)) return null;
    if (isLocal(this.#values.shading)) return 0;
    if (!this.#chunks.length || !this.#chunks.every(({ final }) => final)) return null;
    // Light of pinned surfaces is another at each isovalue.
    if (this.#loaded.facts.surfaces && this.#listedAt !== this.#values.isovalue) return null;
    const here = this.#card.drawing?.texels.chunks;
    const { target, expected } = this.#loaded.facts;
    return this.#chunks.every(({ at, version }) => here?.get(at)?.version === version)
      ? Math.hypot(target, expected)
      : null;
  }

  /** Return true if the card's picture is on the stage. @returns {boolean} */
  get shows() {
    return !this.#canvas.hidden && !this.#canvas.hasAttribute("data-faded");
  }

  /** Change the view: let the card draw it if it can. @param {Knobs} values */
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

  /** Note that the view goes on changing, or rests. @param {boolean} moving */
  move(moving) {
    this.#moving = moving;
    if (!moving && this.shows) this.#animate();
  }

  /**
   * Take note that the server's picture of a view at rest lies below the card's. Uncover it if all
   * of its pixels have light, and prepare the card for the next view.
   * @param {Knobs} values
   * @param {{provisional?: boolean, coverage: {provisional: number}}|null} facts facts of the
   *   server's picture
   * @param {CardChunk[]} [chunks] chunks that the picture reads, if the server named them
   */
  rest(values, facts, chunks) {
    // From now on the light of texels is asked for, as the server's picture stands below.
    if (!isLocal(values.shading)) this.#unlit = false;
    const card = this.draws(values) && this.#has(values);
    this.#values = values;
    this.#final = facts?.provisional === false;
    const isLit = this.#final || facts?.coverage.provisional === 0;
    if (values.overlay !== "none" || isLit) this.#fade();
    if (card && chunks) this.#bring(chunks, values);
    else if (card) this.#list(true);
    else this.#prepare(values);
    // A card that has not been checked yet is checked with this view.
    const isKnown = this.#checked.has(this.#checkedBy(values));
    if (!card || this.shows || isKnown || values.overlay !== "none") return;
    if (this.#check?.values !== values)
      this.#check = { values, since: performance.now(), begun: false };
    this.#animate();
  }

  /**
   * Load the scene of a view on the card, unless that is being done or cannot be done.
   * @param {Knobs} values
   */
  async #prepare(values) {
    const key = this.#keyOf(values);
    const isOurs = isDrawn(values.shading) && !this.#refused && !this.#card?.lost;
    if (!isOurs || this.#preparing === key) return;
    this.#preparing = key;
    try {
      // Open the card at the first scene, and ask the server if a card can draw this one.
      const card = this.#card ?? (await (this.#opening ??= this.#open()));
      const { scene: facts, reason } = await this.#source.document(
        documentQuery(this.#scene, values),
      );
      if (!facts) return this.#decline(reason);

      // Read the volume before the former scene is dropped, which is drawn until then.
      const slabs = await Promise.all(slabsOf(facts).map((href) => this.#source.bytes(href)));
      // Another view may have changed the scene while slabs arrived.
      if (this.#preparing !== key) return;
      this.#loaded?.feed.close();
      this.#loaded = null;
      this.#known.clear();
      await card.load(facts, slabs);
      // The card holds the other scene by now if one was prepared meanwhile.
      if (this.#preparing !== key) return;
      this.#checked.clear();
      this.#unlit = isLocal(values.shading);

      // Light is requested with the parameters of this view, at the isovalue that is shown by then;
      // transfer belongs to no rotation.
      const ask = (
        /** @type {"light"|"transfer"} */ what,
        /** @type {string[]} */ chunks,
        /** @type {Angles} */ turn,
        /** @type {Knobs} */ { isovalue },
      ) =>
        this.#source.blocks(
          what,
          chunks,
          lightQuery(this.#scene, facts, { ...values, isovalue }, what === "light" ? turn : null),
        );
      this.#loaded = {
        key,
        look: this.#lookOf(values),
        albedo: albedoOf(this.#scene, values),
        facts,
        feed: new Feed(card, ask, turnOf(this.#scene, facts, values), () => this.#refresh()),
      };
      this.#list(true);
    } catch (error) {
      this.#preparing = "";
      this.#opening = null;
      if (error instanceof Refusal) this.#refuse(error.message);
      // Trouble with the server is reported by the requests for its pictures.
      else if (!(error instanceof Trouble)) throw error;
    }
  }

  /**
   * Open the card, and check that it is quick enough, unless the address asks for the card.
   * @throws {Refusal} if there is no card, or a slow one
   */
  async #open() {
    const card = this.#hooks.open();
    card.onlost = (forGood) => this.#lose(forGood);
    card.onrestored = () => this.#refresh();
    if (this.#choice !== "card" && !(await card.isQuick()))
      throw new Refusal("This browser draws WebGL slowly: the server is faster, and draws.");
    this.#card = card;
    return card;
  }

  /** Let the server draw from now on. @param {string} reason */
  #refuse(reason) {
    this.#refused = true;
    this.#hide();
    this.#decline(reason);
  }

  /** Report why the card does not draw, if the address asks for the card. @param {string} reason */
  #decline(reason) {
    if (this.#choice === "card") this.#hooks.refused(reason);
  }

  /**
   * Let the server draw while the card is lost.
   * @param {boolean} forGood true if the card will not come back
   */
  #lose(forGood) {
    this.#hide();
    this.#hooks.lost();
    if (!forGood) return;
    this.#refused = true;
    this.#hooks.refused("The graphics card was lost twice within a minute: the server draws.");
  }

  /** Draw the view again, as there is more light. */
  #refresh() {
    if (this.#check) this.#check.begun = false;
    if (!this.#values || !(this.shows || this.#check)) return;
    this.#waiting = this.shows;
    this.#animate();
  }

  /** Draw in the next frame of the screen. */
  #animate() {
    if (!this.#frame) this.#frame = requestAnimationFrame(() => this.#draw());
  }

  /** Draw one frame of the screen: the newest view, or a refinement of the view at rest. */
  #draw() {
    this.#frame = 0;
    if (!this.#values || !this.#card || !this.#loaded) return;
    if (!this.draws(this.#values)) {
      // The card has refused the shading since it was asked for this view.
      if (this.#waiting && !this.#card.lost) {
        this.#waiting = false;
        this.#hide();
        this.#hooks.lost();
      }
      return;
    }
    // Without a new view, either check the card unseen or refine its picture.
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
   * Draw a view with the card, unless it is busy.
   * @param {Card} card
   * @param {Loaded} loaded
   * @param {Knobs} values
   * @returns {boolean} true if it was drawn
   */
  #drawn(card, { facts, albedo }, values) {
    return card.draw(cardView(this.#scene, facts, values, albedo), this.#hooks.size());
  }

  /**
   * Check the card at the first rest, below the server's picture: draw the view as well as the card
   * can once it has all of its light, and compare both. Shine is compared with the final picture, as
   * the server shows it by single rays before.
   * @param {Card} card
   */
  #prove(card) {
    const check = this.#check;
    const error = this.#lightError;
    if (!check || !this.#loaded || this.#moving || error === null) return;
    if (this.shines && !this.#final) return;
    // Begin only after the card's picture has faded out, as the canvas is about to change.
    const isSeen = performance.now() - check.since < FADED_MS;
    if (!isSeen && !check.begun) check.begun = this.#drawn(card, this.#loaded, check.values);
    if (!check.begun || card.refine()) {
      this.#animate();
      return;
    }
    const server = pixelsOf(this.#hooks.picture?.() ?? null, this.#canvas);
    const around = this.shines ? AROUND_SHINY : 0;
    const share = server && shareThatDiffers(card.read(), server, this.#canvas, error, around);
    if (share === null) return; // try again with another picture of the server
    this.#check = null;
    this.#checked.add(this.#checkedBy(check.values));
    if (share <= (this.shines ? MOST_DIFFER_SHINY : MOST_DIFFER)) return;
    const reason = `The graphics card draws ${Math.round(100 * share)} % of the pixels differently from the server: the server draws.`;
    this.#leave(reason);
    this.#hooks.refused(reason);
  }

  /** Show the picture of the newest view. */
  #put() {
    this.#waiting = false;
    this.#canvas.hidden = false;
    this.#canvas.removeAttribute("data-faded");
    this.#hooks.drawn();
    this.#time();
  }

  /** Let the server draw if the card was slow several times in a row. */
  #time() {
    this.#slow = performance.now() - this.#busy > SLOW_MS ? this.#slow + 1 : 0;
    this.#busy = Infinity;
    if (this.#slow < SLOW_PICTURES || this.#choice === "card") return;
    this.#leave("The graphics card is too slow.");
  }

  /** Let the server draw from now on, the moving view included. @param {string} reason */
  #leave(reason) {
    this.#refuse(reason);
    this.#hooks.lost();
  }

  /**
   * Request the list of chunks that the view reads, at most every LIST_MS while the view moves.
   * @param {boolean} [now] true to request it at once, for exactly this view
   */
  async #list(now = false) {
    const values = this.#values;
    const time = performance.now();
    if (!values || isLocal(values.shading)) return;
    if (!now && time - this.#listed < LIST_MS) return;
    this.#listed = time;
    const listed = now ? values : viewNear(values, this.#scene);
    try {
      const chunks = await this.#listOf(chunksQuery(this.#scene, listed, this.#hooks.size()));
      // A view that slid on, and rests, has a list of its own.
      const isPast = !this.#moving && this.#values?.isovalue !== values.isovalue;
      if (isPast && this.#loaded?.facts.surfaces) return;
      this.#bring(chunks, values);
    } catch (error) {
      if (!(error instanceof Trouble)) throw error;
    }
  }

  /**
   * Return the chunks that a view reads, and keep the list if all of its light is final.
   * @param {FrameQuery} query
   * @returns {Promise<CardChunk[]>}
   */
  async #listOf(query) {
    const key = JSON.stringify(query);
    const known = this.#known.get(key);
    if (known) return known;
    const chunks = await this.#source.chunks(query);
    if (this.#known.size === MOST_KNOWN) this.#known.clear();
    if (chunks.length && chunks.every(({ final }) => final)) this.#known.set(key, chunks);
    return chunks;
  }

  /**
   * Request the light of some chunks.
   * @param {CardChunk[]} chunks
   * @param {Knobs} listed view that they were asked for
   */
  #bring(chunks, listed) {
    if (!this.#loaded || !this.#values || isLocal(this.#values.shading)) return;
    this.#chunks = chunks;
    this.#listedAt = listed.isovalue;
    const { facts, feed } = this.#loaded;
    const values = { ...this.#values, ...turnOf(this.#scene, facts, this.#values) };
    feed.bring(chunks, values, this.#moving).catch((error) => {
      // After trouble with the server, the next list requests the light again.
      if (!(error instanceof Trouble)) this.#leave(error.message);
    });
  }

  /** Return a key of all parameters that the card's scene depends on. @param {Knobs} values */
  #keyOf(values) {
    return JSON.stringify(documentQuery(this.#scene, values));
  }

  /**
   * Return a key of all parameters that the card's scene depends on, except the albedo.
   * @param {Knobs} values
   */
  #lookOf(values) {
    return this.#keyOf({ ...values, albedo: undefined });
  }

  /**
   * Fade out the card's picture. A picture that is still waiting would cover the server's again:
   * drop it.
   */
  #fade() {
    this.#waiting = false;
    this.#canvas.setAttribute("data-faded", "");
    this.#hooks.gone?.();
  }

  /** Hide the card's picture. */
  #hide() {
    this.#canvas.hidden = true;
    this.#hooks.gone?.();
  }
}
