/** Pointer, touch and wheel on the stage, as changes of the view. */

import { pan } from "./camera.js";
import { dragLight } from "./rotation.js";

const DEGREES_ACROSS = 220; // a drag over the shorter side of the stage turns by this much
const WHEEL_RATE = 0.0012;
const PINCH_WHEEL_RATE = 0.008; // a pinch on a touchpad comes as small wheel steps with ctrl
const LINE_PIXELS = 16;
const [MIDDLE, RIGHT] = [1, 2];

/**
 * Turn the object as if held: dragged right its front moves right, dragged down it tips towards the viewer.
 * @param {object} values knobs of the view
 * @param {number} right degrees
 * @param {number} down degrees
 * @returns {{azimuth: number, elevation: number}}
 */
export function dragObject(values, right, down) {
  return { azimuth: values.azimuth - right, elevation: values.elevation + down };
}

/**
 * Listen to the pointer: drag turns the object, right or shift drag the light, middle, ctrl or alt drag moves the
 * picture, two fingers move and zoom it, and the wheel zooms.
 * @param {HTMLElement} stage
 * @param {object} scene answer of `readScene`
 * @param {import("./view.js").ViewModel} view
 * @param {{onRest: () => void}} options `onRest` is called when the last finger leaves
 */
export function attachGestures(stage, scene, view, { onRest }) {
  const fingers = new Map();
  let grip = null; // where the fingers were, and the view was, when the last one came

  stage.addEventListener("pointerdown", (event) => {
    if (event.target.closest("#trouble")) return;
    stage.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, place(event));
    stage.dataset.dragging = fingers.size > 1 ? "picture" : wanted(event, scene);
    grip = { ...hold(fingers), values: view.values };
  });

  stage.addEventListener("pointermove", (event) => {
    if (!fingers.has(event.pointerId)) return;
    const before = hold(fingers);
    fingers.set(event.pointerId, place(event));
    const after = hold(fingers);
    if (fingers.size > 1) view.set(pinched(stage, scene, grip, after));
    else view.set(dragged(stage, scene, view.values, after.x - before.x, after.y - before.y));
  });

  const release = (event) => {
    if (!fingers.delete(event.pointerId) || fingers.size) return;
    delete stage.dataset.dragging;
    onRest();
  };
  stage.addEventListener("pointerup", release);
  stage.addEventListener("pointercancel", release);
  stage.addEventListener("contextmenu", (event) => event.preventDefault());
  stage.addEventListener("mousedown", (event) => event.button === MIDDLE && event.preventDefault()); // or it scrolls
  stage.addEventListener("wheel", (event) => zoom(view, event), { passive: false });
}

function wanted(event, { turns }) {
  if (event.button === MIDDLE || event.ctrlKey || event.altKey || event.metaKey) return "picture";
  return turns && (event.button === RIGHT || event.shiftKey) ? "light" : "object";
}

function dragged(stage, scene, values, right, down) {
  const what = stage.dataset.dragging;
  if (what === "picture") return pan(scene, values, right / stage.clientHeight, down / stage.clientHeight);
  const degrees = DEGREES_ACROSS / Math.min(stage.clientWidth, stage.clientHeight);
  return (what === "light" ? dragLight : dragObject)(values, right * degrees, down * degrees);
}

/** Fingers come one at a time: what they do together is told from where they were first, not from the last of them. */
function pinched(stage, scene, { values, x, y, spread }, now) {
  const distance = values.distance * (spread / Math.max(1, now.spread));
  const [right, down] = [(now.x - x) / stage.clientHeight, (now.y - y) / stage.clientHeight];
  return { distance, ...pan(scene, { ...values, distance }, right, down) };
}

function place({ clientX, clientY }) {
  return { x: clientX, y: clientY };
}

/** The middle between all fingers, and how far the first two are apart. */
function hold(fingers) {
  const places = [...fingers.values()];
  const [a, b] = places;
  return {
    x: places.reduce((sum, { x }) => sum + x, 0) / places.length,
    y: places.reduce((sum, { y }) => sum + y, 0) / places.length,
    spread: b ? Math.hypot(a.x - b.x, a.y - b.y) : 0,
  };
}

function zoom(view, event) {
  event.preventDefault();
  const pixels = event.deltaY * (event.deltaMode === WheelEvent.DOM_DELTA_LINE ? LINE_PIXELS : 1);
  const rate = event.ctrlKey ? PINCH_WHEEL_RATE : WHEEL_RATE;
  view.set({ distance: view.values.distance * Math.exp(pixels * rate) });
}
