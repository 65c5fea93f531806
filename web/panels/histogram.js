/** The volume's histogram, with the isovalue slider on top of it, and the slider's stops below. */

import { find, svgElement } from "../dom.js";
import { isovalueComplaint } from "../net/address.js";
import { niceStep, showNumber } from "../view/format.js";
import { PAGES, nextStop } from "../view/keys.js";
import { sliderRange } from "../view/model.js";
import { setLimits } from "./knobs.js";

/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {import("../view/model.js").Knobs} Knobs */

const [WIDTH, HEIGHT] = [1000, 100];

/**
 * Draw the histogram and tie slider and number field to the view's isovalue, both ways; a single
 * one is locked.
 * @param {HTMLElement} form holds `#isovalue`, `#isovalue-number`, `#histogram` and `#stops`
 * @param {Scene} scene
 * @param {import("../view/model.js").ViewModel} view
 * @param {(words: string) => void} say tells a person what cannot be shown
 */
export function attachHistogram(form, scene, view, say) {
  const allowed = sliderRange(scene, "isovalue");
  const single = allowed.min === allowed.max;
  const [min, max] = single ? scene.volume.value_range : [allowed.min, allowed.max];
  const [slider, number] = ["#isovalue", "#isovalue-number"].map((id) =>
    find(form, id, HTMLInputElement),
  );
  const show = (/** @type {number} */ value) => showNumber(value, niceStep(max - min));
  setLimits(slider, min, max);
  Object.assign(number, { min, max });
  slider.disabled = number.disabled = single;
  find(form, "#isovalue-min").textContent = show(min);
  find(form, "#isovalue-max").textContent = show(max);
  slider.addEventListener("input", () => view.set({ isovalue: slider.valueAsNumber }));
  slider.addEventListener("keydown", (event) => {
    if (!(event.key in PAGES)) return;
    event.preventDefault();
    view.set({ isovalue: nextStop(scene.stops, view.values.isovalue, PAGES[event.key]) });
  });
  number.addEventListener("change", () => {
    say(isovalueComplaint(scene, number.valueAsNumber));
    view.set({ isovalue: number.valueAsNumber });
    mirror(view.values);
  });
  if (scene.solid === "below") find(form, "#histogram-note").textContent = "values below are solid";
  const solid = drawBars(
    find(form, "#histogram", SVGSVGElement),
    outline(scene.histogram, min, max),
  );
  const ticks = svgElement("path", { d: ticksAt(scene.stops, min, max) });
  find(form, "#stops", SVGSVGElement).replaceChildren(
    svgElement("title", {}, stopsInWords(scene.stops_note)),
    ticks,
  );
  find(form, "#stops-note").textContent = stopsInWords(scene.stops_note);
  // labels have no isovalue: their surface is that of the parts shown
  if (scene.colours?.labels.length)
    for (const part of form.querySelectorAll("#isovalue-part > .of-values")) hide(part);
  /** @param {Knobs} values */
  const mirror = ({ isovalue }) => {
    slider.value = String(isovalue);
    slider.setAttribute("aria-valuetext", show(isovalue));
    if (document.activeElement !== number || number.valueAsNumber !== isovalue)
      number.value = show(isovalue);
    const { x, width } = solidSpan((isovalue - min) / (max - min || 1), scene.solid === "below");
    solid.setAttribute("x", String(x));
    solid.setAttribute("width", String(width));
  };
  mirror(view.values);
  view.subscribe(mirror);
}

/** @param {Element} part */
function hide(part) {
  part.toggleAttribute("hidden", true);
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
  const x = (/** @type {number} */ value) => (WIDTH * share(value - min, max - min)).toFixed(1);
  const y = (/** @type {number} */ height) =>
    (HEIGHT * (1 - 0.94 * Math.min(1, height / tallest))).toFixed(1);
  const steps = heights.map(
    (height, i) => `L${x(edges[i])} ${y(height)}L${x(edges[i + 1])} ${y(height)}`,
  );
  return `M0 ${HEIGHT}${steps.join("")}L${WIDTH} ${HEIGHT}Z`;
}

/**
 * A line from top to bottom at each stop between two values, as the data of an SVG path in a box of
 * 1000 × 100.
 * @param {number[]} stops
 * @param {number} min
 * @param {number} max
 * @returns {string}
 */
export function ticksAt(stops, min, max) {
  return stops
    .map((stop) => `M${(WIDTH * share(stop - min, max - min)).toFixed(1)} 0V${HEIGHT}`)
    .join("");
}

/**
 * What the stops are.
 * @param {string} note where they are even
 * @returns {string}
 */
export function stopsInWords(note) {
  const what =
    "Ticks below the histogram, keys [ and ]: from one to the next the surface moves about equally far.";
  return `${what} ${note}`.trim();
}

/**
 * The part of the drawing whose values are solid.
 * @param {number} split share of the width at which the isovalue is
 * @param {boolean} below whether what is below the isovalue is solid
 * @returns {{x: number, width: number}}
 */
export function solidSpan(split, below) {
  const at = WIDTH * share(split, 1);
  return below ? { x: 0, width: at } : { x: at, width: WIDTH - at };
}

/**
 * @param {number} part
 * @param {number} whole
 */
function share(part, whole) {
  return Math.min(1, Math.max(0, part / (whole || 1)));
}

/**
 * Draw the bars, and over them the solid ones.
 * @param {SVGSVGElement} svg
 * @param {string} path
 * @returns {SVGRectElement} what is seen of the solid ones
 */
function drawBars(svg, path) {
  const clip = svgElement("clipPath", { id: "solid-side" });
  const window = clip.appendChild(svgElement("rect", { x: 0, y: 0, width: WIDTH, height: HEIGHT }));
  const all = svgElement("path", { d: path, class: "bars" });
  const solid = svgElement("path", {
    d: path,
    class: "bars solid",
    "clip-path": "url(#solid-side)",
  });
  svg.replaceChildren(clip, all, solid);
  return window;
}
