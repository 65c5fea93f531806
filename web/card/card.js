/** Draws a scene on the visitor's graphics card: a class with few methods, which knows no server and no page.
 *
 *     const card = await Card.open(canvas);                    // throws a Refusal: let the server
 * draw
 *     await card.load(document.scene, slabs);                  // GET …/card, and the voxels that
 * it links to
 *     card.onlost = () => …; card.onrestored = () => …;        // the server draws between
 *     const { light, transfer } = card.lacking(chunks, turn);  // of GET …/card/chunks: what to ask
 * the server for
 *     card.take(answer, turn);                                 // an answer of …/card/light or
 * …/card/transfer
 *     card.draw(view, size);                                   // while anything moves, once an
 * animation frame
 *     card.refine();                                           // at rest, once an animation frame,
 * until it says false
 *
 * `draw` says false while the card is busy: ask again in the next animation frame. It draws fewer
 * pixels while the card is
 * slow. `refine` adds a sample to the last view at full size, band by band: edges and half-shadows
 * come smooth. The canvas
 * gets the size that a view is drawn with, since another one makes it black; to draw is all that
 * may change its content.
 */

import { BUDGET, Refusal, TRIAL_MS, openDevice, timeTrial } from "./device.js";
import { Drawing, keyOf, programsOf } from "./drawing.js";
import { turnLight } from "./light.js";
import { Pace } from "./pace.js";
import { SAMPLES } from "./picture.js";
import { readShader } from "./programs.js";
import { Texels } from "./texels.js";
import { Volume, joinSlabs } from "./volume.js";

/** @typedef {import("./document.js").CardDocument} CardDocument */
/** @typedef {import("./drawing.js").View} View */
/** @typedef {import("./light.js").Quaternion} Quaternion */
/** @typedef {{at: string, version: string}} ListedChunk as `GET …/card/chunks` lists them */

const UNLIT = /^0+$/; // version of a chunk without light
const FORGIVEN_MS = 60_000; // after a loss; a card that is lost once more before draws no longer

/** A graphics card that draws one scene. */
export class Card {
  /**
   * @param {HTMLCanvasElement|OffscreenCanvas} canvas
   * @param {import("./device.js").Device} device
   * @param {(name: string) => Promise<string>} readShader text of a shader's file
   */
  constructor(canvas, device, readShader) {
    this.canvas = canvas;
    this.device = device;
    this.readShader = readShader;
    this.lost = false;
    this.onlost = (/** @type {boolean} */ _forGood) => {};
    this.onrestored = () => {};
    this.pace = new Pace(device.gl);
    this.loads = 0;
    this.row = 0; // from which on the next sample of the last view is still to be drawn
    this.lostAt = -Infinity;
    /** @type {Drawing|null} */
    this.drawing = null;
    /** @type {{view: View, size: [number, number], samples: number}|null} */
    this.last = null;
    canvas.addEventListener("webglcontextlost", (event) => this.#lose(event));
    canvas.addEventListener("webglcontextrestored", () => this.#restore());
  }

  /**
   * Open the card behind a canvas that nobody else draws on.
   * @param {HTMLCanvasElement|OffscreenCanvas} canvas
   * @param {(name: string) => Promise<string>} [read] text of a shader's file, by default beside
   *   these modules
   * @returns {Card}
   * @throws {import("./device.js").Refusal} where this browser has no card that can draw
   */
  static open(canvas, read = readShader) {
    return new Card(canvas, openDevice(canvas), read);
  }

  /**
   * Whether the card draws quickly enough to be of use; the processor that stands in for one does
   * not, by whatever name.
   * @returns {Promise<boolean>}
   */
  async isQuick() {
    return (await timeTrial(this.device.gl, this.readShader)) <= TRIAL_MS;
  }

  /**
   * Load a scene in place of the one before, which is drawn until then.
   * @param {CardDocument} document `scene` of a drawable one
   * @param {ArrayBuffer[]|Promise<ArrayBuffer[]>} slabs of its volume, in the order of the
   *   document; programs are compiled
   *   while they come
   * @throws {import("./device.js").Refusal} where the card's textures or its memory are too small
   *   for it
   */
  async load(document, slabs) {
    await this.#load(
      document,
      Promise.resolve(slabs).then((all) => joinSlabs(document, all)),
    );
  }

  /**
   * Which of some chunks to ask the server for: folded light, and raw transfer of chunks whose
   * folded light is here.
   * @param {ListedChunk[]} chunks that a view reads
   * @param {Quaternion} turn of the light that is asked for
   * @returns {{light: string[], transfer: string[]}} parts of addresses, in the order of the list
   */
  lacking(chunks, turn) {
    if (!this.drawing) return { light: [], transfer: [] };
    const here = this.drawing.texels.chunks;
    const { takesRaw } = this.drawing.texels;
    const lit = chunks.filter(({ version }) => !UNLIT.test(version));
    const isHere = (/** @type {ListedChunk} */ { at, version }) =>
      here.get(at)?.version === version;
    const mayStay = (/** @type {ListedChunk} */ { at }) =>
      here.get(at)?.raw || here.get(at)?.lightKey === keyOf(turn);
    return {
      light: lit.filter((chunk) => !isHere(chunk) || !mayStay(chunk)).map(addressOf),
      transfer: takesRaw
        ? lit.filter((chunk) => isHere(chunk) && !here.get(chunk.at)?.raw).map(addressOf)
        : [],
    };
  }

  /**
   * Take an answer of the server: blocks of folded light or of transfer.
   * @param {ArrayBuffer} answer
   * @param {Quaternion|null} turn of the light that it was asked for by; null for transfer in few
   *   bits, which is of none
   * @param {readonly number[]} [steps] of its codes, where it is in few bits
   */
  take(answer, turn, steps) {
    if (!this.drawing) return;
    const { quadric } = turnLight(this.drawing.document, turn ?? [1, 0, 0, 0]);
    this.drawing.texels.take(answer, turn ? keyOf(turn) : "", quadric, steps);
    this.drawing.refold();
  }

  /**
   * Draw a view that moves, in as many pixels as the card draws quickly.
   * @param {View} view
   * @param {{width: number, height: number}} [size] of the canvas from now on, if it is drawn
   * @returns {boolean} whether it was drawn; else the card is lost, compiles, or is busy with the
   *   view before
   */
  draw(view, { width, height } = this.canvas) {
    const { canvas, drawing } = this;
    if (!drawing || this.lost || this.pace.busy || !drawing.isReady(view)) return false;
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const size = this.#sizeAt(this.pace.share);
    drawing.sample(view, size, 0);
    drawing.show(view, size);
    this.last = { view, size, samples: 1 };
    this.row = 0;
    this.pace.timePicture(size[0] * size[1]);
    return true;
  }

  /**
   * Draw the last view better: a band of it in all pixels, and with a sample more. What is shown
   * changes with the last band of a sample.
   * @returns {boolean} whether there is more to do
   */
  refine() {
    if (!this.drawing || this.lost || !this.last) return false;
    const { view, size, samples } = this.last;
    const whole = this.#sizeAt(1);
    if (samples > SAMPLES) return false;
    if (this.pace.busy) return true;
    const goesOn = size[0] === whole[0] && size[1] === whole[1];
    const n = goesOn ? samples : 0;
    const from = this.row;
    const to = from + this.pace.rowsOf(whole, whole[1] - from, n);
    const isLast = to === whole[1];
    this.drawing.sample(view, whole, n, [from, to]);
    this.row = isLast ? 0 : to;
    if (isLast) {
      this.drawing.show(view, whole);
      this.last = { view, size: whole, samples: n + 1 };
    }
    this.pace.timeBand(whole[0] * (to - from), n, isLast);
    return this.last.samples <= SAMPLES;
  }

  /**
   * What the canvas shows of the last view.
   * @returns {Uint8Array} RGBA, rows from below
   */
  read() {
    const { gl } = this.device;
    const { width, height } = this.canvas;
    const pixels = new Uint8Array(4 * width * height);
    if (this.drawing && this.last) this.drawing.show(this.last.view, this.last.size);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    return pixels;
  }

  /**
   * Pixels of the canvas at a share of its width.
   * @param {number} share
   * @returns {[number, number]}
   */
  #sizeAt(share) {
    return [
      Math.max(Math.round(share * this.canvas.width), 1),
      Math.max(Math.round(share * this.canvas.height), 1),
    ];
  }

  /**
   * @param {CardDocument} document
   * @param {Promise<import("./cells.js").Voxels>} codes
   * @param {import("./texels.js").Run[]} [runs]
   */
  async #load(document, codes, runs) {
    const { gl } = this.device;
    const load = ++this.loads;
    const [programs, voxels] = await Promise.all([programsOf(gl, document, this.readShader), codes]);
    if (load !== this.loads) return; // another scene was asked for meanwhile
    const volume = new Volume(this.device, document, voxels);
    const texels = new Texels(this.device, document, BUDGET, runs);
    const drawing = new Drawing(this.device, document, volume, texels, programs);
    if (gl.getError() === gl.OUT_OF_MEMORY) {
      drawing.release();
      throw new Refusal("The graphics card has no memory left for this scene: the server draws.");
    }
    this.drawing?.release();
    this.drawing = drawing;
    this.last = null;
  }

  /**
   * The card is lost: to its driver, which may have taken it back for a draw that was long. One
   * that is lost again soon is not asked to come back.
   * @param {Event} event
   */
  #lose(event) {
    const forGood = performance.now() - this.lostAt < FORGIVEN_MS;
    this.lostAt = performance.now();
    if (!forGood) event.preventDefault();
    this.lost = true;
    this.onlost(forGood);
  }

  async #restore() {
    const { drawing } = this;
    const shown = this.last;
    this.drawing = null; // its textures and programs went with the context
    this.device = openDevice(this.canvas);
    this.pace.restart(this.device.gl);
    if (drawing)
      await this.#load(
        drawing.document,
        Promise.resolve(drawing.volume.source),
        drawing.texels.runs,
      );
    this.lost = false;
    if (shown) this.draw(shown.view);
    this.onrestored();
  }
}

/** A chunk with its version, as addresses have it. @param {ListedChunk} chunk @returns {string} */
function addressOf({ at, version }) {
  return `${at}-${version}`;
}
