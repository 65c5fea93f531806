/** Keys, as changes of the view. The help in index.html lists the same ones. */

import { dragObject } from "./gestures.js";
import { dragLight } from "./rotation.js";
import { niceStep, showNumber, sliderRange } from "./view.js";

const OBJECT_STEP = 5;
const LIGHT_STEP = 10;
const ZOOM_STEP = 1.12;
const ISOVALUE_STEPS = 100;

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

/**
 * Listen to keys, except while another control needs them.
 * @param {object} scene answer of `readScene`
 * @param {import("./view.js").ViewModel} view
 * @param {{lightTurns: boolean, toggleHelp: () => void}} options
 */
export function attachKeys(scene, view, { lightTurns, toggleHelp }) {
  const { min, max } = sliderRange(scene, "isovalue");
  const step = (max - min) / ISOVALUE_STEPS;
  const shiftIsovalue = (by) => view.set({ isovalue: Number(showNumber(view.values.isovalue + by, niceStep(step))) });
  const presses = {
    "+": () => view.set({ distance: view.values.distance / ZOOM_STEP }),
    "-": () => view.set({ distance: view.values.distance * ZOOM_STEP }),
    "[": () => shiftIsovalue(-step),
    "]": () => shiftIsovalue(step),
    0: () => view.reset(),
    o: () => view.set({ overlay: !view.values.overlay }),
    "?": toggleHelp,
  };
  presses["="] = presses["+"];
  presses["−"] = presses._ = presses["-"];
  presses.O = presses.o;

  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || types(event.target)) return;
    const press = event.key in ARROWS ? arrow(view, event, lightTurns) : presses[event.key];
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

function types(target) {
  return target.matches("select, textarea, input:not([type=range], [type=checkbox])");
}
