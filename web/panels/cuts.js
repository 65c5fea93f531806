/** What is seen: what two sliders along each axis cut away, with or without light, and which surfaces are beside. */

import { find, textElement } from "../dom.js";
import { niceStep } from "../view/format.js";
import { AXES, readPlanes, writePlanes } from "../view/planes.js";
import { readSurfaces, writeSurfaces } from "../view/surfaces.js";

/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {import("../net/schemas.js").Surface} Surface */
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

/**
 * Tie a switch and a slider for each surface to the view, both ways; without surfaces the panel is hidden.
 * @param {HTMLElement} panel holds `#surface-rows`
 * @param {{surfaces?: Surface[]}} scene
 * @param {ViewModel} view
 */
export function attachSurfaces(panel, { surfaces = [] }, view) {
  panel.hidden = !surfaces.length;
  const shown = () => readSurfaces(view.values.surfaces, surfaces);
  const rows = surfaces.map((surface, k) => rowOf(surface, k, (patch) => {
    const next = shown().map((each, at) => (at === k ? { ...each, ...patch } : each));
    view.set({ surfaces: writeSurfaces(next, surfaces) });
  }));
  find(panel, "#surface-rows").replaceChildren(...rows.map(({ node }) => node));
  const mirror = () => shown().forEach((each, k) => rows[k].show(each));
  mirror();
  view.subscribe(mirror);
  if (view.values.surfaces) panel.toggleAttribute("open", true);
}

/**
 * The switch and the slider of a surface. The slider is let go before light is baked for its value.
 * @param {Surface} surface
 * @param {number} k its number
 * @param {(patch: Partial<import("../view/surfaces.js").Shown>) => void} set
 */
function rowOf({ name, isovalue }, k, set) {
  const [box, label, title, output, input] = ["input", "label", "label", "output", "input"].map((tag) => document.createElement(tag));
  const check = /** @type {HTMLInputElement} */ (box), slider = /** @type {HTMLInputElement} */ (input);
  const value = /** @type {HTMLOutputElement} */ (output);
  const called = name || `Surface at ${isovalue}`;
  Object.assign(check, { type: "checkbox", id: `surface-${k}`, name: `surface-${k}` });
  Object.assign(slider, { type: "range", id: `clear-${k}`, name: `clear-${k}`, min: 0, max: 1, step: 0.05 });
  Object.assign(label, { className: "check" }).append(check, ` ${called}`);
  Object.assign(title, { htmlFor: slider.id, textContent: "Lets pass" });
  title.setAttribute("aria-label", `${called} lets pass`);
  const tell = () => {
    value.value = `${Math.round(100 * slider.valueAsNumber)} %`;
    slider.setAttribute("aria-valuetext", value.value);
  };
  check.addEventListener("change", () => set({ shown: check.checked }));
  slider.addEventListener("input", tell);
  slider.addEventListener("change", () => set({ clear: slider.valueAsNumber }));
  const knob = Object.assign(document.createElement("div"), { className: "knob" });
  knob.append(title, value, slider);
  const node = document.createElement("div");
  node.append(label, knob);
  /** @param {import("../view/surfaces.js").Shown} now */
  const show = ({ shown, clear }) => {
    check.checked = shown;
    slider.valueAsNumber = clear;
    slider.disabled = !shown;
    tell();
  };
  return { node, show };
}
