/**
 * The pane of slices next to the picture: three slices through one cross hair, and the values that
 * are black and white in them.
 */

import { find } from "../dom.js";
import { niceStep, showNumber } from "../view/format.js";
import { placeInWords, sidesAt, worldOf } from "../view/measures.js";
import { vector } from "../view/rotation.js";
import { SliceFigure } from "./figure.js";
import { liesOf } from "./geometry.js";
import { SliceCache, usualGreys } from "./values.js";

/** @typedef {import("../view/measures.js").CrossHair} CrossHair */
/** @typedef {import("../view/measures.js").Greys} Greys */
/** @typedef {import("../view/model.js").ViewModel} ViewModel */
/** @typedef {import("../view/rotation.js").Vec3} Vec3 */
/** @typedef {import("../net/schemas.js").Scene} Scene */

/**
 * @typedef {object} PaneHooks
 * @property {import("./values.js").Read} read returns the values on a slice
 * @property {HTMLDetailsElement} cuts while it is open, planes can be moved in slices
 * @property {(point: Vec3, normal: Vec3) => void} cut cuts along a plane through a point of the
 *   world
 * @property {() => void} onRest is called when the line of a plane is released
 */

/** Shows slices if the view has a cross hair. */
export class SlicesPane {
  #root;
  #button;
  #scene;
  #view;
  #figures;
  /** @type {CrossHair|null} */
  #last; // cross hair when the pane was closed
  #due = false; // true if it is drawn in the next frame

  /**
   * @param {HTMLElement} root
   * @param {HTMLElement} button opens and closes it
   * @param {Scene} scene
   * @param {ViewModel} view
   * @param {PaneHooks} hooks
   */
  constructor(root, button, scene, view, { read, cuts, cut, onRest }) {
    this.#root = root;
    this.#button = button;
    this.#scene = scene;
    this.#view = view;
    this.#last = view.values.slices;
    // All three slices share one cache, one window of greys, and one cross hair.
    const cache = new SliceCache(read);
    const { volume } = scene;
    const hooks = {
      greys: () => this.#greys,
      setGreys: (/** @type {Greys|null} */ greys) =>
        this.#set({ greys: greys && (rounded(greys, this.#step) ?? this.#greys) }),
      cutting: () => cuts.open,
      cut: (/** @type {Vec3} */ normal) => cut(this.#point, normal),
      onRest,
      onValues: () => this.#follow(),
    };
    this.#figures = liesOf(volume.axes).map(
      (lie) => new SliceFigure(lie, scene, view, cache, hooks),
    );
    root.prepend(...this.#figures.map((figure) => figure.root));
    shareScale(volume, this.#figures);
    for (const input of this.#inputs) input.addEventListener("change", () => this.#typed());
    find(root, "#slices-reset").addEventListener("click", () => hooks.setGreys(null));
    button.addEventListener("click", () => this.toggle());
    cuts.addEventListener("toggle", () => this.#follow());
    // Draw again when anything changes that slices show.
    view.watch(
      ({ slices, isovalue, planes, time, smooth, surfaces }) => [
        ...[slices, isovalue, planes],
        ...[time, smooth, surfaces],
      ],
      () => this.#follow(),
    );
    this.#draw();
  }

  /** Close the pane, or open it with its last cross hair, at first in the middle of the volume. */
  toggle() {
    const middle = vector((i) => (this.#scene.volume.size[i] - 1) / 2);
    this.#view.set({
      slices: this.#view.values.slices ? null : (this.#last ?? { voxel: middle, greys: null }),
    });
  }

  /**
   * Move the cross hair; if the pane is closed, it opens there.
   * @param {Vec3} voxel indices, which may have fractions
   */
  follow(voxel) {
    this.#set({ voxel });
    if (!this.#view.values.slices) this.#last = { voxel, greys: this.#last?.greys ?? null };
  }

  /** Change a part of the cross hair, if there is one. @param {Partial<CrossHair>} patch */
  #set(patch) {
    const { slices } = this.#view.values;
    if (slices) this.#view.set({ slices: { ...slices, ...patch } });
  }

  /**
   * Return the values that are black and white; by default those of the volume, rounded.
   * @returns {Greys}
   */
  get #greys() {
    const { histogram } = this.#scene;
    const usual = usualGreys(histogram);
    return this.#view.values.slices?.greys ?? rounded(usual, 10 * this.#step) ?? usual;
  }

  /** Return the step that window and level are rounded to. */
  get #step() {
    const { edges } = this.#scene.histogram;
    return 10 * niceStep(edges[edges.length - 1] - edges[0]);
  }

  /** Return the fields for window and level. */
  get #inputs() {
    return ["#slices-window", "#slices-level"].map((id) => find(this.#root, id, HTMLInputElement));
  }

  /** Return the point of the world at the cross hair. */
  get #point() {
    return worldOf(this.#scene.volume, /** @type {CrossHair} */ (this.#view.values.slices).voxel);
  }

  /** Apply the typed window and level, if they are valid. */
  #typed() {
    const [window, level] = this.#inputs.map(({ valueAsNumber }) => valueAsNumber);
    const sound = window > 0 && Number.isFinite(level);
    this.#set({
      greys: sound
        ? [level - window / 2, level + window / 2]
        : (this.#view.values.slices?.greys ?? null),
    });
    this.#write();
  }

  /** Draw in the next frame of the screen. */
  #follow() {
    if (this.#due) return;
    this.#due = true;
    requestAnimationFrame(() => this.#draw());
  }

  /** Draw all slices, if the view has a cross hair. */
  #draw() {
    this.#due = false;
    const { slices } = this.#view.values;
    this.#root.hidden = !slices;
    this.#button.ariaExpanded = String(Boolean(slices));
    if (!slices) return;
    this.#last = slices;
    this.#figures.forEach((figure) => figure.draw());
    this.#write();
  }

  /** Show the place of the cross hair, the value there, and window and level. */
  #write() {
    const { volume } = this.#scene;
    const { voxel, greys } = /** @type {CrossHair} */ (this.#view.values.slices);
    const place = placeInWords(volume, this.#point, sidesAt(volume, this.#point));
    const indices = voxel.join(", ");
    const value = this.#figures.map((figure) => figure.value).find((each) => each !== null);
    find(this.#root, "#slices-place").textContent = place === indices ? `voxel ${indices}` : place;
    find(this.#root, "#slices-voxel").textContent =
      `${place === indices ? "" : `voxel ${indices} · `}${valueInWords(value, this.#step)}`;
    const [black, white] = this.#greys;
    const shown = [white - black, (black + white) / 2];
    this.#inputs.forEach((input, k) => {
      input.value = showNumber(shown[k], this.#step);
    });
    find(this.#root, "#slices-reset", HTMLButtonElement).disabled = !greys;
  }
}

/**
 * Round greys; null if they would become equal.
 * @param {Greys} greys
 * @param {number} step
 * @returns {Greys|null}
 */
function rounded(greys, step) {
  const [black, white] = greys.map((value) => Number(showNumber(value, step)));
  return black < white ? [black, white] : null;
}

/**
 * Write the value at the cross hair.
 * @param {number|undefined} value undefined until it has come
 * @param {number} step of greys, of which a hundredth is told apart
 */
function valueInWords(value, step) {
  if (value === undefined) return "value …";
  return Number.isNaN(value)
    ? "a hole"
    : `value ${showNumber(value, step / 100).replace("-", "−")}`;
}

/**
 * Give all slices one scale: the widest one fills the width of its place, or the highest one its
 * height.
 * @param {Scene["volume"]} volume
 * @param {SliceFigure[]} figures
 */
function shareScale({ size, spacing }, figures) {
  const lengths = size.map((n, i) => n * spacing[i]);
  const extents = figures.map(({ lie }) => [lengths[lie.right.axis], lengths[lie.up.axis]]);
  const [widest, highest] = [0, 1].map((k) => Math.max(...extents.map((extent) => extent[k])));
  figures.forEach(({ root }, k) => {
    const [wide, high] = extents[k];
    root.style.setProperty(
      "--width",
      `calc(${wide / widest} * min(100cqw, ${widest / highest} * 100cqh))`,
    );
    root.style.setProperty("--ratio", String(wide / high));
  });
}
