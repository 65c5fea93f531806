/** What is seen: what planes cut away, with or without light, which surfaces are beside, and which labels are shown. */

import { find } from "../dom.js";
import { MOST_OBLIQUE, facingPlane, moved, movablePlanes, readPlanes, termOf, writePlanes } from "../view/planes.js";
import { cameraAxes } from "../view/rotation.js";
import { readHidden, readSurfaces, writeHidden, writeSurfaces } from "../view/surfaces.js";

/** @typedef {import("../net/schemas.js").Label} Label */
/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {import("../net/schemas.js").Surface} Surface */
/** @typedef {import("../view/model.js").ViewModel} ViewModel */

/**
 * Tie the sliders to the view, both ways.
 * @param {HTMLElement} panel holds `#cut-sliders`, `#oblique`, `#opened`, `#cut-note`, `#add-plane` and `#uncut`
 * @param {Pick<Scene, "volume"|"cuts">} scene
 * @param {ViewModel} view
 */
export function attachCuts(panel, { volume, cuts }, view) {
  const [opened, note] = [find(panel, "#opened", HTMLInputElement), find(panel, "#cut-note")];
  const [add, uncut] = ["#add-plane", "#uncut"].map((id) => find(panel, id, HTMLButtonElement));
  const [sides, oblique] = [find(panel, "#cut-sliders"), find(panel, "#oblique")];
  const label = /** @type {HTMLElement} */ (opened.parentElement);
  label.hidden = !cuts;
  opened.addEventListener("change", () => view.set({ opened: opened.checked }));
  uncut.addEventListener("click", () => view.set({ planes: "" }));
  const others = (/** @type {(terms: string[]) => string[]} */ change) => {
    const planes = readPlanes(view.values.planes, volume.bounds);
    view.set({ planes: writePlanes({ ...planes, others: change(planes.others) }, volume.bounds) });
  };
  const facing = () => {
    const { planes, azimuth, elevation } = view.values;
    return termOf(facingPlane(readPlanes(planes, volume.bounds), cameraAxes(azimuth, elevation).out));
  };
  add.addEventListener("click", () => others((terms) => [...terms, facing()]));
  /** @type {Row[]} */
  const rows = [];
  const mirror = () => {
    const { planes, opened: open } = view.values, all = movablePlanes(volume, planes);
    while (rows.length > all.length) rows.pop()?.node.remove();
    for (let k = rows.length; k < all.length; k++) {
      const row = planeRow(k, volume, view);
      if (k >= SIDES) row.node.append(buttonsOf([
        plainButton("Face me", () => others((terms) => terms.with(k - SIDES, facing()))),
        plainButton("Remove", () => others((terms) => terms.toSpliced(k - SIDES, 1))),
      ]));
      (k < SIDES ? sides : oblique).append(row.node);
      rows.push(row);
    }
    all.forEach((plane, k) => rows[k].show(plane));
    opened.checked = open;
    uncut.disabled = !planes;
    add.disabled = all.length >= SIDES + MOST_OBLIQUE;
    note.textContent = cutInWords(open, all.length > SIDES);
  };
  mirror();
  view.subscribe(mirror);
  if (view.values.planes) panel.toggleAttribute("open", true);
}

const SIDES = 6; // of a box

/**
 * What light does where something is cut away.
 * @param {boolean} opened whether it comes in
 * @param {boolean} oblique whether there are planes along no axis
 */
function cutInWords(opened, oblique) {
  if (!opened) return "All stays lit as a whole, and cut faces show values.";
  return oblique ? "Light comes in by the sides of the box. Oblique planes are windows, and show values: of voxels, their faces would be stairs." : "What is left is lit anew.";
}

/** @param {HTMLElement[]} buttons */
function buttonsOf(buttons) {
  const row = Object.assign(document.createElement("div"), { className: "buttons" });
  row.append(...buttons);
  return row;
}

/** @param {string} text @param {() => void} action */
function plainButton(text, action) {
  const button = Object.assign(document.createElement("button"), { type: "button", textContent: text });
  button.addEventListener("click", action);
  return button;
}

/** @typedef {{node: HTMLElement, show: (plane: import("../view/planes.js").Movable) => void}} Row */

/**
 * The slider of a plane, and what shows its value.
 * @param {number} k number of the plane
 * @param {Scene["volume"]} volume
 * @param {ViewModel} view
 * @returns {Row}
 */
function planeRow(k, volume, view) {
  const [label, output, input] = [document.createElement("label"), document.createElement("output"), document.createElement("input")];
  const node = Object.assign(document.createElement("div"), { className: "knob" });
  const { name, range: [min, max] } = movablePlanes(volume, view.values.planes)[k];
  const id = `cut-${name.replace(" ", "-")}`;
  Object.assign(input, { type: "range", id, name: id, min, max, step: "any" });
  input.addEventListener("input", () => view.set({ planes: moved(movablePlanes(volume, view.values.planes)[k], input.valueAsNumber) }));
  label.htmlFor = output.htmlFor.value = id;
  label.textContent = name;
  node.append(label, output, input);
  /** @param {import("../view/planes.js").Movable} plane */
  const show = ({ value, range: [low, high] }) => {
    Object.assign(input, { min: String(low), max: String(high), value: String(value) });
    output.value = `${Number(value.toPrecision(4))} ${volume.unit}`.trim().replace("-", "−");
    input.setAttribute("aria-valuetext", output.value);
  };
  return { node, show };
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
  const rows = surfaces.map((surface, k) => surfaceRow(surface, k, (patch) => {
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
function surfaceRow({ name, isovalue }, k, set) {
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

/**
 * Tie a switch for each label to the view, both ways; there are none where the scene is no segmentation.
 * @param {HTMLElement} legend holds `.labels` and `#labels-all`
 * @param {Pick<Scene, "colours">} scene
 * @param {ViewModel} view
 */
export function attachLabels(legend, { colours }, view) {
  const labels = colours?.labels ?? [];
  const all = find(legend, "#labels-all", HTMLButtonElement);
  const now = () => readHidden(view.values.hide, labels);
  /** @type {(hidden: number[]) => void} */
  const hide = (hidden) => view.set({ hide: writeHidden(hidden, labels) });
  const rows = labels.map((label) => labelRow(label, (shown) => {
    const others = now().filter((value) => value !== label.value);
    hide(shown ? others : [...others, label.value]);
  }));
  find(legend, ".labels").replaceChildren(...rows.map(({ node }) => node));
  all.addEventListener("click", () => hide([]));
  const mirror = () => {
    const hidden = now(), alone = labels.length - hidden.length === 1;
    labels.forEach(({ value }, k) => rows[k].show(!hidden.includes(value), alone));
    all.hidden = !hidden.length;
  };
  mirror();
  view.subscribe(mirror);
}

/**
 * A label of a segmentation: its switch, its swatch and its name.
 * @param {Label} label
 * @param {(shown: boolean) => void} set
 */
function labelRow({ name, colour }, set) {
  const [node, label, check] = [document.createElement("li"), document.createElement("label"), document.createElement("input")];
  check.type = "checkbox";
  check.addEventListener("change", () => set(check.checked));
  label.style.setProperty("--swatch", colour);
  label.append(check, name);
  node.append(label);
  /** @type {(shown: boolean, alone: boolean) => void} */
  const show = (shown, alone) => {
    check.checked = shown;
    check.disabled = shown && alone; // one is always shown
    label.title = check.disabled ? "Show another one before you hide this" : "";
  };
  return { node, show };
}
