/** The volume's histogram, with the isovalue slider on top of it. */

import { setLimits } from "./knobs.js";
import { make } from "./svg.js";
import { niceStep, showNumber, sliderRange } from "./view.js";

const [WIDTH, HEIGHT] = [1000, 100];

/**
 * Draw the histogram and tie slider and number field to the view's isovalue, both ways; a single one is locked.
 * @param {HTMLFormElement} form holds `#isovalue`, `#isovalue-number` and `#histogram`
 * @param {object} scene answer of `readScene`
 * @param {import("./view.js").ViewModel} view
 */
export function attachHistogram(form, scene, view) {
  const allowed = sliderRange(scene, "isovalue");
  const single = allowed.min === allowed.max;
  const [min, max] = single ? scene.volume.value_range : [allowed.min, allowed.max];
  const [slider, number, svg] = ["#isovalue", "#isovalue-number", "#histogram"].map((id) => form.querySelector(id));
  setLimits(slider, min, max);
  Object.assign(number, { min, max });
  slider.disabled = number.disabled = single;
  form.querySelector("#isovalue-min").textContent = showNumber(min, niceStep(max - min));
  form.querySelector("#isovalue-max").textContent = showNumber(max, niceStep(max - min));
  slider.addEventListener("input", () => view.set({ isovalue: slider.valueAsNumber }));
  number.addEventListener("change", () => {
    view.set({ isovalue: number.valueAsNumber });
    mirror(view.values);
  });
  const inside = drawBars(svg, outline(scene.histogram, min, max));
  const mirror = ({ isovalue }) => {
    const text = showNumber(isovalue, niceStep(max - min));
    Object.assign(slider, { value: isovalue });
    slider.setAttribute("aria-valuetext", text);
    if (document.activeElement !== number || number.valueAsNumber !== isovalue) number.value = text;
    shadeSolid(inside, (isovalue - min) / (max - min || 1), scene.solid === "below");
  };
  mirror(view.values);
  view.subscribe(mirror);
}

/**
 * Outline of the log counts between two values, as the data of an SVG path in a box of 1000 × 100.
 * @param {{counts: number[], edges: number[]}} histogram
 * @param {number} min
 * @param {number} max
 * @returns {string}
 */
export function outline({ counts, edges }, min, max) {
  const heights = counts.map((count) => Math.log1p(count));
  const seen = heights.filter((_, i) => edges[i + 1] > min && edges[i] < max);
  const tallest = Math.max(...seen, 1e-9);
  const x = (value) => (WIDTH * Math.min(1, Math.max(0, (value - min) / (max - min || 1)))).toFixed(1);
  const y = (height) => (HEIGHT * (1 - 0.94 * Math.min(1, height / tallest))).toFixed(1);
  const steps = heights.map((height, i) => `L${x(edges[i])} ${y(height)}L${x(edges[i + 1])} ${y(height)}`);
  return `M0 ${HEIGHT}${steps.join("")}L${WIDTH} ${HEIGHT}Z`;
}

function drawBars(svg, path) {
  const clip = make("clipPath", { id: "solid-side" });
  const window = clip.appendChild(make("rect", { x: 0, y: 0, width: WIDTH, height: HEIGHT }));
  const all = make("path", { d: path, class: "bars" });
  const solid = make("path", { d: path, class: "bars solid", "clip-path": "url(#solid-side)" });
  svg.replaceChildren(clip, all, solid);
  return window;
}

function shadeSolid(window, share, below) {
  const split = WIDTH * Math.min(1, Math.max(0, share));
  window.setAttribute("x", below ? 0 : split);
  window.setAttribute("width", below ? split : WIDTH - split);
}
