/** Sliders, the shading choice and the overlay switch: the controls that mirror the view one to one. */

import { niceStep, sliderRange } from "./view.js";

const ANGLES = new Set(["azimuth", "elevation", "fov", "yaw", "pitch", "roll"]);
const SHADING_NAMES = {
  gi: "Global illumination", vicinity: "Vicinity shading", lambert: "Diffuse, no shadows",
  lambert_shadow: "Diffuse, shadows", lambert_fog: "Diffuse, depth fog", phong: "Phong, no shadows",
  phong_shadow: "Phong, shadows", path_traced: "Path traced (reference, slow)",
};

/**
 * What people call a shading.
 * @param {string} id
 * @returns {string}
 */
export function shadingName(id) {
  return SHADING_NAMES[id] ?? id;
}

/**
 * Tie the form's controls to the view, both ways. Knobs that the scene does not have are hidden.
 * @param {HTMLFormElement} form
 * @param {object} scene answer of `readScene`
 * @param {import("./view.js").ViewModel} view
 */
export function attachKnobs(form, scene, view) {
  const mirrors = [...form.querySelectorAll(".knob input")].map((input) => attachSlider(input, scene, view));
  mirrors.push(attachShading(form.elements.shading, scene, view), attachOverlay(form.elements.overlay, view));
  const mirror = (values) => mirrors.forEach((each) => each(values));
  mirror(view.values);
  view.subscribe(mirror);
}

/**
 * Give a range input the limits and the step of a knob.
 * @param {HTMLInputElement} input
 * @param {number} min
 * @param {number} max
 */
export function setLimits(input, min, max) {
  Object.assign(input, { min, max, step: niceStep(max - min) });
}

function attachSlider(input, scene, view) {
  const knob = input.closest(".knob");
  knob.hidden = !(input.name in view.values);
  if (knob.hidden) return () => {};
  const range = sliderRange(scene, input.name);
  const [inward, outward] = range.log ? [Math.log10, (x) => 10 ** x] : [Number, Number];
  setLimits(input, inward(range.min), inward(range.max));
  input.addEventListener("input", () => view.set({ [input.name]: outward(input.valueAsNumber) }));
  const output = knob.querySelector("output");
  return (values) => {
    input.value = inward(values[input.name]);
    output.value = describe(scene, input.name, values[input.name]);
    input.setAttribute("aria-valuetext", output.value);
  };
}

function describe(scene, name, value) {
  if (ANGLES.has(name)) return `${Math.round(value)}°`.replace("-", "−");
  if (name === "distance") return `${value.toFixed(2)} radii`;
  const stops = Number(Math.log2(value / scene.defaults.exposure).toFixed(1));
  return `${stops > 0 ? "+" : ""}${stops} stops`.replace("-", "−");
}

function attachShading(select, scene, view) {
  select.replaceChildren(...scene.shadings.map((id) => new Option(shadingName(id), id)));
  select.addEventListener("change", () => view.set({ shading: select.value }));
  return ({ shading }) => { select.value = shading; };
}

function attachOverlay(box, view) {
  box.addEventListener("change", () => view.set({ overlay: box.checked }));
  return ({ overlay }) => { box.checked = overlay; };
}
