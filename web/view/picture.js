/** The picture on the stage: its size in pixels, and swapping frames without a flicker. */

import { sizeOf } from "../dom.js";

const LONGEST_SIDE = 1024;
// of a picture whose light is still to come: finer costs much and shows little
const HIGHEST_RATIO = 1.5;
const SHORTEST_SIDE = 64;
const MOST_PIXELS = 1 << 22; // that a server takes

/**
 * Pixels of the picture that fills a box on a screen, times `scale`: all that the screen has where
 * it is `sharp`, else
 * no more than 1024 a side.
 * @param {number} width of the box, CSS pixels
 * @param {number} height of the box, CSS pixels
 * @param {number} ratio pixels of the screen in a CSS pixel
 * @param {number} scale 1 for the full picture, less for drafts
 * @param {boolean} [sharp]
 * @returns {{width: number, height: number}}
 */
export function pictureSize(width, height, ratio, scale, sharp = false) {
  const few = Math.min(ratio, HIGHEST_RATIO, LONGEST_SIDE / Math.max(width, height, 1));
  const all = Math.min(ratio, Math.sqrt(MOST_PIXELS / Math.max(width * height, 1)) * 0.999);
  const fit = (sharp ? all : few) * scale;
  const pixels = (/** @type {number} */ length) =>
    Math.max(SHORTEST_SIDE, Math.round(length * fit));
  return { width: pixels(width), height: pixels(height) };
}

/**
 * Shows one frame after the other in the stage's image, and drafts on a canvas over it, where they
 * are sooner.
 */
export class Picture {
  #stage;
  #image;
  #canvas;
  /** Whether all of the screen's pixels are asked for: once a picture has its light. */
  sharp = false;
  #refused = false;
  #shown = 0; // counts frames, so that a slow one does not overtake a newer one

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
   * Pixels to ask for: those of the box on this screen.
   * @param {number} scale 1 for the full picture, less for drafts
   * @param {boolean} [sharp]
   * @returns {{width: number, height: number}}
   */
  size(scale, sharp = this.sharp) {
    const { width, height } = sizeOf(this.#stage);
    return pictureSize(width, height, window.devicePixelRatio || 1, scale, sharp);
  }

  /** Ask for all of the screen's pixels from now on. @returns {boolean} whether that is more */
  sharpen() {
    if (this.#refused) return false;
    const before = this.size(1).width;
    this.sharp = true;
    return this.size(1).width > before;
  }

  /** The server does not take so many pixels: ask for no more than before, from now on. */
  blunt() {
    this.sharp = false;
    this.#refused = true;
  }

  /**
   * Show a frame once it is decoded; one that a newer frame has overtaken is dropped.
   * @param {Blob} blob encoded picture
   * @param {string} alt what it shows, in words
   * @returns {Promise<boolean>} whether it is shown now
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
   * Show a draft over the image, until that has its next frame; dropped as `show` does. The first
   * frame of all is the
   * image's own.
   * @param {Blob} blob encoded picture
   * @param {string} alt what it shows, in words
   * @returns {Promise<boolean>} whether it is shown now
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

  #uncover() {
    if (this.#canvas) this.#canvas.hidden = true;
  }

  /** Whether nothing is shown. @returns {boolean} */
  get hidden() {
    return Boolean(this.#image.hidden);
  }

  /** Show nothing, also not what is being decoded. */
  hide() {
    this.#shown += 1;
    this.#image.hidden = true;
    this.#uncover();
  }

  /**
   * Call `listener` when the box has changed its size.
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

/** Whether the browser can show the picture. @param {string} address */
async function decode(address) {
  const image = new Image();
  image.src = address;
  return image.decode().then(
    () => true,
    () => false,
  );
}
