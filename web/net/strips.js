/** A large picture in strips: each is asked for by itself, and all are put together where there is more than one. */

/** @typedef {import("./schemas.js").Facts} Facts */
/** @typedef {{rows: [number, number], from: number, to: number}} Strip `rows` are asked for, `from` to `to` are shown */

const STRIP = 1 << 23; // pixels: what a server draws without taking much memory
const OVERLAP = 2; // rows that neighbours share, so that edges are smooth across the seam

/**
 * The strips of a picture, from its top.
 * @param {{width: number, height: number}} size
 * @returns {Strip[]}
 */
export function stripsOf({ width, height }) {
  const high = Math.max(1, Math.floor(STRIP / width) - 2 * OVERLAP);
  if (width * height <= STRIP) return [{ rows: [0, height], from: 0, to: height }];
  return Array.from({ length: Math.ceil(height / high) }, (_, n) => {
    const [from, to] = [n * high, Math.min((n + 1) * high, height)];
    return { rows: [Math.max(0, from - OVERLAP), Math.min(height, to + OVERLAP)], from, to };
  });
}

/**
 * What is known of a picture of which these are parts: that of its worst part.
 * @param {Facts[]} all
 * @returns {Facts}
 */
export function worstOf(all) {
  return all.reduce((worst, each) => (Number(each.provisional) - Number(worst.provisional) || each.error - worst.error) > 0 ? each : worst);
}

/** A picture that strips are painted into. */
export class Sheet {
  #canvas;
  #paint;

  /** @param {{width: number, height: number}} size */
  constructor({ width, height }) {
    this.#canvas = Object.assign(document.createElement("canvas"), { width, height });
    this.#paint = this.#canvas.getContext("2d");
  }

  /**
   * @param {Blob} blob picture of the strip's rows
   * @param {Strip} strip
   */
  async add(blob, { rows: [first], from, to }) {
    const picture = await createImageBitmap(blob);
    this.#paint?.drawImage(picture, 0, from - first, picture.width, to - from, 0, from, picture.width, to - from);
    picture.close();
  }

  /** All of it as a file. @returns {Promise<Blob>} */
  async file() {
    /** @type {Blob|null} */
    const blob = await new Promise((done) => this.#canvas.toBlob(done, "image/png"));
    if (!blob) throw new Error("This browser cannot put together so large a picture: choose a smaller one.");
    return blob;
  }
}
