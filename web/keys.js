/** Keys, as changes of the view. The help in index.html lists the same ones. */

import { pan } from "./camera.js";
import { dragObject } from "./gestures.js";
import { dragLight } from "./rotation.js";
import { SIDES } from "./sides.js";
import { OVERLAYS, niceStep, showNumber, sliderRange } from "./view.js";

const OBJECT_STEP = 5;
const LIGHT_STEP = 10;
const ZOOM_STEP = 1.12;
const PAN_STEP = 0.05; // heights of the picture
const ISOVALUE_STEPS = 100;

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const MOVES = { a: [-1, 0], d: [1, 0], w: [0, -1], s: [0, 1] };

/**
 * Listen to keys, except while another control needs them.
 * @param {object} scene answer of `readScene`
 * @param {import("./view.js").ViewModel} view
 * @param {{toggleHelp: () => void}} options
 */
export function attachKeys(scene, view, { toggleHelp }) {
  const { min, max } = sliderRange(scene, "isovalue");
  const step = (max - min) / ISOVALUE_STEPS;
  const shiftIsovalue = (by) => view.set({ isovalue: Number(showNumber(view.values.isovalue + by, niceStep(step))) });
  const move = (right, down) => view.set(pan(scene, view.values, right * PAN_STEP, down * PAN_STEP));
  const presses = {
    "+": () => view.set({ distance: view.values.distance / ZOOM_STEP }),
    "-": () => view.set({ distance: view.values.distance * ZOOM_STEP }),
    "[": () => shiftIsovalue(-step),
    "]": () => shiftIsovalue(step),
    0: () => view.reset(),
    o: () => view.set({ overlay: next(OVERLAYS, view.values.overlay) }),
    "?": toggleHelp,
    ...Object.fromEntries(Object.entries(MOVES).map(([key, way]) => [key, () => move(...way)])),
    ...Object.fromEntries(Object.entries(SIDES).map(([side, angles]) => [keyOf(side), () => view.set(angles)])),
  };
  presses["="] = presses["+"];
  presses["−"] = presses._ = presses["-"];
  for (const key of ["o", ...Object.keys(MOVES)]) presses[key.toUpperCase()] = presses[key];

  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || types(event.target)) return;
    const press = event.key in ARROWS ? arrow(view, event, scene.turns) : presses[event.key];
    if (!press) return;
    event.preventDefault();
    press();
  });
}

function arrow(view, event, lightTurns) {
  if (!event.target.closest("#stage") && event.target !== document.body) return null;
  const [right, down] = ARROWS[event.key];
  if (!event.shiftKey) return () => view.set(dragObject(view.values, right * OBJECT_STEP, down * OBJECT_STEP));
  return lightTurns ? () => view.set(dragLight(view.values, right * LIGHT_STEP, down * LIGHT_STEP)) : null;
}

/** x looks from plus x, and X, with shift, from minus x. */
function keyOf([sign, axis]) {
  return sign === "+" ? axis : axis.toUpperCase();
}

function next(all, one) {
  return all[(all.indexOf(one) + 1) % all.length];
}

function types(target) {
  return target.matches("select, textarea, input:not([type=range], [type=checkbox])");
}
