/** Sliders, and the choices of shading, of what to compare it with, and of marks: what mirrors the view one to one. */

import { attachTint } from "./surface.js";
import { errorInWords } from "./units.js";
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
  const { shading, compare, overlay } = form.elements;
  const shadings = scene.shadings.map((id) => new Option(shadingName(id), id));
  shading.replaceChildren(...shadings);
  compare.replaceChildren(new Option("Nothing", ""), ...shadings.map((option) => option.cloneNode(true)));
  mirrors.push(...[shading, compare, overlay].map((select) => attachChoice(select, view)), offerOthers(compare));
  mirrors.push(attachTint(form.elements.tint, view));
  mirrors.push(attachScale(form.querySelector("#error-scale"), scene.error_scale));
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
  if (name === "albedo") return value.toFixed(2);
  if (name === "distance") return `${value.toFixed(2)} radii`;
  const stops = Number(Math.log2(value / scene.defaults.exposure).toFixed(1));
  return `${stops > 0 ? "+" : ""}${stops} stops`.replace("-", "−");
}

function attachChoice(select, view) {
  select.addEventListener("change", () => view.set({ [select.name]: select.value }));
  return (values) => { select.value = values[select.name]; };
}

/** A shading is compared with others alone. */
function offerOthers(compare) {
  return ({ shading }) => {
    for (const option of compare.options) option.hidden = option.disabled = option.value === shading;
  };
}

/** The legend of the colours of errors, shown while they are. */
function attachScale(legend, { low, high, colours }) {
  legend.querySelector(".colours").style.background = `linear-gradient(90deg, ${colours.join(", ")})`;
  const decades = Math.round(Math.log10(high / low));
  const ticks = Array.from({ length: decades + 1 }, (_, i) => errorInWords(low * 10 ** i));
  legend.querySelector(".row").replaceChildren(...ticks.map((text) => Object.assign(document.createElement("span"), { textContent: text })));
  return ({ overlay }) => { legend.hidden = overlay !== "error"; };
}
