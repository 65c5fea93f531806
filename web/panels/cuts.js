/** What is cut away: two sliders along each axis, and whether light comes in. While a plane moves the scene stays whole. */

import { find, textElement } from "../dom.js";
import { niceStep } from "../view/format.js";
import { AXES, readPlanes, writePlanes } from "../view/planes.js";

/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {import("../view/model.js").ViewModel} ViewModel */

/**
 * Tie the sliders to the view, both ways.
 * @param {HTMLElement} panel holds `#cut-sliders`, `#opened` and `#uncut`
 * @param {Pick<Scene, "volume"|"cuts">} scene
 * @param {ViewModel} view
 */
export function attachCuts(panel, { volume, cuts }, view) {
  const opened = find(panel, "#opened", HTMLInputElement);
  const rows = AXES.map((name, axis) => rowsOf(name, axis, volume, view));
  find(panel, "#cut-sliders").replaceChildren(...rows.flatMap(({ nodes }) => nodes));
  const label = /** @type {HTMLElement} */ (opened.parentElement);
  label.hidden = !cuts;
  opened.addEventListener("change", () => view.set({ opened: opened.checked }));
  find(panel, "#uncut").addEventListener("click", () => view.set({ planes: "" }));
  const mirror = () => {
    const { planes, opened: open } = view.values;
    const { kept } = readPlanes(planes, volume.bounds);
    rows.forEach(({ show }, axis) => show(kept[axis]));
    opened.checked = open;
    find(panel, "#uncut", HTMLButtonElement).disabled = !planes;
  };
  mirror();
  view.subscribe(mirror);
  if (view.values.planes) panel.toggleAttribute("open", true);
}

/**
 * The two sliders of an axis, and what shows their values.
 * @param {string} name
 * @param {number} axis
 * @param {Scene["volume"]} volume
 * @param {ViewModel} view
 */
function rowsOf(name, axis, { bounds, unit }, view) {
  const [low, high] = [bounds[0][axis], bounds[1][axis]];
  const step = niceStep(high - low);
  const ends = ["from", "to"].map((end, side) => {
    const [label, output, input] = [document.createElement("label"), document.createElement("output"), document.createElement("input")];
    Object.assign(input, { type: "range", id: `cut-${name}-${end}`, name: `cut-${name}-${end}`, min: low, max: high, step: "any" });
    input.addEventListener("input", () => {
      const planes = readPlanes(view.values.planes, bounds);
      const value = Math.round(input.valueAsNumber / step) * step;
      const rounded = Number(Math.min(Math.max(value, low), high).toPrecision(8));
      planes.kept[axis][side] = side ? Math.max(rounded, planes.kept[axis][0]) : Math.min(rounded, planes.kept[axis][1]);
      view.set({ planes: writePlanes(planes, bounds) });
    });
    label.htmlFor = output.htmlFor.value = input.id;
    label.textContent = `${name} ${end}`;
    const node = textElement("div", "");
    node.className = "knob";
    node.append(label, output, input);
    return { node, input, output };
  });
  /** @param {import("../view/planes.js").Kept} kept */
  const show = (kept) => ends.forEach(({ input, output }, side) => {
    input.value = String(kept[side]);
    output.value = `${Number(kept[side].toPrecision(4))} ${unit}`.trim().replace("-", "−");
    input.setAttribute("aria-valuetext", output.value);
  });
  return { nodes: ends.map(({ node }) => node), show };
}
