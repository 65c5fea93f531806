/** The picture on the stage: its size in pixels, and the exchange of frames without a flicker. */

import { sizeOf } from "../dom.js";

const LONGEST_SIDE = 1024; // pixels of a side while light is still converging

/** Pixels per CSS pixel while light is still converging: more would cost much and show little. */
const HIGHEST_RATIO = 1.5;
const SHORTEST_SIDE = 64; // pixels
const MOST_PIXELS = 1 << 22; // pixels that a server accepts

/**
 * Return the size of the picture that fills a box on a screen, times `scale`: all of the screen's
 * pixels if it is `sharp`, otherwise at most 1024 per side.
 * @param {number} width of the box, CSS pixels
 * @param {number} height of the box, CSS pixels
 * @param {number} ratio pixels of the screen per CSS pixel
 * @param {number} scale 1 for the full picture, less for drafts
 * @param {boolean} [sharp]
 * @returns {{width: number, height: number}}
 */
export function pictureSize(width, height, ratio, scale, sharp = false) {
  // While light converges, few pixels are enough; for a sharp picture, the server's limit counts,
  // with a margin for rounding up.
  const few = Math.min(ratio, HIGHEST_RATIO, LONGEST_SIDE / Math.max(width, height, 1));
  const all = Math.min(ratio, Math.sqrt(MOST_PIXELS / Math.max(width * height, 1)) * 0.999);
  const fit = (sharp ? all : few) * scale;
  const pixels = (/** @type {number} */ length) =>
    Math.max(SHORTEST_SIDE, Math.round(length * fit));
  return { width: pixels(width), height: pixels(height) };
}

/**
 * Shows one frame after the other in the stage's image, and drafts on a canvas over it, which shows
 * them sooner.
 */
export class Picture {
  #stage;
  #image;
  #canvas;
  /** True if all of the screen's pixels are requested: once a picture has its light. */
  sharp = false;
  #refused = false; // true if the server does not accept so many pixels
  #shown = 0; // number of frames, so that a slow one does not replace a newer one

  /**
   * @param {HTMLElement} stage box that the picture fills
   * @param {HTMLImageElement} image
   * @param {HTMLCanvasElement|null} [canvas] for drafts
   */
  constructor(stage, image, canvas = null) {
    this.#stage = stage;
    this.#image = image;
    this.#canvas = canvas;
  }

  /**
   * Return the size to request: that of the box on this screen.
   * @param {number} scale 1 for the full picture, less for drafts
   * @param {boolean} [sharp]
   * @returns {{width: number, height: number}}
   */
  size(scale, sharp = this.sharp) {
    const { width, height } = sizeOf(this.#stage);
    return pictureSize(width, height, window.devicePixelRatio || 1, scale, sharp);
  }

  /**
   * Request all of the screen's pixels from now on.
   * @returns {boolean} true if that is more than before
   */
  sharpen() {
    if (this.#refused) return false;
    const before = this.size(1).width;
    this.sharp = true;
    return this.size(1).width > before;
  }

  /** Request no more pixels than before from now on, as the server does not accept so many. */
  blunt() {
    this.sharp = false;
    this.#refused = true;
  }

  /**
   * Show a frame once it is decoded, unless a newer frame was shown meanwhile.
   * @param {Blob} blob encoded picture
   * @param {string} alt description of the picture
   * @returns {Promise<boolean>} true if it is shown now
   */
  async show(blob, alt) {
    const count = ++this.#shown;
    const address = URL.createObjectURL(blob);
    const decoded = await decode(address);
    if (!decoded || count !== this.#shown) {
      URL.revokeObjectURL(address);
      return false;
    }
    const old = this.#image.src;
    Object.assign(this.#image, { src: address, alt, hidden: false });
    this.#uncover();
    if (old.startsWith("blob:")) URL.revokeObjectURL(old);
    return true;
  }

  /**
   * Show a draft over the image until the next frame, unless a newer frame was shown meanwhile. The
   * first frame is shown in the image.
   * @param {Blob} blob encoded picture
   * @param {string} alt description of the picture
   * @returns {Promise<boolean>} true if it is shown now
   */
  async sketch(blob, alt) {
    const context = this.hidden ? null : this.#canvas?.getContext("bitmaprenderer");
    if (!context) return this.show(blob, alt);
    const count = ++this.#shown;
    const bitmap = await createImageBitmap(blob).catch(() => null);
    if (!bitmap || count !== this.#shown) {
      bitmap?.close();
      return false;
    }
    Object.assign(context.canvas, { width: bitmap.width, height: bitmap.height, hidden: false });
    context.transferFromImageBitmap(bitmap);
    this.#image.alt = alt;
    return true;
  }

  /** Hide the draft. */
  #uncover() {
    if (this.#canvas) this.#canvas.hidden = true;
  }

  /** Return true if nothing is shown. @returns {boolean} */
  get hidden() {
    return Boolean(this.#image.hidden);
  }

  /** Show nothing; a frame that is being decoded is dropped. */
  hide() {
    this.#shown += 1;
    this.#image.hidden = true;
    this.#uncover();
  }

  /**
   * Call `listener` when the size to request has changed.
   * @param {() => void} listener
   */
  onResize(listener) {
    let seen = "";
    new ResizeObserver(() => {
      const { width, height } = this.size(1);
      const now = `${width}×${height}`;
      if (seen && seen !== now) listener();
      seen = now;
    }).observe(this.#stage);
  }
}

/** Return true if the browser can decode the picture. @param {string} address */
async function decode(address) {
  const image = new Image();
  image.src = address;
  return image.decode().then(
    () => true,
    () => false,
  );
}
