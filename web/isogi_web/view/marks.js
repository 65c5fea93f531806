/**
 * Marks over the picture that stick to points of the world while the camera moves, and are hidden
 * behind the surface.
 */

import { sizeOf, svgElement } from "../dom.js";
import { placeOf } from "./camera.js";
import { arcOf, measureInWords, worldOf, writeMeasure } from "./measures.js";

/** @typedef {import("./camera.js").Vec3} Vec3 */
/** @typedef {import("./measures.js").Measure} Measure */
/** @typedef {import("./model.js").Knobs} Knobs */
/** @typedef {import("./model.js").ViewModel} ViewModel */
/** @typedef {import("../net/schemas.js").Scene} Scene */
/**
 * @typedef {{x: number, y: number, inside: boolean}} Spot pixels from the stage's upper left
 *   corner; `inside` is true on the stage
 */
/**
 * @typedef {(values: Knobs, right: number, up: number) => Promise<Vec3|null>} FindSurface returns
 *   the surface's point at a place of the picture, in heights of the picture from its middle; null
 *   if there is none
 */

const NEARER = 0.5; // distance in voxels by which a surface must lie in front of a point to hide it
const RADIUS = 5; // pixels
const [CROSS, GAP] = [11, 4]; // pixels from the middle of a cross hair to the ends of its lines
const LABEL_UP = 8; // pixels from a line to its words
const BEYOND = 24; // pixels from an arc to its words

/** Draws marks on points and lines between them, and hides marks that lie behind the surface. */
export class Marks {
  #root;
  #scene;
  #view;
  #pick;
  /** @type {Vec3[]} */
  #points = [];
  /** @type {Measure[]} */
  #measures = [];
  /** @type {Set<string>} */
  #hidden = new Set();
  #looking = false;
  #turned = false;

  /** Called whenever marks are drawn. @type {() => void} */
  onDraw = () => {};

  /**
   * @param {SVGElement} root fills the stage
   * @param {Scene} scene
   * @param {ViewModel} view
   * @param {FindSurface} pick
   */
  constructor(root, scene, view, pick) {
    this.#root = root;
    this.#scene = scene;
    this.#view = view;
    this.#pick = pick;
    view.subscribe(() => this.#changed());
    new ResizeObserver(() => this.#draw()).observe(root);
  }

  /**
   * Mark these points, and no others.
   * @param {Vec3[]} points
   * @param {Measure[]} measures lines between some of the points
   */
  show(points, measures) {
    this.#points = points;
    this.#measures = measures;
    this.#changed();
  }

  /**
   * Return true if the surface lies in front of a point, as far as is known.
   * @param {Vec3} point
   * @returns {boolean}
   */
  hides(point) {
    return this.#hidden.has(String(point));
  }

  /** Project a point into the current view; see `placeOf`. @param {Vec3} point */
  place(point) {
    return placeOf(this.#scene, this.#view.values, point);
  }

  /**
   * Return the place of a point on the stage in the current view.
   * @param {Vec3} point
   * @returns {Spot}
   */
  spot(point) {
    const { width, height } = sizeOf(this.#root);
    return spotOf(this.place(point), width, height);
  }

  /** Draw the marks, and find out which of them are hidden. */
  #changed() {
    this.#draw();
    this.#turned = true;
    if (!this.#looking && this.#points.length) this.#look();
  }

  /**
   * Request the surface in front of the points, one after the other, until all are known in the
   * newest view.
   */
  async #look() {
    this.#looking = true;
    while (this.#turned) {
      this.#turned = false;
      const values = this.#view.values;
      // Points that are shared by measures are requested once.
      for (const point of new Map(this.#points.map((each) => [String(each), each])).values()) {
        const hidden = await this.#behind(values, point);
        this.#hidden[hidden ? "add" : "delete"](String(point));
        this.#draw();
        if (this.#turned) break;
      }
    }
    this.#looking = false;
  }

  /**
   * Return true if the surface lies in front of a point.
   * @param {Knobs} values
   * @param {Vec3} point
   */
  async #behind(values, point) {
    const { right, up, depth } = placeOf(this.#scene, values, point);
    if (depth <= 0 || !this.spot(point).inside) return false;
    const hit = await this.#pick(values, right, up);
    return (
      hit !== null &&
      placeOf(this.#scene, values, hit).depth <
        depth - NEARER * Math.max(...this.#scene.volume.spacing)
    );
  }

  /** Draw rings on visible points, measures and the cross hair. */
  #draw() {
    const shown = this.#points
      .filter((point) => !this.hides(point))
      .map((point) => this.spot(point));
    const lines = this.#measures.flatMap((points) => this.#lines(points));
    this.#root.replaceChildren(
      ...lines,
      ...this.#cross(),
      ...shown.filter(({ inside }) => inside).map(ring),
    );
    this.onDraw();
  }

  /**
   * Draw the cross hair of the slices, even behind the surface, as slices mostly show the inside.
   * @returns {SVGElement[]}
   */
  #cross() {
    const { slices } = this.#view.values;
    if (!slices) return [];
    const { x, y, inside } = this.spot(worldOf(this.#scene.volume, slices.voxel));
    const d = `M${x - CROSS} ${y}H${x - GAP}M${x + GAP} ${y}H${x + CROSS}M${x} ${y - CROSS}V${y - GAP}M${x} ${y + GAP}V${y + CROSS}`;
    return inside
      ? ["under", "line"].map((kind) => svgElement("path", { class: `${kind} cross`, d }))
      : [];
  }

  /**
   * Draw the lines of a measure and its words: dashed if an end is hidden, not at all if one lies
   * behind the eye.
   * @param {Measure} points
   */
  #lines(points) {
    const all = [points, arcOf(points)];
    if (all.flat().some((point) => this.place(point).depth <= 0)) return [];
    const [line, arc] = all.map((row) => row.map((point) => this.spot(point)));
    const hidden = points.some((point) => this.hides(point)) ? "hidden" : "";
    const note = this.#view.values.notes[writeMeasure(points)];
    const found = measureInWords(this.#scene.volume, points);
    const words = note ? `${note}: ${found}` : found;
    return [...pathOf(line, hidden), ...pathOf(arc, hidden), labelOf(line, arc, words)];
  }
}

/**
 * Return the position of a place of the picture on a stage.
 * @param {{right: number, up: number, depth: number}} place in heights of the picture from its
 *   middle
 * @param {number} width of the stage, pixels
 * @param {number} height of the stage, pixels
 * @returns {Spot}
 */
export function spotOf({ right, up, depth }, width, height) {
  const [x, y] = [width / 2 + right * height, height / 2 - up * height];
  return { x, y, inside: depth > 0 && x >= 0 && x <= width && y >= 0 && y <= height };
}

/** Draw a ring. @param {Spot} spot */
function ring({ x, y }) {
  return svgElement("circle", { class: "mark", cx: x.toFixed(2), cy: y.toFixed(2), r: RADIUS });
}

/**
 * Draw a line over the picture, with a darker one below it.
 * @param {Spot[]} spots
 * @param {string} kind
 * @returns {SVGElement[]}
 */
function pathOf(spots, kind) {
  const points = spots.map(({ x, y }) => `${x.toFixed(2)},${y.toFixed(2)}`).join(" ");
  return points
    ? ["under", "line"].map((each) => svgElement("polyline", { class: `${each} ${kind}`, points }))
    : [];
}

/**
 * Write words above the middle of a line, or beyond the arc of an angle.
 * @param {Spot[]} line
 * @param {Spot[]} arc
 * @param {string} words
 */
function labelOf([a, b], arc, words) {
  const middle = arc[arc.length >> 1];
  const away = middle ? Math.hypot(middle.x - b.x, middle.y - b.y) : 0;
  const share = away > 0 ? 1 + BEYOND / away : 0;
  const [x, y] = middle
    ? [b.x + share * (middle.x - b.x), b.y + share * (middle.y - b.y) + LABEL_UP / 2]
    : [(a.x + b.x) / 2, (a.y + b.y) / 2 - LABEL_UP];
  return svgElement("text", { class: "measure", x: x.toFixed(2), y: y.toFixed(2) }, words);
}
