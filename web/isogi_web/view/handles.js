/**
 * Handles on the picture that move the planes of a cut: dragged along their normals, or moved by
 * keys.
 */

import { find, resize, sizeOf, svgElement } from "../dom.js";
import { boxOf, placeOf } from "./camera.js";
import { niceStep } from "./format.js";
import { spotOf } from "./marks.js";
import { edgesOf, moved, movablePlanes, readPlanes } from "./planes.js";
import { cameraAxes, dot, vector } from "./rotation.js";

/** @typedef {import("./rotation.js").Vec3} Vec3 */
/** @typedef {import("./model.js").Knobs} Knobs */
/** @typedef {import("./planes.js").Movable} Movable */
/** @typedef {import("./model.js").ViewModel} ViewModel */
/** @typedef {import("../net/schemas.js").Scene} Scene */

/**
 * @typedef {object} Grip the way in which an element moves a plane
 * @property {() => Movable} plane returns the current plane
 * @property {(right: number, down: number) => number} draggedBy returns the change of the plane's
 *   value by a drag, given in pixels
 * @property {() => number} [sign] returns -1 if arrows to the right and up lower the value; 1 by
 *   default
 * @property {() => void} onRest is called when the element is released
 */

const EDGE = 18; // distance of handles from the edges of the stage, pixels

/** Length of a unit normal in the picture, below which it is dragged up and down instead. */
const FLAT = 0.2;
const PAGE = 10; // steps of a page key
const PARTS = 200; // steps of an arrow key through a range, at most

/** Steps of each key. @type {Record<string, number>} */
const STEPS = {
  ArrowRight: 1,
  ArrowUp: 1,
  ArrowLeft: -1,
  ArrowDown: -1,
  PageUp: PAGE,
  PageDown: -PAGE,
};

/**
 * Return the distance by which a plane moves when its handle is dragged.
 * @param {{volume: Pick<Scene["volume"], "size"|"spacing"|"bounds">}} scene
 * @param {Knobs} values knobs of the view
 * @param {Pick<Movable, "at"|"normal">} plane
 * @param {{right: number, down: number}} way heights of the picture
 * @returns {number} world units along its normal
 */
export function draggedBy(scene, values, { at, normal }, { right, down }) {
  const { radius } = boxOf(scene);
  const { out } = cameraAxes(values.azimuth, values.elevation);
  const step = 1e-3 * radius;
  // Project a small step along the normal: (x, y) is the motion of the handle per world unit.
  const [here, there] = [at, vector((i) => at[i] + step * normal[i])].map((point) =>
    placeOf(scene, values, point),
  );
  const [x, y] = [(there.right - here.right) / step, (there.up - here.up) / step];
  // Motion per world unit of a direction in the picture's plane.
  const scale = 1 / (2 * values.distance * radius * Math.tan((values.fov * Math.PI) / 360));
  // Project the drag onto the motion of the handle, so that the handle follows the pointer.
  if (Math.hypot(x, y) > FLAT * scale) return (right * x - down * y) / (x * x + y * y);
  // The normal points at the viewer or away: dragging down moves the plane towards the viewer.
  return (down / scale) * (dot(normal, out) < 0 ? -1 : 1);
}

/**
 * Draws the remaining matter as a box, and a handle on each of its sides and on each oblique plane.
 */
export class Handles {
  #root;
  #stage;
  #scene;
  #view;
  #hooks;
  /** @type {HTMLButtonElement[]} */
  #buttons = [];

  /**
   * @param {HTMLElement} root fills the stage; holds an SVG element for lines
   * @param {Scene} scene
   * @param {ViewModel} view
   * @param {{wanted: () => boolean, onRest: () => void}} hooks `wanted` returns true if handles are
   *   shown; `onRest` is called when one is released
   */
  constructor(root, scene, view, hooks) {
    this.#root = root;
    this.#stage = root.parentElement ?? root; // its size is known while the handles are hidden
    this.#scene = scene;
    this.#view = view;
    this.#hooks = hooks;
    view.subscribe(() => this.draw());
    new ResizeObserver(() => this.draw()).observe(this.#stage);
    this.draw();
  }

  /** Show the handles at their current places, if they are wanted. */
  draw() {
    this.#root.hidden = !this.#hooks.wanted();
    if (this.#root.hidden) return;
    const planes = this.#planes();
    resize(this.#buttons, planes.length, (k) => this.#root.appendChild(this.#handle(k)));
    planes.forEach((plane, k) => {
      tell(this.#buttons[k], plane);
      Object.assign(this.#buttons[k], {
        textContent: plane.name.replace(/^plane | .*$/, ""),
        title: `Move ${plane.name}`,
      });
      this.#place(this.#buttons[k], plane.at);
    });
    this.#drawLines(planes.map(({ outline }) => [...outline, ...outline.slice(0, 1)]));
  }

  /** Return the planes that may be moved. */
  #planes() {
    return movablePlanes(this.#scene.volume, this.#view.values.planes);
  }

  /**
   * Put a handle at a point, or as near to it as the stage allows. Nearer handles lie over farther
   * ones.
   * @param {HTMLElement} button
   * @param {Vec3} point
   */
  #place(button, point) {
    const { width, height } = sizeOf(this.#stage);
    const at = placeOf(this.#scene, this.#view.values, point);
    const { x, y } = spotOf(at, width, height);
    button.hidden = at.depth <= 0;
    button.style.translate = `${within(x, width).toFixed(1)}px ${within(y, height).toFixed(1)}px`;
    button.style.zIndex = String(
      Math.round((1e3 * boxOf(this.#scene).radius) / Math.max(at.depth, 1e-9)),
    );
  }

  /**
   * Draw the box of the remaining matter, and outlines; lines that reach behind the eye are left
   * out.
   * @param {Vec3[][]} outlines
   */
  #drawLines(outlines) {
    const { values } = this.#view;
    const { width, height } = sizeOf(this.#stage);
    const box = edgesOf(readPlanes(values.planes, this.#scene.volume.bounds).kept);
    const rows = [...box, ...outlines].flatMap((points) => {
      const places = points.map((point) => placeOf(this.#scene, values, point));
      if (!places.length || places.some(({ depth }) => depth <= 0)) return [];
      return [
        places
          .map((each) => spotOf(each, width, height))
          .map(({ x, y }) => `${x.toFixed(1)},${y.toFixed(1)}`)
          .join(" "),
      ];
    });
    const lines = ["under", "line"].flatMap((kind) =>
      rows.map((points) => svgElement("polyline", { class: kind, points })),
    );
    find(this.#root, "svg", SVGElement).replaceChildren(...lines);
  }

  /** Make the handle of a plane. @param {number} k number of the plane */
  #handle(k) {
    const button = Object.assign(document.createElement("button"), {
      type: "button",
      className: "handle over",
    });
    const plane = () => this.#planes()[k];
    attachGrip(button, this.#view, {
      plane,
      draggedBy: (right, down) => {
        const { height } = sizeOf(this.#stage);
        return draggedBy(this.#scene, this.#view.values, plane(), {
          right: right / height,
          down: down / height,
        });
      },
      onRest: this.#hooks.onRest,
    });
    return button;
  }
}

/**
 * Make an element the slider of a plane, which is dragged and moved by keys.
 * @param {GlobalEventHandlers & Element} element
 * @param {ViewModel} view
 * @param {Grip} grip
 */
export function attachGrip(element, view, { plane, draggedBy: by, sign = () => 1, onRest }) {
  const move = (/** @type {number} */ value) => view.set({ planes: moved(plane(), value) });
  const stage = () => /** @type {HTMLElement|null} */ (element.closest("#stage"));
  /** @type {{x: number, y: number, value: number}|null} */
  let held = null; // place of the pointer, and the value before it is rounded
  let dragged = false;
  element.setAttribute("role", "slider");
  element.addEventListener("keydown", (event) => {
    const to = steppedTo(plane(), event, sign());
    if (to === null) return;
    event.preventDefault();
    event.stopPropagation(); // on the stage arrows turn the object
    move(to);
  });
  element.addEventListener("pointerdown", ({ pointerId, clientX: x, clientY: y }) => {
    element.setPointerCapture(pointerId);
    held = { x, y, value: plane().value };
    dragged = false;
  });
  element.addEventListener("pointermove", ({ clientX: x, clientY: y }) => {
    if (!held) return;
    held = { x, y, value: held.value + by(x - held.x, y - held.y) };
    dragged = true;
    move(held.value);
  });
  const release = () => {
    if (held) onRest();
    // Give the keys back to the stage, on which arrows turn the object.
    if (held && dragged) stage()?.focus({ preventScroll: true });
    held = null;
  };
  element.addEventListener("pointerup", release);
  element.addEventListener("pointercancel", release);
}

/**
 * Return the value to which a key moves a plane; null for other keys.
 * @param {Movable} plane
 * @param {KeyboardEvent} event
 * @param {number} sign see `Grip`
 * @returns {number|null}
 */
function steppedTo({ value, range: [low, high], open }, { key, ctrlKey, altKey, metaKey }, sign) {
  if (ctrlKey || altKey || metaKey) return null;
  if (key === "Home") return open;
  return key in STEPS ? value + sign * STEPS[key] * niceStep(high - low, PARTS) : null;
}

/**
 * Describe to assistive technology what an element moves, and its value.
 * @param {Element} element
 * @param {Movable} plane
 */
export function tell(element, { name, value, range: [low, high] }) {
  element.ariaLabel = `Cut, ${name}`;
  [element.ariaValueMin, element.ariaValueMax, element.ariaValueNow] = [low, high, value].map(
    String,
  );
  const [from, to, at] = [low, high, value].map((each) => Number(each.toPrecision(4)));
  element.ariaValueText = `${name} ${at}, within ${from} to ${to}`;
}

/** Limit a place to the stage. @param {number} at @param {number} size */
function within(at, size) {
  return Math.min(Math.max(at, EDGE), size - EDGE);
}
