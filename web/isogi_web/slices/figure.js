/**
 * One slice of the pane: its values in grey, the contour of the isosurface, and the cross hair,
 * with the gestures that move it.
 */

import { find, sizeOf, svgElement, textElement } from "../dom.js";
import { coordinatesInWords, sidesAt, worldOf } from "../view/measures.js";
import { readSurfaces } from "../view/surfaces.js";
import { contourOf } from "./contour.js";
import { sliceAt, stepped, voxelAt } from "./geometry.js";
import { attachSliceGestures } from "./gestures.js";
import { CutLines } from "./lines.js";
import { pixelsOf, voxelsOf } from "./values.js";

/** @typedef {import("../view/measures.js").CrossHair} CrossHair */
/** @typedef {import("../view/measures.js").Greys} Greys */
/** @typedef {import("../view/model.js").ViewModel} ViewModel */
/** @typedef {import("../view/rotation.js").Vec3} Vec3 */
/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {import("./geometry.js").Lie} Lie */
/** @typedef {import("./geometry.js").Slice} Slice */
/** @typedef {import("./values.js").SliceCache} SliceCache */
/** @typedef {import("./values.js").Values} Values */

/**
 * @typedef {object} FigureHooks
 * @property {() => Greys} greys the values that are black and white
 * @property {(greys: Greys|null) => void} setGreys null for the volume's defaults
 * @property {() => boolean} cutting returns true if planes may be moved
 * @property {(normal: Vec3) => void} cut cuts along the slice with this normal
 * @property {() => void} onRest is called when the line of a plane is released
 * @property {() => void} onValues is called when other values have come
 */

const AGAIN_MS = 1500; // pause before a server that does not answer is asked again
const ALONG = 0.999; // component of a unit vector from which it counts as along an axis
const WORDS = "Arrow keys move the cross hair, page keys go through slices, with Shift by ten.";
const [CONTOUR, PINNED, CROSS] = ["#35b4ff", "#c39bff", "#efb75ad0"];
/** Lines of a contour per path: canvases draw long paths, as noise has them, more slowly. */
const TOGETHER = 100;
const GAP = 7; // pixels of the cross hair around its voxel

/**
 * Describe the place of a slice: its kind, and the coordinate that all of it shares, or else its
 * voxel index.
 * @param {Scene["volume"]} volume
 * @param {Slice} slice
 * @param {Vec3} voxel a voxel in it
 * @returns {string}
 */
export function captionOf(volume, { lie, at, normal }, voxel) {
  const axis = normal.findIndex((x) => Math.abs(x) > ALONG);
  const place = worldOf(volume, voxel);
  const sides = sidesAt(volume, place);
  const coordinate = coordinatesInWords(volume, place, sides)[axis];
  const where =
    axis < 0
      ? `voxel ${lie.axis} ${at}`
      : `${sides ? "" : `${"xyz"[axis]} `}${coordinate} ${volume.unit}`.trim();
  return [lie.kind, where].filter(Boolean).join(" · ");
}

/** Shows the slice through the cross hair, and moves the cross hair. */
export class SliceFigure {
  #volume;
  #pinned;
  #view;
  #cache;
  #hooks;
  #cut;
  #plane;
  /** @type {{slice: Values, at: number, voxels: string}|null} */
  #shown = null;
  #painted = ""; // slice and greys on the canvas of values
  /** @type {{of: Values|null, isovalues: string, contours: number[][]}} */
  #contours = { of: null, isovalues: "", contours: [] };
  #loading = false;

  /**
   * @param {Lie} lie
   * @param {Scene} scene
   * @param {ViewModel} view
   * @param {SliceCache} cache
   * @param {FigureHooks} hooks
   */
  constructor(lie, { volume, surfaces = [] }, view, cache, hooks) {
    this.#pinned = surfaces;
    this.#volume = volume;
    this.#view = view;
    this.#cache = cache;
    this.#hooks = hooks;
    /** Orientation of the slice. */
    this.lie = lie;
    /** The element on the page. */
    this.root = figureOf(lie);
    this.#plane = find(this.root, ".plane");
    this.#cut = new CutLines(
      find(this.root, ".gone"),
      find(this.root, "svg", SVGElement),
      volume,
      view,
      hooks.onRest,
    );
    // Redraw when the size changes; let gestures move the cross hair.
    find(this.root, "button").addEventListener("click", () => hooks.cut(this.#slice().normal));
    new ResizeObserver(() => this.#drawLines()).observe(this.#plane);
    attachSliceGestures(this.root, this.#plane, {
      greys: hooks.greys,
      setGreys: hooks.setGreys,
      point: (right, up) => this.#move(voxelAt(volume, this.#slice(), [right, up])),
      step: (steps) => this.#move(stepped(volume, lie, this.#crossHair.voxel, steps)),
    });
  }

  /** Return the value at the cross hair; null until it is here. @returns {number|null} */
  get value() {
    if (!this.#isCurrent() || !this.#shown) return null;
    const { values, width, height } = this.#shown.slice;
    const {
      point: [right, up],
    } = this.#slice();
    return values[Math.floor((1 - up) * height) * width + Math.floor(right * width)];
  }

  /** Show the current view. */
  draw() {
    this.#load();
    const slice = this.#slice();
    this.root.toggleAttribute("data-old", !this.#isCurrent());
    find(this.root, "figcaption span").textContent = captionOf(
      this.#volume,
      slice,
      this.#crossHair.voxel,
    );
    find(this.root, "button").hidden = !this.#hooks.cutting();
    this.#cut.draw(() => this.#slice(), this.#hooks.cutting());
    this.#paint();
    this.#drawLines();
  }

  /** Return the cross hair of the view. */
  get #crossHair() {
    return /** @type {CrossHair} */ (this.#view.values.slices);
  }

  /** Return the slice through the cross hair. */
  #slice() {
    return sliceAt(this.#volume, this.lie, this.#crossHair.voxel);
  }

  /** Move the cross hair to a voxel. @param {Vec3} voxel */
  #move(voxel) {
    this.#view.set({ slices: { ...this.#crossHair, voxel } });
  }

  /** Return true if the values belong to the slice through the cross hair. */
  #isCurrent() {
    const { slices } = this.#view.values;
    return (
      slices !== null &&
      this.#shown?.at === slices.voxel[this.lie.across] &&
      this.#shown.voxels === voxelsOf(this.#view.values)
    );
  }

  /** Read slices, one after the other, until the newest one that is wanted is here. */
  async #load() {
    if (this.#loading) return;
    this.#loading = true;
    for (
      let { slices } = this.#view.values;
      slices && !this.#isCurrent();
      { slices } = this.#view.values
    ) {
      // The cross hair may move on while a slice is read: compare again after each one.
      const at = slices.voxel[this.lie.across];
      const voxels = voxelsOf(this.#view.values);
      const slice = await this.#cache.find(this.lie, at, voxels);
      if (slice) this.#shown = { slice, at, voxels };
      else
        await new Promise((done) => {
          setTimeout(done, AGAIN_MS);
        });
      this.#hooks.onValues();
    }
    this.#loading = false;
  }

  /** Paint the values, unless they are on the canvas. */
  #paint() {
    if (!this.#shown) return;
    const { slice, at, voxels } = this.#shown;
    const greys = this.#hooks.greys();
    const now = [at, voxels, ...greys].join(" ");
    if (now === this.#painted) return;
    this.#painted = now;
    const canvas = find(this.root, ".values", HTMLCanvasElement);
    const { width, height } = slice;
    Object.assign(canvas, { width, height });
    canvas
      .getContext("2d")
      ?.putImageData(new ImageData(pixelsOf(slice, greys), width, height), 0, 0);
  }

  /** Draw contours and cross hair in the screen's pixels. */
  #drawLines() {
    const canvas = find(this.root, ".lines", HTMLCanvasElement);
    const ratio = devicePixelRatio || 1;
    const { width, height } = sizeOf(this.#plane);
    const context = canvas.getContext("2d");
    if (!context || !this.#view.values.slices) return;
    Object.assign(canvas, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
    context.lineWidth = 1.5 * ratio;
    if (this.#shown)
      strokeContours(context, this.#shown.slice, this.#contoursOn(this.#shown.slice));
    // Draw the cross hair over the contours.
    context.lineWidth = ratio;
    strokeCross(context, this.#slice(), GAP * ratio);
  }

  /**
   * Return the contours of the isosurface and of the pinned surfaces that are shown, computed again
   * only if slice or isovalues have changed.
   * @param {Values} slice
   */
  #contoursOn(slice) {
    const { isovalue, surfaces } = this.#view.values;
    const states = readSurfaces(surfaces, this.#pinned);
    const isovalues = [
      isovalue,
      ...this.#pinned.filter((_, k) => states[k].shown).map((each) => each.isovalue),
    ];
    const now = isovalues.join(" ");
    if (this.#contours.of !== slice || this.#contours.isovalues !== now) {
      this.#contours = {
        of: slice,
        isovalues: now,
        contours: isovalues.map((each) => contourOf(slice, each)),
      };
    }
    return this.#contours.contours;
  }
}

/**
 * Draw contours, the first one on top.
 * @param {CanvasRenderingContext2D} context
 * @param {Values} slice
 * @param {number[][]} contours
 */
function strokeContours(context, slice, contours) {
  const [across, down] = [context.canvas.width / slice.width, context.canvas.height / slice.height];
  context.lineCap = "round";
  contours.toReversed().forEach((lines, k) => {
    context.strokeStyle = k === contours.length - 1 ? CONTOUR : PINNED;
    for (let first = 0; first < lines.length; first += 4 * TOGETHER) {
      strokeLines(
        context,
        lines,
        first,
        Math.min(lines.length, first + 4 * TOGETHER),
        across,
        down,
      );
    }
  });
}

/**
 * Draw lines `first` to `end` of a contour as one path.
 * @param {CanvasRenderingContext2D} context
 * @param {number[]} lines
 * @param {number} first
 * @param {number} end
 * @param {number} across
 * @param {number} down
 */
function strokeLines(context, lines, first, end, across, down) {
  context.beginPath();
  for (let i = first; i < end; i += 4) {
    context.moveTo(lines[i] * across, lines[i + 1] * down);
    context.lineTo(lines[i + 2] * across, lines[i + 3] * down);
  }
  context.stroke();
}

/**
 * Draw the cross hair with a gap around its voxel.
 * @param {CanvasRenderingContext2D} context
 * @param {Slice} slice
 * @param {number} gap
 */
function strokeCross(context, { point: [right, up] }, gap) {
  const { width, height } = context.canvas;
  // A line through the middles of pixels is sharp.
  const [x, y] = [right * width, (1 - up) * height].map((at) => Math.floor(at) + 0.5);
  context.strokeStyle = CROSS;
  context.lineCap = "butt";
  context.beginPath();
  for (const [from, to] of [
    [0, x - gap],
    [x + gap, width],
  ])
    if (to > from) (context.moveTo(from, y), context.lineTo(to, y));
  for (const [from, to] of [
    [0, y - gap],
    [y + gap, height],
  ])
    if (to > from) (context.moveTo(x, from), context.lineTo(x, to));
  context.stroke();
}

/** Make the elements of a slice. @param {Lie} lie */
function figureOf({ axis, name, sides }) {
  const [figure, plane, gone, caption] = ["figure", "div", "div", "figcaption"].map((tag) =>
    document.createElement(tag),
  );
  const canvases = ["values", "lines"].map((className) =>
    Object.assign(document.createElement("canvas"), { className, ariaHidden: "true" }),
  );
  const lines = svgElement("svg", { role: "group", "aria-label": `Planes of the cut, ${name}` });
  const button = Object.assign(textElement("button", "Cut here"), {
    type: "button",
    title: "Cut along this slice, on your side of it",
    ariaLabel: `Cut here, ${name}`,
  });
  // Put the parts together: canvases below, hatching and lines over them, letters at the edges.
  figure.dataset.axis = axis;
  gone.className = "gone";
  Object.assign(plane, {
    className: "plane",
    tabIndex: 0,
    role: "application",
    ariaRoleDescription: "slice",
    ariaLabel: `${name}. ${WORDS}`,
  });
  plane.append(...canvases, gone, lines);
  const letters = ["left", "right", "top", "bottom"].map((className, k) =>
    Object.assign(textElement("b", sides[k]), { className, ariaHidden: "true" }),
  );
  caption.append(textElement("span", ""), button);
  figure.append(plane, ...letters, caption);
  return figure;
}
