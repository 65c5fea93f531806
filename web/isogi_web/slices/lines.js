/** The parts of a slice that planes take away, hatched, and lines that move the planes. */

import { resize, svgElement } from "../dom.js";
import { attachGrip, tell } from "../view/handles.js";
import { movablePlanes } from "../view/planes.js";
import { around, isUpright, lineAcross, partLeft, slopeOf } from "./geometry.js";

/** @typedef {import("../view/model.js").ViewModel} ViewModel */
/** @typedef {import("../view/planes.js").Movable} Movable */
/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {import("./geometry.js").Slice} Slice */

const DOT = 4; // pixels

/** Draws the parts of one slice that planes take away, and the lines that move the planes. */
export class CutLines {
  #gone;
  #lines;
  #volume;
  #view;
  #onRest;
  /** @type {SVGGElement[]} */
  #grips = [];

  /**
   * @param {HTMLElement} gone hatched element that fills the slice
   * @param {SVGElement} lines element that fills the slice, for lines
   * @param {Scene["volume"]} volume
   * @param {ViewModel} view
   * @param {() => void} onRest is called when a line is released
   */
  constructor(gone, lines, volume, view, onRest) {
    this.#gone = gone;
    this.#lines = lines;
    this.#volume = volume;
    this.#view = view;
    this.#onRest = onRest;
  }

  /**
   * Draw hatching and lines on a slice.
   * @param {() => Slice} slice returns the current slice
   * @param {boolean} movable true if lines are drawn
   */
  draw(slice, movable) {
    const { planes } = this.#view.values;
    const all = movable ? movablePlanes(this.#volume, planes) : [];
    this.#gone.style.clipPath = around(partLeft(slice(), planes));
    resize(this.#grips, all.length, (k) => {
      const plane = () => movablePlanes(this.#volume, this.#view.values.planes)[k];
      return this.#lines.appendChild(gripOf(slice, plane, this.#gone, this.#view, this.#onRest));
    });
    all.forEach((plane, k) => place(this.#grips[k], slice(), plane));
  }
}

/**
 * Make the line of a plane in a slice, which moves the plane: it follows the pointer, and arrows as
 * they point.
 * @param {() => Slice} slice returns the current slice
 * @param {() => Movable} plane
 * @param {HTMLElement} box element that the slice fills
 * @param {ViewModel} view
 * @param {() => void} onRest
 */
function gripOf(slice, plane, box, view, onRest) {
  const grip = svgElement("g", { tabindex: 0 });
  grip.append(
    ...["hit", "under", "line"].map((kind) => svgElement("line", { class: kind })),
    svgElement("circle", { r: DOT }),
  );
  const slope = () => slopeOfMovable(slice(), plane());
  attachGrip(grip, view, {
    plane,
    draggedBy: (right, down) =>
      (slope().right * right) / box.clientWidth - (slope().up * down) / box.clientHeight,
    sign: () => Math.sign(isUpright(slice(), slope()) ? slope().right : slope().up),
    onRest,
  });
  return grip;
}

/**
 * Put a line where its plane crosses a slice, or hide it.
 * @param {SVGGElement} grip
 * @param {Slice} slice
 * @param {Movable} plane
 */
function place(grip, slice, plane) {
  const slope = slopeOfMovable(slice, plane);
  // The ends of the line in shares of the slice; styles count the height from above.
  const [a, b] = lineAcross(slope);
  tell(grip, plane);
  grip.toggleAttribute("hidden", !a);
  if (!a) return;
  grip.toggleAttribute("data-open", plane.value === plane.open);
  grip.style.cursor = isUpright(slice, slope) ? "ew-resize" : "ns-resize";
  const [[x1, y1], [x2, y2], [cx, cy]] = [a, b, [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2]].map(
    ([x, y]) => [`${100 * x}%`, `${100 * (1 - y)}%`],
  );
  for (const part of grip.children) {
    const at = part.tagName === "circle" ? { cx, cy } : { x1, y1, x2, y2 };
    Object.entries(at).forEach(([name, value]) => part.setAttribute(name, value));
  }
}

/** Return the distance from a plane over a slice. @param {Slice} slice @param {Movable} plane */
function slopeOfMovable(slice, { normal, value }) {
  return slopeOf(slice, { normal, limit: value });
}
