/** Pointer, touch and wheel on the stage, as changes of the view. */

import { sizeOf } from "../dom.js";
import { pan } from "./camera.js";
import { dragLight } from "./rotation.js";

/** @typedef {import("./camera.js").Vec3} Vec3 */
/** @typedef {import("./model.js").Knobs} Knobs */
/** @typedef {import("./model.js").ViewModel} ViewModel */
/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {{x: number, y: number}} Place pixels */
/**
 * @typedef {Place & {spread: number}} Hold the middle between all fingers, and the distance of the
 *   first two, pixels
 */

const DEGREES_ACROSS = 220; // rotation by a drag over the shorter side of the stage
const WHEEL_RATE = 0.0012; // zoom per pixel of the wheel, as a logarithm
const PINCH_WHEEL_RATE = 0.008; // the same for pinches on touchpads: small wheel steps with ctrl
const LINE_PIXELS = 16; // pixels of a step of the wheel that is given in lines
const BY_LINE = 1; // `WheelEvent.DOM_DELTA_LINE`
const [MIDDLE, RIGHT] = [1, 2];
const [SLIP, FINGER_SLIP] = [4, 10]; // pixels by which a click, and a tap, may move

/**
 * Turn the object as if it were held: dragged to the right its front moves right, dragged down it
 * tips towards the viewer.
 * @param {{azimuth: number, elevation: number}} values knobs of the view
 * @param {number} right degrees
 * @param {number} down degrees
 * @returns {{azimuth: number, elevation: number}}
 */
export function dragObject(values, right, down) {
  return { azimuth: values.azimuth - right, elevation: values.elevation + down };
}

/**
 * Listen to the pointer: drag turns the object; right or shift drag the light; middle, ctrl or alt
 * drag moves the picture; two fingers move and zoom it; the wheel zooms.
 * @param {HTMLElement} stage
 * @param {Scene} scene
 * @param {ViewModel} view
 * @param {{onRest: () => void}} options `onRest` is called when the last finger leaves
 */
export function attachGestures(stage, scene, view, { onRest }) {
  /** @type {Map<number, Place>} */
  const fingers = new Map();
  // Places of the fingers, and the view, at the time when the last finger came.
  let grip = { ...hold([]), values: view.values };

  stage.addEventListener("pointerdown", (event) => {
    if (onPanel(event)) return;
    stage.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, place(event));
    stage.dataset.dragging = fingers.size > 1 ? "picture" : dragTarget(event, scene);
    grip = { ...hold([...fingers.values()]), values: view.values };
  });

  stage.addEventListener("pointermove", (event) => {
    if (!fingers.has(event.pointerId)) return;
    const before = hold([...fingers.values()]);
    fingers.set(event.pointerId, place(event));
    const after = hold([...fingers.values()]);
    // Two fingers count from their first places, a single one from its last place.
    if (fingers.size > 1) view.set(pinched(sizeOf(stage).height, scene, grip, after));
    else view.set(dragged(stage, scene, view.values, after.x - before.x, after.y - before.y));
  });

  /** @param {PointerEvent} event */
  const release = (event) => {
    if (!fingers.delete(event.pointerId) || fingers.size) return;
    delete stage.dataset.dragging;
    onRest();
  };
  stage.addEventListener("pointerup", release);
  stage.addEventListener("pointercancel", release);
  stage.addEventListener("contextmenu", (event) => event.preventDefault());
  // The middle button would scroll.
  stage.addEventListener("mousedown", (event) => event.button === MIDDLE && event.preventDefault());
  stage.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      view.set({ distance: view.values.distance * wheelZoom(event) });
    },
    { passive: false },
  );
}

/**
 * Listen to clicks, double clicks and taps on the stage; a press that moves is no click.
 * @param {HTMLElement} stage
 * @param {{click: (right: number, up: number) => void, double: (right: number, up: number) =>
 *   void}} hooks called with the place in the picture, in heights of the picture from its middle;
 *   each double click is preceded by a click
 */
export function attachClicks(stage, { click, double }) {
  /** @type {Place|null} */
  let pressed = null; // null after a drag, and for clicks with a modifier or another button
  stage.addEventListener("pointerdown", (event) => {
    const modified =
      event.button !== 0 || event.shiftKey || event.ctrlKey || event.altKey || event.metaKey;
    pressed = !event.isPrimary || modified || onPanel(event) ? null : place(event);
  });
  stage.addEventListener("pointermove", ({ clientX: x, clientY: y, pointerType }) => {
    if (
      pressed &&
      Math.hypot(x - pressed.x, y - pressed.y) > (pointerType === "mouse" ? SLIP : FINGER_SLIP)
    )
      pressed = null;
  });
  stage.addEventListener(
    "click",
    (event) => pressed && event.detail < 2 && click(...placeIn(stage, event)),
  );
  stage.addEventListener("dblclick", (event) => onPanel(event) || double(...placeIn(stage, event)));
}

/**
 * Return a place on the stage, in heights of the picture from its middle: to the right, and up.
 * @param {HTMLElement} stage
 * @param {MouseEvent} event
 * @returns {[number, number]}
 */
function placeIn(stage, { clientX, clientY }) {
  const { left, top, width, height } = stage.getBoundingClientRect();
  // Integer coordinates name a pixel: take its middle.
  const [x, y] = [clientX, clientY].map((at) => (Number.isInteger(at) ? at + 0.5 : at));
  return [(x - left - width / 2) / height, (top + height / 2 - y) / height];
}

/**
 * Return distance and target after two fingers have moved: the point between the fingers stays
 * between them.
 *
 * Events of fingers come one at a time; a pinch therefore counts from the first places, not from
 * the last event.
 *
 * @param {number} height of the stage, pixels
 * @param {Pick<Scene, "volume">} scene
 * @param {Hold & {values: Knobs}} grip places of the fingers and view at the start
 * @param {Hold} now
 * @returns {{distance: number, target: Vec3}}
 */
export function pinched(height, scene, { values, x, y, spread }, now) {
  const distance = values.distance * (spread / Math.max(1, now.spread));
  return {
    distance,
    ...pan(scene, { ...values, distance }, (now.x - x) / height, (now.y - y) / height),
  };
}

/**
 * Return the middle of some fingers, and the distance of the first two.
 * @param {Place[]} places of the fingers, in the order in which they came
 * @returns {Hold}
 */
export function hold(places) {
  const [a, b] = places;
  return {
    x: places.reduce((sum, { x }) => sum + x, 0) / places.length,
    y: places.reduce((sum, { y }) => sum + y, 0) / places.length,
    spread: b ? Math.hypot(a.x - b.x, a.y - b.y) : 0,
  };
}

/**
 * Return the factor by which a step of the wheel changes the distance.
 * @param {{deltaY: number, deltaMode: number, ctrlKey: boolean}} step
 * @returns {number}
 */
export function wheelZoom({ deltaY, deltaMode, ctrlKey }) {
  const pixels = deltaY * (deltaMode === BY_LINE ? LINE_PIXELS : 1);
  return Math.exp(pixels * (ctrlKey ? PINCH_WHEEL_RATE : WHEEL_RATE));
}

/** Return true if an event belongs to a panel that lies over the picture. @param {Event} event */
function onPanel({ target }) {
  return target instanceof Element && target.closest(".over") !== null;
}

/**
 * Return the thing that a drag moves: "picture", "light" or "object".
 * @param {PointerEvent} event
 * @param {Scene} scene
 */
function dragTarget(event, { turns }) {
  if (event.button === MIDDLE || event.ctrlKey || event.altKey || event.metaKey) return "picture";
  return turns && (event.button === RIGHT || event.shiftKey) ? "light" : "object";
}

/**
 * Return the change of the view by a drag.
 * @param {HTMLElement} stage
 * @param {Scene} scene
 * @param {Knobs} values
 * @param {number} right pixels
 * @param {number} down pixels
 * @returns {Partial<Knobs>}
 */
function dragged(stage, scene, values, right, down) {
  const what = stage.dataset.dragging;
  const { width, height } = sizeOf(stage);
  if (what === "picture") return pan(scene, values, right / height, down / height);
  const degrees = DEGREES_ACROSS / Math.min(width, height);
  return (what === "light" ? dragLight : dragObject)(values, right * degrees, down * degrees);
}

/** Return the place of a pointer. @param {PointerEvent} event @returns {Place} */
function place({ clientX, clientY }) {
  return { x: clientX, y: clientY };
}
