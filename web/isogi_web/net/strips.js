/** A large picture in strips: each is requested by itself, and all of them are joined. */

/** @typedef {import("./schemas.js").Facts} Facts */
/**
 * @typedef {{shapes: import("../view/rulers.js").Shapes, scale: number}} Stamp shapes that are
 *   drawn over a picture, from its lower left corner on
 */
/**
 * @typedef {{rows: [number, number], from: number, to: number}} Strip `rows` are requested, and
 *   rows [from, to) of them are used
 */

const STRIP = 1 << 23; // pixels of a strip at most, to limit the server's memory
const OVERLAP = 2; // extra rows at each side, so that edges are smooth across the seam

/**
 * Part a picture into strips, from its top.
 * @param {{width: number, height: number}} size
 * @returns {Strip[]}
 */
export function stripsOf({ width, height }) {
  // Rows of a strip without its overlaps.
  const high = Math.max(1, Math.floor(STRIP / width) - 2 * OVERLAP);
  if (width * height <= STRIP) return [whole({ height })];
  return Array.from({ length: Math.ceil(height / high) }, (_, n) => {
    const [from, to] = [n * high, Math.min((n + 1) * high, height)];
    return { rows: [Math.max(0, from - OVERLAP), Math.min(height, to + OVERLAP)], from, to };
  });
}

/** Return the strip that is a whole picture. @param {{height: number}} size @returns {Strip} */
export function whole({ height }) {
  return { rows: [0, height], from: 0, to: height };
}

/**
 * Return the facts of a picture that is made of parts: those of its worst part.
 * @param {Facts[]} all
 * @returns {Facts}
 */
export function worstOf(all) {
  return all.reduce((worst, each) =>
    (Number(each.provisional) - Number(worst.provisional) || each.error - worst.error) > 0
      ? each
      : worst,
  );
}

/** A picture that strips are drawn into. */
export class Sheet {
  #canvas;
  #paint;

  /** @param {{width: number, height: number}} size */
  constructor({ width, height }) {
    this.#canvas = Object.assign(document.createElement("canvas"), { width, height });
    this.#paint = this.#canvas.getContext("2d");
  }

  /**
   * Draw a strip.
   * @param {Blob} blob picture of the strip's rows
   * @param {Strip} strip
   */
  async add(blob, { rows: [first], from, to }) {
    const picture = await createImageBitmap(blob);
    this.#paint?.drawImage(
      picture,
      0,
      from - first,
      picture.width,
      to - from,
      0,
      from,
      picture.width,
      to - from,
    );
    picture.close();
  }

  /**
   * Draw shapes over the picture.
   * @param {Stamp} stamp
   * @param {boolean} light true if the background is light
   */
  stamp({ shapes, scale }, light) {
    const paint = this.#paint;
    if (!paint) return;
    const colours = light
      ? { over: "#3a4048", under: "#cbced1" }
      : { over: "#f4ead8", under: "#1a1d22" };
    // Shapes are given from the lower left corner, with y upwards.
    paint.setTransform(scale, 0, 0, scale, 0, this.#canvas.height);
    shapes.areas?.forEach((area) => fillArea(paint, area, colours));
    shapes.lines.forEach((line) => strokeLine(paint, line, colours));
    shapes.words.forEach((words) => paintWords(paint, words, colours));
  }

  /**
   * Return the picture as a PNG file.
   * @returns {Promise<Blob>}
   * @throws {Error} if the picture is too large for this browser
   */
  async file() {
    /** @type {Blob|null} */
    const blob = await new Promise((done) => this.#canvas.toBlob(done, "image/png"));
    if (!blob)
      throw new Error("This browser cannot put together so large a picture: choose a smaller one.");
    return blob;
  }
}

/**
 * @typedef {{over: string, under: string}} Colours colour of a line, and of the outline that sets
 *   it off from the picture
 */

/**
 * Fill an area with a gradient of its colours, with an outline.
 * @param {CanvasRenderingContext2D} paint
 * @param {import("../view/rulers.js").Area} area
 * @param {Colours} colours
 */
function fillArea(paint, { from: [left, low], to: [right, high], colours }, { under }) {
  const fill = paint.createLinearGradient(left, 0, right, 0);
  colours.forEach((colour, n) =>
    fill.addColorStop(colours.length > 1 ? n / (colours.length - 1) : 0, colour),
  );
  Object.assign(paint, { fillStyle: fill, lineWidth: 2, strokeStyle: under });
  paint.setLineDash([]);
  paint.strokeRect(left, -high, right - left, high - low);
  paint.fillRect(left, -high, right - left, high - low);
}

/**
 * Draw a line over a broader one, its outline; lines of a kind are dotted.
 * @param {CanvasRenderingContext2D} paint
 * @param {import("../view/rulers.js").Line} line
 * @param {Colours} colours
 */
function strokeLine(paint, { kind, points }, { over, under }) {
  const path = new Path2D(points.map(([x, y], n) => `${n ? "L" : "M"}${x} ${-y}`).join(""));
  Object.assign(paint, { lineJoin: "round", lineCap: "round", lineWidth: 4.5, strokeStyle: under });
  paint.setLineDash([]);
  paint.stroke(path);
  Object.assign(paint, { lineWidth: 1.75, strokeStyle: over });
  paint.setLineDash(kind ? [2, 4] : []);
  paint.stroke(path);
}

/**
 * Draw words with an outline.
 * @param {CanvasRenderingContext2D} paint
 * @param {import("../view/rulers.js").Words} words
 * @param {Colours} colours
 */
function paintWords(paint, { at: [x, y], text, size, middle, end }, { over, under }) {
  const [textAlign, textBaseline] = middle
    ? ["center", "middle"]
    : [end ? "end" : "start", "alphabetic"];
  const font = `${size}px system-ui, sans-serif`;
  Object.assign(paint, {
    font,
    textAlign,
    textBaseline,
    lineWidth: 3.5,
    lineJoin: "round",
    strokeStyle: under,
    fillStyle: over,
  });
  paint.setLineDash([]);
  paint.strokeText(text, x, -y);
  paint.fillText(text, x, -y);
}
