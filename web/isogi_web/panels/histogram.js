/** The volume's histogram, with the isovalue slider on top of it, and the slider's stops below. */

import { find, svgElement } from "../dom.js";
import { isovalueComplaint } from "../net/address.js";
import { exactValue, niceStep, showNumber } from "../view/format.js";
import { PAGES, nextStop } from "../view/keys.js";
import { sliderRange } from "../view/model.js";
import { setLimits } from "./knobs.js";

/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {import("../view/model.js").Knobs} Knobs */

const [WIDTH, HEIGHT] = [1000, 100]; // box of the drawing, which is stretched to its place

/**
 * Draw the histogram, and tie slider and number field to the view's isovalue, both ways; both are
 * locked if the scene has a single isovalue.
 * @param {HTMLElement} form holds `#isovalue`, `#isovalue-number`, `#histogram` and `#stops`
 * @param {Scene} scene
 * @param {import("../view/model.js").ViewModel} view
 * @param {(words: string) => void} say shows a sentence about an isovalue that cannot be shown
 */
export function attachHistogram(form, scene, view, say) {
  const allowed = sliderRange(scene, "isovalue");
  // A single isovalue locks the slider, which then spans all values.
  const single = allowed.min === allowed.max;
  const [min, max] = single ? scene.volume.value_range : [allowed.min, allowed.max];
  const [slider, number] = ["#isovalue", "#isovalue-number"].map((id) =>
    find(form, id, HTMLInputElement),
  );
  const axis = axisOf(scene.histogram, min, max);
  const show = (/** @type {number} */ value) =>
    axis.logarithmic ? String(inDigits(value)) : showNumber(value, niceStep(max - min));
  setLimits(slider, axis.to(min), axis.to(max));
  if (axis.logarithmic) slider.step = "any"; // a step might end before the largest value
  Object.assign(number, { min, max });
  slider.disabled = number.disabled = single;
  find(form, "#isovalue-min").textContent = show(min);
  find(form, "#isovalue-max").textContent = show(max);
  // Change the view by slider, page keys and number field.
  slider.addEventListener("input", () => view.set({ isovalue: axis.from(slider.valueAsNumber) }));
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
  else if (axis.logarithmic)
    find(form, "#histogram-note").textContent = "how often each value occurs, by powers of ten";

  // Draw histogram, stops and notes.
  const ranks = attachRanks(form, scene, view);
  const solid = drawBars(
    find(form, "#histogram", SVGSVGElement),
    outline(scene.histogram, min, max, axis),
  );
  const ticks = svgElement("path", { d: ticksAt(scene.stops, min, max, axis) });
  find(form, "#stops", SVGSVGElement).replaceChildren(
    svgElement("title", {}, stopsInWords(scene.stops_note)),
    ticks,
  );
  find(form, "#stops-note").textContent = stopsInWords(scene.stops_note);
  // Labels have no isovalue: their surface is that of the labels shown.
  if (scene.colours?.labels.length)
    for (const part of form.querySelectorAll("#isovalue-part > .of-values")) hide(part);
  /** @param {Knobs} values */

  // Show the view's isovalue, unless the visitor is typing it.
  const mirror = ({ isovalue }) => {
    slider.value = String(axis.to(isovalue));
    slider.setAttribute("aria-valuetext", show(isovalue));
    if (document.activeElement !== number || number.valueAsNumber !== isovalue)
      number.value = String(exactValue(isovalue, scene.volume.value_range));
    ranks(isovalue);
    const { x, width } = solidSpan(axis.share(isovalue), scene.solid === "below");
    solid.setAttribute("x", String(x));
    solid.setAttribute("width", String(width));
  };
  mirror(view.values);
  view.subscribe(mirror);
}

/** Hide a part. @param {Element} part */
function hide(part) {
  part.toggleAttribute("hidden", true);
}

/**
 * @typedef {object} Axis
 * @property {boolean} logarithmic
 * @property {(value: number) => number} to returns the place of a value on the slider
 * @property {(place: number) => number} from returns the value at a place of the slider
 * @property {(value: number) => number} share returns the place of a value, 0 to 1
 */

/**
 * Return the axis of the isovalue: linear, or logarithmic. On a logarithmic axis, values below the
 * histogram's first bin are at the low end.
 * @param {{edges: number[], logarithmic?: boolean}} histogram
 * @param {number} min
 * @param {number} max
 * @returns {Axis}
 */
export function axisOf({ edges, logarithmic = false }, min, max) {
  const least = Math.max(min, edges[1]);
  if (!logarithmic || !(least < max)) {
    const same = (/** @type {number} */ value) => value;
    return {
      logarithmic: false,
      to: same,
      from: same,
      share: (value) => share(value - min, max - min),
    };
  }
  const [low, high] = [Math.log10(least), Math.log10(max)];
  const to = (/** @type {number} */ value) => Math.log10(Math.max(value, least));
  return {
    logarithmic: true,
    to,
    from: (place) => Math.min(max, Math.max(least, Number((10 ** place).toPrecision(4)))),
    share: (value) => share(to(value) - low, high - low),
  };
}

/** Round a value to the digits of a link. @param {number} value */
function inDigits(value) {
  return Number(value.toPrecision(6));
}

/**
 * Tie the fields for percentile and σ to the view's isovalue.
 * @param {HTMLElement} form holds `#percentile` and `#sigmas`
 * @param {Scene} scene
 * @param {import("../view/model.js").ViewModel} view
 * @returns {(isovalue: number) => void} shows both for an isovalue
 */
function attachRanks(form, { histogram }, view) {
  const [percentile, sigmas] = ["#percentile", "#sigmas"].map((id) =>
    find(form, id, HTMLInputElement),
  );
  // σ counts from the mean; a constant volume has none.
  const { mean, deviation } = momentsOf(histogram);
  sigmas.disabled = !(deviation > 0);
  const mirror = (/** @type {number} */ isovalue) => {
    const shown = [percentileOf(histogram, isovalue), (isovalue - mean) / (deviation || 1)];
    [percentile, sigmas].forEach((field, i) => {
      if (document.activeElement !== field) field.value = String(Number(shown[i].toFixed(2)));
    });
  };
  // A field that the visitor types in is not overwritten until it changes the view.
  percentile.addEventListener("change", () => {
    if (Number.isFinite(percentile.valueAsNumber))
      view.set({ isovalue: inDigits(valueAt(histogram, percentile.valueAsNumber)) });
    mirror(view.values.isovalue);
  });
  sigmas.addEventListener("change", () => {
    if (Number.isFinite(sigmas.valueAsNumber))
      view.set({ isovalue: inDigits(mean + sigmas.valueAsNumber * deviation) });
    mirror(view.values.isovalue);
  });
  return mirror;
}

/**
 * Return mean and standard deviation of the values in a histogram, from the middles of its bins.
 * @param {{counts: number[], edges: number[]}} histogram
 * @returns {{mean: number, deviation: number}}
 */
export function momentsOf({ counts, edges }) {
  const total = counts.reduce((sum, count) => sum + count, 0) || 1;
  const middles = counts.map((_, i) => edges[i] / 2 + edges[i + 1] / 2);
  const mean = counts.reduce((sum, count, i) => sum + (count / total) * middles[i], 0);
  const square = counts.reduce(
    (sum, count, i) => sum + (count / total) * (middles[i] - mean) ** 2,
    0,
  );
  return { mean, deviation: Math.sqrt(square) };
}

/**
 * Return the percentage of voxels below a value, if values are evenly spread within bins.
 * @param {{counts: number[], edges: number[]}} histogram
 * @param {number} value
 * @returns {number}
 */
export function percentileOf({ counts, edges }, value) {
  const total = counts.reduce((sum, count) => sum + count, 0) || 1;
  const below = counts.reduce(
    (sum, count, i) => sum + count * share(value - edges[i], edges[i + 1] - edges[i]),
    0,
  );
  return (100 * below) / total;
}

/**
 * Return the value below which a percentage of voxels lies: the inverse of `percentileOf`.
 * @param {{counts: number[], edges: number[]}} histogram
 * @param {number} percent
 * @returns {number}
 */
export function valueAt({ counts, edges }, percent) {
  const total = counts.reduce((sum, count) => sum + count, 0);
  let left = (total * Math.min(100, Math.max(0, percent))) / 100;
  for (const [i, count] of counts.entries()) {
    if (left <= count && count > 0) return edges[i] + (left / count) * (edges[i + 1] - edges[i]);
    left -= count;
  }
  return edges[edges.length - 1];
}

/**
 * Draw the outline of the logarithms of counts between two values, as data of an SVG path in a box
 * of 1000 × 100.
 * @param {{counts: number[], edges: number[]}} histogram
 * @param {number} min
 * @param {number} max
 * @param {Axis} [axis] linear by default
 * @returns {string}
 */
export function outline({ counts, edges }, min, max, axis = axisOf({ edges }, min, max)) {
  const heights = counts.map((count) => Math.log1p(count));
  const seen = heights.filter((_, i) => edges[i + 1] > min && edges[i] < max);
  const tallest = Math.max(...seen, 1e-9);
  const x = (/** @type {number} */ value) => (WIDTH * axis.share(value)).toFixed(1);
  const y = (/** @type {number} */ height) =>
    (HEIGHT * (1 - 0.94 * Math.min(1, height / tallest))).toFixed(1);
  const steps = heights.map(
    (height, i) => `L${x(edges[i])} ${y(height)}L${x(edges[i + 1])} ${y(height)}`,
  );
  return `M0 ${HEIGHT}${steps.join("")}L${WIDTH} ${HEIGHT}Z`;
}

/**
 * Draw a vertical line at each stop, as data of an SVG path in a box of 1000 × 100.
 * @param {number[]} stops
 * @param {number} min
 * @param {number} max
 * @param {Axis} [axis] linear by default
 * @returns {string}
 */
export function ticksAt(stops, min, max, axis = axisOf({ edges: [min, max] }, min, max)) {
  return stops
    .map((stop) => `M${(WIDTH * axis.share(stop)).toFixed(1)} 0V${HEIGHT}`)
    .join("");
}

/**
 * Describe the stops.
 * @param {string} note on stops that are evenly spaced
 * @returns {string}
 */
export function stopsInWords(note) {
  const what =
    "Ticks below the histogram, keys [ and ]: from one to the next the surface moves about equally far.";
  return `${what} ${note}`.trim();
}

/**
 * Return the part of the drawing whose values are solid.
 * @param {number} split place of the isovalue, as a share of the width
 * @param {boolean} below true if values below the isovalue are solid
 * @returns {{x: number, width: number}}
 */
export function solidSpan(split, below) {
  const at = WIDTH * share(split, 1);
  return below ? { x: 0, width: at } : { x: at, width: WIDTH - at };
}

/**
 * Return a part over a whole, limited to 0 to 1.
 * @param {number} part
 * @param {number} whole
 */
function share(part, whole) {
  return Math.min(1, Math.max(0, part / (whole || 1)));
}

/**
 * Draw the bars, and the solid ones over them.
 * @param {SVGSVGElement} svg
 * @param {string} path
 * @returns {SVGRectElement} clips the solid bars
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
