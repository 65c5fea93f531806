/** Marks over the picture that stay on points of the world while the camera moves, hidden behind the surface. */

import { svgElement } from "../dom.js";
import { placeOf } from "./camera.js";

/** @typedef {import("./camera.js").Vec3} Vec3 */
/** @typedef {import("./model.js").Knobs} Knobs */
/** @typedef {import("./model.js").ViewModel} ViewModel */
/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {{x: number, y: number, inside: boolean}} Spot pixels from the stage's top left, and whether it is on it */
/** @typedef {(values: Knobs, right: number, up: number) => Promise<Vec3|null>} Pick gives the surface's point at a place
 *   of the picture, in heights of the picture from its middle; null where there is none */

const NEARER = 0.5; // voxels by which a surface must be before a point to hide it
const RADIUS = 5; // pixels

/** Draws marks on points, and knows which of them the surface hides. */
export class Marks {
  #root;
  #scene;
  #view;
  #pick;
  /** @type {Vec3[]} */
  #points = [];
  /** @type {Set<string>} */
  #hidden = new Set();
  #looking = false;
  #turned = false;

  /** Is called whenever marks are drawn. @type {() => void} */
  onDraw = () => {};

  /**
   * @param {SVGElement} root fills the stage
   * @param {Scene} scene
   * @param {ViewModel} view
   * @param {Pick} pick
   */
  constructor(root, scene, view, pick) {
    this.#root = root;
    this.#scene = scene;
    this.#view = view;
    this.#pick = pick;
    view.subscribe(() => this.#changed());
    new ResizeObserver(() => this.#draw()).observe(root);
  }

  /** Mark these points, and no others. @param {Vec3[]} points */
  show(points) {
    this.#points = points;
    this.#changed();
  }

  /** Whether the surface is before a point, as far as is known. @param {Vec3} point @returns {boolean} */
  hides(point) {
    return this.#hidden.has(String(point));
  }

  /** Where a point is in the picture, as the view is now; see `placeOf`. @param {Vec3} point */
  place(point) {
    return placeOf(this.#scene, this.#view.values, point);
  }

  /** Where a point is on the stage, as the view is now. @param {Vec3} point @returns {Spot} */
  spot(point) {
    return spotOf(this.place(point), this.#root.clientWidth, this.#root.clientHeight);
  }

  #changed() {
    this.#draw();
    this.#turned = true;
    if (!this.#looking && this.#points.length) this.#look();
  }

  /** Ask for the surface before the points, one view at a time, until the view is the newest. */
  async #look() {
    this.#looking = true;
    while (this.#turned) {
      this.#turned = false;
      const [values, points] = [this.#view.values, this.#points];
      const found = await Promise.all(points.map((point) => this.#behind(values, point)));
      this.#hidden = new Set(points.filter((_, i) => found[i]).map(String));
      this.#draw();
    }
    this.#looking = false;
  }

  /**
   * Whether the surface is before a point.
   * @param {Knobs} values
   * @param {Vec3} point
   */
  async #behind(values, point) {
    const { right, up, depth } = placeOf(this.#scene, values, point);
    if (depth <= 0 || !this.spot(point).inside) return false;
    const met = await this.#pick(values, right, up);
    return met !== null && placeOf(this.#scene, values, met).depth < depth - NEARER * Math.max(...this.#scene.volume.spacing);
  }

  #draw() {
    const shown = this.#points.filter((point) => !this.hides(point)).map((point) => this.spot(point));
    this.#root.replaceChildren(...shown.filter(({ inside }) => inside).map(ring));
    this.onDraw();
  }
}

/**
 * Where a place of the picture is on a stage.
 * @param {{right: number, up: number, depth: number}} place in heights of the picture from its middle
 * @param {number} width of the stage, pixels
 * @param {number} height of the stage, pixels
 * @returns {Spot}
 */
export function spotOf({ right, up, depth }, width, height) {
  const [x, y] = [width / 2 + right * height, height / 2 - up * height];
  return { x, y, inside: depth > 0 && x >= 0 && x <= width && y >= 0 && y <= height };
}

/** @param {Spot} spot */
function ring({ x, y }) {
  return svgElement("circle", { class: "mark", cx: x.toFixed(2), cy: y.toFixed(2), r: RADIUS });
}
