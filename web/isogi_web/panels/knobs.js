/**
 * Sliders, choices and buttons that mirror the view one to one: camera, light, shading and
 * marks.
 */

import { find, textElement } from "../dom.js";
import { AXIS_VIEWS, looksAlong } from "../view/camera.js";
import { niceStep, shadingName } from "../view/format.js";
import { SMOOTH_STEPS, UNITS, inShort, sliderRange } from "../view/model.js";
import { decades, legendNumbers } from "../view/rulers.js";
import { idleKnobs } from "../view/surfaces.js";

/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {import("../view/model.js").Knobs} Knobs */
/** @typedef {import("../view/model.js").NumberKnob} NumberKnob */
/** @typedef {import("../view/model.js").ViewModel} ViewModel */
/** @typedef {(values: Knobs) => void} Mirror shows the view's values */

/**
 * Tie the form's controls to the view, both ways. Knobs that the scene does not have are hidden.
 * @param {HTMLElement} form
 * @param {Scene} scene
 * @param {ViewModel} view
 * @param {import("../view/rulers.js").Seen} shown
 */
export function attachKnobs(form, scene, view, shown) {
  const select = (/** @type {string} */ id) => find(form, id, HTMLSelectElement);
  const [shading, overlay] = ["#shading", "#overlay"].map(select);
  const [background, rulers, projection] = ["#background", "#rulers-choice", "#projection"].map(
    select,
  );
  const shadings = scene.shadings.map((id) => new Option(shadingName(id), id));
  shading.replaceChildren(...shadings);
  const sliders = [...form.querySelectorAll(".knob")].map((knob) =>
    attachSlider(knob, scene, view),
  );
  // Each control changes the view, and gives a function that shows the view's value.
  const mirrors = [
    ...sliders,
    attachChoice(shading, "shading", view),
    attachChoice(overlay, "overlay", view),
    attachChoice(background, "background", view),
    attachChoice(rulers, "rulers", view),
    attachChoice(projection, "projection", view),
    attachTint(find(form, "#tint", HTMLInputElement), view),
    attachShine(select("#shine"), scene, view),
    attachAxisViews(find(form, "#axis-views"), view),
  ];
  /** @param {Knobs} values */
  const mirror = (values) => mirrors.forEach((each) => each(values));
  mirror(view.values);
  view.subscribe(mirror);
  attachScale(find(form, "#error-scale"), scene.error_scale, shown);
  showColours(find(form, "#colour-scale"), scene.colours);
}

/**
 * Give a range input the limits and the step of a knob.
 * @param {HTMLInputElement} input
 * @param {number} min
 * @param {number} max
 */
export function setLimits(input, min, max) {
  const steps = /** @type {Record<string, number>} */ ({ time: 1, smooth: 1 / SMOOTH_STEPS });
  Object.assign(input, { min, max, step: steps[input.name] ?? niceStep(max - min) });
}

/**
 * Write the value of a knob with its unit.
 * @param {NumberKnob} name
 * @param {number} value
 * @param {number} exposure default of the scene, from which stops are counted
 * @returns {string}
 */
export function knobInWords(name, value, exposure) {
  const unit = UNITS[name];
  if (unit === "degrees") return `${Math.round(value)}°`.replace("-", "−");
  if (unit === "share") return value.toFixed(2);
  if (unit === "voxels") return value ? `${value} voxels` : "none";
  if (unit === "step") return `step ${value}`;
  if (unit === "radii") return `${value.toFixed(2)} radii`;
  const stops = Number(Math.log2(value / exposure).toFixed(1));
  const stop = Math.abs(stops) === 1 ? "stop" : "stops";
  return `${stops > 0 ? "+" : ""}${stops} ${stop}`.replace("-", "−");
}

/**
 * Write the value of a knob as a screen reader should say it, without signs.
 * @param {NumberKnob} name
 * @param {number} value
 * @param {number} exposure default of the scene, from which stops are counted
 * @returns {string}
 */
export function knobSpoken(name, value, exposure) {
  const minus = value < 0 ? "minus " : "";
  if (UNITS[name] === "degrees") return `${minus}${Math.round(Math.abs(value))} degrees`;
  if (name !== "exposure") return knobInWords(name, value, exposure);
  const stops = Number(Math.log2(value / exposure).toFixed(1));
  if (stops === 0) return "as the scene has it";
  const words = knobInWords(name, value, exposure).replace(/^[+−]/, "");
  return `${words} ${stops > 0 ? "brighter" : "darker"}`;
}

/**
 * Tie a slider to the view, both ways.
 * @param {Element} knob holds a range input and an output
 * @param {Scene} scene
 * @param {ViewModel} view
 * @returns {Mirror}
 */
export function attachSlider(knob, scene, view) {
  const [input, output] = [
    find(knob, "input", HTMLInputElement),
    find(knob, "output", HTMLOutputElement),
  ];
  const name = /** @type {NumberKnob} */ (input.name);
  knob.toggleAttribute("hidden", !(name in view.values));
  if (!(name in view.values)) return () => {};
  let range = sliderRange(scene, name);
  const [inward, outward] = range.log
    ? [Math.log10, (/** @type {number} */ x) => 10 ** x]
    : [Number, Number];
  setLimits(input, inward(range.min), inward(range.max));
  // Each step of smoothing is another volume: wait until the slider is released.
  const moved = name === "smooth" ? "change" : "input";
  input.addEventListener(moved, () => view.set({ [name]: outward(input.valueAsNumber) }));
  return ({ [name]: value = NaN, material }) => {
    knob.toggleAttribute("hidden", name === "albedo" && idleKnobs(material).includes(name));
    if (name === "exposure") {
      // The range depends on the light.
      range = sliderRange(scene, name);
      setLimits(input, inward(range.min), inward(range.max));
    }
    input.value = String(inward(value));
    output.value =
      name === "isovalue"
        ? String(inShort(scene, name, value))
        : knobInWords(name, value, scene.defaults.exposure);
    const spoken =
      name === "isovalue" ? output.value : knobSpoken(name, value, scene.defaults.exposure);
    input.setAttribute("aria-valuetext", spoken);
  };
}

/**
 * Tie a choice to the view, both ways.
 * @param {HTMLSelectElement} select
 * @param {"shading"|"overlay"|"background"|"rulers"|"projection"} name
 * @param {ViewModel} view
 * @returns {Mirror}
 */
function attachChoice(select, name, view) {
  select.addEventListener("change", () => view.set({ [name]: select.value }));
  return (values) => {
    select.value = values[name];
  };
}

/**
 * Tie the colour field to the view; hide it if the albedo is fixed.
 * @param {HTMLInputElement} input
 * @param {ViewModel} view
 * @returns {Mirror}
 */
function attachTint(input, view) {
  const fixed = view.values.tint === undefined;
  if (input.parentElement) input.parentElement.hidden = fixed;
  if (fixed) return () => {};
  input.addEventListener("input", () => view.set({ tint: input.value }));
  return ({ tint = "", material }) => {
    input.value = tint;
    if (input.parentElement) input.parentElement.hidden = idleKnobs(material).includes("tint");
  };
}

/**
 * Tie the choice of the shine to the view; hide it if the scene has none.
 * @param {HTMLSelectElement} select
 * @param {Scene} scene
 * @param {ViewModel} view
 * @returns {Mirror}
 */
function attachShine(select, scene, view) {
  const dull = view.values.shine === undefined;
  if (select.parentElement) select.parentElement.hidden = dull;
  if (dull) return () => {};
  select.replaceChildren(
    ...scene.shines.map((kind) => new Option(kind[0].toUpperCase() + kind.slice(1), kind)),
  );
  select.addEventListener("change", () => view.set({ shine: select.value }));
  return ({ shine = "" }) => {
    select.value = shine;
  };
}

/**
 * Draw the legend of errors, and show it while the picture on the stage has their colours.
 * @param {HTMLElement} legend
 * @param {Scene["error_scale"]} scale
 * @param {import("../view/rulers.js").Seen} shown
 */
function attachScale(legend, { low, high, colours }, shown) {
  find(legend, ".colours").style.background = `linear-gradient(90deg, ${colours.join(", ")})`;
  find(legend, ".row").replaceChildren(
    ...decades({ low, high }).map((text) => textElement("span", text)),
  );
  const draw = () => {
    legend.hidden = shown.values.overlay !== "error";
  };
  shown.subscribe(draw);
  draw();
}

/**
 * Draw the legend of the surface's colours, if data gives them.
 * @param {HTMLElement} legend
 * @param {Scene["colours"]} scale
 */
function showColours(legend, scale) {
  legend.hidden = !scale;
  if (!scale) return;
  const { name, low, high, colours, labels } = scale;
  for (const part of [".colours", ".row"]) find(legend, part).hidden = labels.length > 0;
  find(legend, "h2").textContent = labels.length ? "Labels" : `Colour: ${name}`;
  if (labels.length) return;
  find(legend, ".colours").style.background = `linear-gradient(90deg, ${colours.join(", ")})`;
  find(legend, ".row").replaceChildren(
    ...legendNumbers(low, high).map((text) => textElement("span", text)),
  );
}

/**
 * Let buttons look along axes; the button of the current view is pressed.
 * @param {HTMLElement} group holds a button with `data-view` for each of AXIS_VIEWS
 * @param {ViewModel} view
 * @returns {Mirror}
 */
function attachAxisViews(group, view) {
  const buttons = Object.entries(AXIS_VIEWS).map(([name, angles]) => ({
    angles,
    button: find(group, `[data-view="${name}"]`),
  }));
  for (const { angles, button } of buttons)
    button.addEventListener("click", () => view.set(angles));
  return (values) => {
    for (const { angles, button } of buttons)
      button.setAttribute("aria-pressed", String(looksAlong(angles, values)));
  };
}
