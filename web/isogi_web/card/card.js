/**
 * Draws a scene on the visitor's graphics card: a class with few methods, independent of server and
 * page.
 *
 *     const card = Card.open(canvas);          // throws a Refusal: then the server draws
 *     await card.load(document.scene, slabs);  // GET …/card, and what `slabsOf` lists of it
 *     card.onlost = () => …;                   // the server draws until onrestored
 *     card.onrestored = () => …;
 *
 *     // Chunks of GET …/card/chunks whose light the card lacks; the answers of …/card/light
 *     // and …/card/transfer go to `take`.
 *     const { light, transfer } = card.lacking(chunks, turn);
 *     card.take(answer, turn);
 *
 *     card.draw(view, size);  // once per animation frame while anything moves
 *     card.refine();          // once per animation frame at rest, until it returns false
 *
 * `draw` returns false while the card is busy: call it again in the next animation frame. On a slow
 * card it draws fewer pixels. `refine` adds a sample to the last view at full size, band by band,
 * which smooths edges and penumbrae. Only `draw` sets the canvas's size: setting it clears the
 * canvas.
 */

import { Colours, joinColours } from "./colours.js";
import { BUDGET, Refusal, TRIAL_MS, openDevice, timeTrial } from "./device.js";
import { Drawing, keyOf, programsOf } from "./drawing.js";
import { turnLight } from "./light.js";
import { Pace } from "./pace.js";
import { SAMPLES } from "./picture.js";
import { readShader } from "./programs.js";
import { Shine, surroundingsIn } from "./shine.js";
import { Texels } from "./texels.js";
import { Volume, joinSlabs } from "./volume.js";

/** @typedef {import("./document.js").CardDocument} CardDocument */
/** @typedef {import("./drawing.js").View} View */
/** @typedef {import("./light.js").Quaternion} Quaternion */
/** @typedef {{at: string, version: string}} ListedChunk as `GET …/card/chunks` lists them */

const UNLIT = /^0+$/; // version of a chunk without light

/** Time after which a loss is forgotten; a card that is lost twice within it draws no more. */
const FORGIVEN_MS = 60_000;

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
    this.row = 0; // first row that the current sample of the last view still lacks
    this.lostAt = -Infinity;
    /** @type {Drawing|null} */
    this.drawing = null;
    /** @type {{view: View, size: [number, number], samples: number}|null} */
    this.last = null;
    canvas.addEventListener("webglcontextlost", (event) => this.#lose(event));
    canvas.addEventListener("webglcontextrestored", () => this.#restore());
  }

  /**
   * Open the card of a canvas that nothing else draws on.
   * @param {HTMLCanvasElement|OffscreenCanvas} canvas
   * @param {(name: string) => Promise<string>} [read] returns the text of a shader's file; by
   *   default it reads the files of this page
   * @returns {Card}
   * @throws {import("./device.js").Refusal} if this browser has no card that can draw
   */
  static open(canvas, read = readShader) {
    return new Card(canvas, openDevice(canvas), read);
  }

  /**
   * Return true if the card is quick enough to be of use.
   *
   * A small picture is timed: a processor that stands in for a card is too slow, whatever name it
   * reports.
   *
   * @returns {Promise<boolean>}
   */
  async isQuick() {
    return (await timeTrial(this.device.gl, this.readShader)) <= TRIAL_MS;
  }

  /**
   * Load a scene. The scene before is drawn until the new one is ready.
   * @param {CardDocument} document `scene` of a drawable one, of GET …/card
   * @param {ArrayBuffer[]|Promise<ArrayBuffer[]>} slabs of the volume, its colours and its
   *   surroundings, in the order of `slabsOf`; programs compile while slabs arrive
   * @throws {import("./device.js").Refusal} if the card's textures or memory are too small for the
   *   scene
   */
  async load(document, slabs) {
    const all = Promise.resolve(slabs);
    await this.#load(
      document,
      all.then((some) => joinSlabs(document, some)),
      all.then((some) => joinColours(document, some)),
      all.then((some) => surroundingsIn(document, some)),
    );
  }

  /**
   * Return true if the card was found to draw no pictures in a shading, so that the server must.
   * @param {string} shading
   * @returns {boolean}
   */
  refuses(shading) {
    return this.drawing?.refused.has(shading) ?? false;
  }

  /**
   * Return the chunks whose light or raw transfer is to be requested from the server.
   * @param {ListedChunk[]} chunks that a view reads
   * @param {Quaternion} turn rotation of the light
   * @returns {{light: string[], transfer: string[]}} parts of addresses, in the order of the list
   */
  lacking(chunks, turn) {
    if (!this.drawing) return { light: [], transfer: [] };
    const here = this.drawing.texels.chunks;
    const { takesRaw } = this.drawing.texels;
    const lit = chunks.filter(({ version }) => !UNLIT.test(version));
    const isHere = (/** @type {ListedChunk} */ { at, version }) =>
      here.get(at)?.version === version;
    // Folded light of another rotation is replaced, unless raw transfer is here, which serves any
    // rotation.
    const mayStay = (/** @type {ListedChunk} */ { at }) =>
      here.get(at)?.raw || here.get(at)?.lightKey === keyOf(turn);

    // Ask for raw transfer only of chunks whose folded light is already here: pictures come before
    // turns.
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
   * @param {Quaternion} turn rotation that folded light was requested with
   * @throws {Error} if the answer is damaged
   */
  take(answer, turn) {
    if (!this.drawing) return;
    const { quadric } = turnLight(this.drawing.document, turn);
    this.drawing.texels.take(answer, keyOf(turn), quadric);
    this.drawing.refold();
  }

  /**
   * Put light on the card that depends on no turn: transfer, and its texels without light.
   * @param {import("./blocks.js").Block[]} blocks
   */
  put(blocks) {
    if (!this.drawing) return;
    const { quadric } = turnLight(this.drawing.document, [1, 0, 0, 0]);
    this.drawing.texels.put(blocks, "", quadric);
    this.drawing.refold();
  }

  /**
   * Draw a moving view, in as many pixels as the card draws quickly.
   * @param {View} view
   * @param {{width: number, height: number}} [size] size of the canvas from now on, if the view is
   *   drawn
   * @returns {boolean} true if it was drawn; false if the card is lost, compiles, or is busy with
   *   the last view
   */
  draw(view, { width, height } = this.canvas) {
    const { canvas, drawing } = this;
    if (!drawing || this.lost || this.pace.busy || !drawing.isReady(view)) return false;
    if (canvas.width !== width || canvas.height !== height)
      Object.assign(canvas, { width, height });
    const size = this.#sizeAt(this.pace.share);
    drawing.sample(view, size, 0);
    drawing.show(view, size);
    this.last = { view, size, samples: 1 };
    this.row = 0;
    this.pace.timePicture(size[0] * size[1]);
    return true;
  }

  /**
   * Improve the picture of the last view by one band of a sample at full size. The canvas changes
   * after the last band of a sample.
   * @returns {boolean} true if there is more to do
   */
  refine() {
    if (!this.drawing || this.lost || !this.last) return false;
    const { view, size, samples } = this.last;
    const whole = this.#sizeAt(1);
    if (samples > SAMPLES) return false;
    if (this.pace.busy) return true;
    // A picture of fewer pixels cannot be refined: replace it by sample 0 at full size.
    const goesOn = size[0] === whole[0] && size[1] === whole[1];
    const n = goesOn ? samples : 0;
    const from = this.row;
    const to = from + this.pace.rowsOf(whole, whole[1] - from, n);
    // Show only whole samples, so that bands are not seen.
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
   * Read the pixels that the canvas shows of the last view.
   * @returns {Uint8Array} RGBA, rows from below
   */
  read() {
    const { gl } = this.device;
    const { width, height } = this.canvas;
    const pixels = new Uint8Array(4 * width * height);
    // The canvas may have been cleared since: show the picture again before reading it.
    if (this.drawing && this.last) this.drawing.show(this.last.view, this.last.size);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    return pixels;
  }

  /**
   * Return the canvas's size in pixels, scaled to a share of its width and height.
   * @param {number} share of the width, 0 to 1
   * @returns {[number, number]}
   */
  #sizeAt(share) {
    return [
      Math.max(Math.round(share * this.canvas.width), 1),
      Math.max(Math.round(share * this.canvas.height), 1),
    ];
  }

  /**
   * Load a scene, if no other load begins while it is prepared.
   * @param {CardDocument} document
   * @param {Promise<import("./cells.js").Voxels>} codes of the volume
   * @param {Promise<Uint8Array>} places colours by data, empty if there are none
   * @param {Promise<Uint16Array>} around surroundings that the surface mirrors, empty if it is
   *   diffuse
   * @param {import("./texels.js").Run[]} [runs] texels that were received before the card was lost
   */
  async #load(document, codes, places, around, runs) {
    const { gl } = this.device;
    const load = ++this.loads;
    const [programs, voxels, painted, mirrored] = await Promise.all([
      programsOf(gl, document, this.readShader),
      codes,
      places,
      around,
    ]);
    if (load !== this.loads) return; // another load began meanwhile
    const volume = new Volume(this.device, document, voxels);
    const texels = new Texels(this.device, document, BUDGET, runs);
    const colours = new Colours(this.device, document, painted);
    const shine = new Shine(this.device, document, mirrored);
    const parts = { volume, colours, shine, texels, programs };
    const drawing = new Drawing(this.device, document, parts);
    // WebGL reports a lack of memory only by an error code after the allocations.
    if (gl.getError() === gl.OUT_OF_MEMORY) {
      drawing.release();
      throw new Refusal("The graphics card has no memory left for this scene: the server draws.");
    }
    this.drawing?.release();
    this.drawing = drawing;
    this.last = null;
  }

  /**
   * Stop drawing: the driver has taken the card back, perhaps because a draw took long.
   *
   * The browser restores a card only if the event's default is prevented. After a second loss
   * within FORGIVEN_MS it is not, and the server draws from then on.
   *
   * @param {Event} event
   */
  #lose(event) {
    const forGood = performance.now() - this.lostAt < FORGIVEN_MS;
    this.lostAt = performance.now();
    if (!forGood) event.preventDefault();
    this.lost = true;
    this.onlost(forGood);
  }

  /**
   * Load the scene again on the restored card, with the texels that were received, and draw the
   * last view.
   */
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
        Promise.resolve(drawing.colours.source),
        Promise.resolve(drawing.shine.source),
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
