/** Pointer, touch and wheel on the stage, as changes of the view. */

import { dragLight } from "./rotation.js";

const DEGREES_ACROSS = 220; // a drag over the shorter side of the stage turns by this much
const WHEEL_RATE = 0.0012;
const PINCH_WHEEL_RATE = 0.008; // a pinch on a touchpad comes as small wheel steps with ctrl
const LINE_PIXELS = 16;

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
 * Listen to the pointer: drag turns the object, right or shift drag the light, two fingers or the wheel zoom.
 * @param {HTMLElement} stage
 * @param {import("./view.js").ViewModel} view
 * @param {{lightTurns: boolean, onRest: () => void}} options `onRest` is called when the last finger leaves
 */
export function attachGestures(stage, view, { lightTurns, onRest }) {
  const fingers = new Map();

  stage.addEventListener("pointerdown", (event) => {
    if (event.target.closest("#trouble") || event.button === 1) return;
    stage.setPointerCapture(event.pointerId);
    stage.dataset.dragging = wantsLight(event) && lightTurns ? "light" : "object";
    fingers.set(event.pointerId, place(event));
  });

  stage.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    const apart = spread(fingers);
    fingers.set(event.pointerId, place(event));
    if (fingers.size > 1) return pinch(view, apart, spread(fingers));
    const degrees = DEGREES_ACROSS / Math.min(stage.clientWidth, stage.clientHeight);
    const drag = stage.dataset.dragging === "light" ? dragLight : dragObject;
    view.set(drag(view.values, (event.clientX - before.x) * degrees, (event.clientY - before.y) * degrees));
  });

  const release = (event) => {
    if (!fingers.delete(event.pointerId) || fingers.size) return;
    delete stage.dataset.dragging;
    onRest();
  };
  stage.addEventListener("pointerup", release);
  stage.addEventListener("pointercancel", release);
  stage.addEventListener("contextmenu", (event) => event.preventDefault());
  stage.addEventListener("wheel", (event) => zoom(view, event), { passive: false });
}

function wantsLight(event) {
  return event.button === 2 || event.shiftKey;
}

function place({ clientX, clientY }) {
  return { x: clientX, y: clientY };
}

function spread(fingers) {
  const [a, b] = [...fingers.values()];
  return b ? Math.hypot(a.x - b.x, a.y - b.y) : 0;
}

function pinch(view, before, after) {
  if (before > 0 && after > 0) view.set({ distance: view.values.distance * (before / after) });
}

function zoom(view, event) {
  event.preventDefault();
  const pixels = event.deltaY * (event.deltaMode === WheelEvent.DOM_DELTA_LINE ? LINE_PIXELS : 1);
  const rate = event.ctrlKey ? PINCH_WHEEL_RATE : WHEEL_RATE;
  view.set({ distance: view.values.distance * Math.exp(pixels * rate) });
}
