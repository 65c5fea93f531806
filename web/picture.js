/** The picture on the stage: its size in pixels, and swapping frames without a flicker. */

const LONGEST_SIDE = 1024;
const HIGHEST_RATIO = 1.5; // finer than this costs much and shows little
const SHORTEST_SIDE = 64;

/** Shows one frame after the other in the stage's image. */
export class Picture {
  #stage;
  #image;
  #turn = 0;

  /**
   * @param {HTMLElement} stage box that the picture fills
   * @param {HTMLImageElement} image
   */
  constructor(stage, image) {
    this.#stage = stage;
    this.#image = image;
  }

  /**
   * Pixels to ask for: those of the box on this screen, no more than 1024 a side, times `scale`.
   * @param {number} scale 1 for the full picture, less for drafts
   * @returns {{width: number, height: number}}
   */
  size(scale) {
    const { clientWidth, clientHeight } = this.#stage;
    const ratio = Math.min(window.devicePixelRatio || 1, HIGHEST_RATIO);
    const fit = Math.min(ratio, LONGEST_SIDE / Math.max(clientWidth, clientHeight, 1)) * scale;
    const side = (length) => Math.max(SHORTEST_SIDE, Math.round(length * fit));
    return { width: side(clientWidth), height: side(clientHeight) };
  }

  /**
   * Show a frame once it is decoded; one that a newer frame has overtaken is dropped.
   * @param {Blob} blob encoded picture
   * @param {string} alt what it shows, for who cannot see it
   * @returns {Promise<boolean>} whether it is shown now
   */
  async show(blob, alt) {
    const turn = ++this.#turn;
    const address = URL.createObjectURL(blob);
    const decoded = await decode(address);
    if (!decoded || turn !== this.#turn) {
      URL.revokeObjectURL(address);
      return false;
    }
    const old = this.#image.src;
    Object.assign(this.#image, { src: address, alt, hidden: false });
    if (old.startsWith("blob:")) URL.revokeObjectURL(old);
    return true;
  }

  /** Whether nothing is shown. */
  get hidden() {
    return this.#image.hidden;
  }

  /** Show nothing, also not what is being decoded. */
  hide() {
    this.#turn += 1;
    this.#image.hidden = true;
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

async function decode(address) {
  const probe = new Image();
  probe.src = address;
  return probe.decode().then(() => true, () => false);
}
