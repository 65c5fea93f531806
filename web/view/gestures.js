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
 * @typedef {Place & {spread: number}} Hold the middle between all fingers, and how far the first
 *   two are apart
 */

const DEGREES_ACROSS = 220; // a drag over the shorter side of the stage turns by this much
const WHEEL_RATE = 0.0012;
const PINCH_WHEEL_RATE = 0.008; // a pinch on a touchpad comes as small wheel steps with ctrl
const LINE_PIXELS = 16;
const BY_LINE = 1; // `WheelEvent.DOM_DELTA_LINE`
const [MIDDLE, RIGHT] = [1, 2];
const [SLIP, FINGER_SLIP] = [4, 10]; // pixels that a click, and a tap, may move by

/**
 * Turn the object as if held: dragged right its front moves right, dragged down it tips towards the
 * viewer.
 * @param {{azimuth: number, elevation: number}} values knobs of the view
 * @param {number} right degrees
 * @param {number} down degrees
 * @returns {{azimuth: number, elevation: number}}
 */
export function dragObject(values, right, down) {
  return { azimuth: values.azimuth - right, elevation: values.elevation + down };
}

/**
 * Listen to the pointer: drag turns the object, right or shift drag the light, middle, ctrl or alt
 * drag moves the
 * picture, two fingers move and zoom it, and the wheel zooms.
 * @param {HTMLElement} stage
 * @param {Scene} scene
 * @param {ViewModel} view
 * @param {{onRest: () => void}} options `onRest` is called when the last finger leaves
 */
export function attachGestures(stage, scene, view, { onRest }) {
  /** @type {Map<number, Place>} */
  const fingers = new Map();
  // where the fingers were, and the view was, when the last one came
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
  // or it scrolls
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
 * Listen to clicks and double clicks on the stage, or taps: a click is where the pointer has not
 * moved meanwhile.
 * @param {HTMLElement} stage
 * @param {{click: (right: number, up: number) => void, double: (right: number, up: number) =>
 *   void}} hooks called with
 *   the place in the picture, in heights of the picture from its middle; a double click is a click
 * first
 */
export function attachClicks(stage, { click, double }) {
  /** @type {Place|null} */
  let pressed = null; // null after a drag, and where a click is no plain one
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
 * A place on the stage, in heights of the picture from its middle: to the right, and up.
 * @param {HTMLElement} stage
 * @param {MouseEvent} event
 * @returns {[number, number]}
 */
function placeIn(stage, { clientX, clientY }) {
  const { left, top, width, height } = stage.getBoundingClientRect();
  // a whole pixel is meant
  const [x, y] = [clientX, clientY].map((at) => (Number.isInteger(at) ? at + 0.5 : at));
  return [(x - left - width / 2) / height, (top + height / 2 - y) / height];
}

/**
 * The distance after two fingers have moved, and the target: what is between the fingers stays
 * there. Fingers come one
 * at a time, so a pinch counts from where they were first, and not from the last of their events.
 * @param {number} height of the stage, pixels
 * @param {Pick<Scene, "volume">} scene
 * @param {Hold & {values: Knobs}} grip where the fingers and the view were first
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
 * What fingers do together.
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
 * The factor by which a step of the wheel changes the distance.
 * @param {{deltaY: number, deltaMode: number, ctrlKey: boolean}} step
 * @returns {number}
 */
export function wheelZoom({ deltaY, deltaMode, ctrlKey }) {
  const pixels = deltaY * (deltaMode === BY_LINE ? LINE_PIXELS : 1);
  return Math.exp(pixels * (ctrlKey ? PINCH_WHEEL_RATE : WHEEL_RATE));
}

/** Whether an event belongs to a panel that lies over the picture. @param {Event} event */
function onPanel({ target }) {
  return target instanceof Element && target.closest(".over") !== null;
}

/**
 * @param {PointerEvent} event
 * @param {Scene} scene
 */
function dragTarget(event, { turns }) {
  if (event.button === MIDDLE || event.ctrlKey || event.altKey || event.metaKey) return "picture";
  return turns && (event.button === RIGHT || event.shiftKey) ? "light" : "object";
}

/**
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

/** @param {PointerEvent} event @returns {Place} */
function place({ clientX, clientY }) {
  return { x: clientX, y: clientY };
}
