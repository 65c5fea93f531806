/**
 * Pointer, wheel and keys on a slice: they move the cross hair, go through slices, and set the
 * values that are black and white.
 */

import { ARROWS } from "../view/keys.js";

/** @typedef {import("../view/measures.js").Greys} Greys */

/**
 * @typedef {object} SliceActions
 * @property {() => Greys} greys the values that are black and white
 * @property {(greys: Greys|null) => void} setGreys null for the volume's defaults
 * @property {(right: number, up: number) => void} point moves the cross hair to a share of the
 *   slice's width, and of its height
 * @property {(steps: {right?: number, up?: number, across?: number}) => void} step moves it by
 *   voxels
 */

const RIGHT = 2; // button of a mouse
const DOUBLE = 100; // pixels to the right that double the window
const WHOLE = 200; // pixels down that raise the level by the window
const NOTCH = 50; // pixels of a wheel per slice; a touchpad sends many small steps
const LINE_PIXELS = 33; // pixels of a step of the wheel that is given in lines
const BY_LINE = 1; // `WheelEvent.DOM_DELTA_LINE`
const FAR = 10; // voxels of a step with shift
/** @type {Record<string, number>} */
const PAGES = { PageUp: 1, PageDown: -1 };

/**
 * Return the values that are black and white after a drag: to the right the window grows, down the
 * level rises.
 * @param {Greys} greys before the drag
 * @param {number} right pixels
 * @param {number} down pixels
 * @returns {Greys}
 */
export function draggedGreys([black, white], right, down) {
  // The window doubles per DOUBLE pixels, so that its speed fits any range of values; the level
  // moves in proportion to the window.
  const window = (white - black) * 2 ** (right / DOUBLE);
  const level = (black + white) / 2 + ((white - black) * down) / WHOLE;
  return [level - window / 2, level + window / 2];
}

/**
 * Return a function that turns steps of a wheel into slices: a notch is one slice, whatever
 * distance a mouse reports for it.
 * @returns {(turn: {deltaY: number, deltaMode: number}) => -1|0|1} takes a step; returns the slices
 *   to go, up if the wheel turns away from the visitor
 */
export function wheelSteps() {
  let sum = 0;
  return ({ deltaY, deltaMode }) => {
    const pixels = -deltaY * (deltaMode === BY_LINE ? LINE_PIXELS : 1);
    // Small steps of a touchpad add up until the direction changes.
    sum =
      (Math.sign(pixels) === Math.sign(sum) ? sum : 0) + Math.min(NOTCH, Math.max(-NOTCH, pixels));
    if (Math.abs(sum) < NOTCH) return 0;
    const step = sum > 0 ? 1 : -1;
    sum = 0;
    return step;
  };
}

/**
 * Listen to pointer, wheel and keys on a slice.
 * @param {HTMLElement} figure
 * @param {HTMLElement} plane the slice in the figure
 * @param {SliceActions} actions
 */
export function attachSliceGestures(figure, plane, { greys, setGreys, point, step }) {
  /** @type {{x: number, y: number, greys: Greys|null}|null} */
  let held = null; // place of the press; `greys` at that time, or null if it moves the cross hair
  const steps = wheelSteps();
  const follow = (/** @type {PointerEvent} */ { clientX, clientY }) => {
    if (held?.greys) return setGreys(draggedGreys(held.greys, clientX - held.x, clientY - held.y));
    const { left, bottom, width, height } = plane.getBoundingClientRect();
    return held && point((clientX - left) / width, (bottom - clientY) / height);
  };
  plane.addEventListener("pointerdown", (event) => {
    const { button, shiftKey, pointerId, clientX: x, clientY: y, target } = event;
    if (target instanceof Element && target.closest("g")) return;
    if (button !== 0 && button !== RIGHT) return;
    plane.setPointerCapture(pointerId);
    held = { x, y, greys: button === RIGHT || shiftKey ? greys() : null };
    if (!held.greys) follow(event);
  });
  plane.addEventListener("pointermove", (event) => held && follow(event));
  plane.addEventListener("pointerup", () => {
    held = null;
  });
  plane.addEventListener("pointercancel", () => {
    held = null;
  });
  plane.addEventListener("dblclick", () => setGreys(null));
  figure.addEventListener("contextmenu", (event) => event.preventDefault());
  figure.addEventListener(
    "wheel",
    (event) => {
      if (event.ctrlKey) return; // zooms the page
      event.preventDefault();
      const across = steps(event);
      if (across) step({ across });
    },
    { passive: false },
  );
  plane.addEventListener("keydown", (event) => {
    const { key, shiftKey, ctrlKey, altKey, metaKey, target } = event;
    const far = shiftKey ? FAR : 1;
    if (target !== plane || ctrlKey || altKey || metaKey || !(key in ARROWS || key in PAGES))
      return;
    event.preventDefault();
    const [right, down] = ARROWS[key] ?? [0, 0];
    step({ right: far * right, up: -far * down, across: far * (PAGES[key] ?? 0) });
  });
}
