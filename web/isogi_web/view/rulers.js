/**
 * A scale bar and the world's axes in the corner of the picture, as shapes and as a drawing that
 * follows the view; the letters of a patient's sides; and a legend of colours.
 */

import { find, sizeOf, svgElement } from "../dom.js";
import { boxOf, sidesOf } from "./camera.js";
import { errorInWords } from "./format.js";
import { lengthInWords } from "./measures.js";
import { cameraAxes } from "./rotation.js";
import { readHidden } from "./surfaces.js";

/** @typedef {import("./model.js").Knobs} Knobs */
/** @typedef {import("./model.js").ViewModel} ViewModel */
/** @typedef {import("../net/schemas.js").Scene} Scene */
/**
 * @typedef {{readonly values: Knobs, subscribe: (listener: () => void) => void}} Seen the picture
 *   on the stage: its knobs, and a subscription to changes
 */
/** @typedef {[number, number]} Place right and up of the lower left corner, pixels */
/** @typedef {{kind: string, points: Place[]}} Line */
/**
 * @typedef {{at: Place, text: string, size: number, middle: boolean, end?: boolean}} Words
 *   `middle`: centred at the place both ways; `end`: they end at the place
 */
/**
 * @typedef {{from: Place, to: Place, colours: string[]}} Area a rectangle, with its colours from
 *   left to right
 */
/** @typedef {{lines: Line[], words: Words[], areas?: Area[]}} Shapes */
/**
 * @typedef {{name: string, colours: string[], ticks: string[]}} Bar colours of values, and numbers
 *   from one end to the other
 */
/**
 * @typedef {{bar: Bar|null, labels: {name: string, colour: string}[]}} Legend a bar of colours, or
 *   labels
 */

const DEGREE = Math.PI / 180;
const [AXIS, LETTER] = [24, 33]; // pixels from the origin of the axes to their ends and letters

/** Place of the origin of the axes. @type {Place} */
const CROSS = [40, 40];
const [BAR_LEFT, BAR_UP, TICK] = [84, 20, 5]; // place of the scale bar and length of its ticks
const DEPTH = "at the centre of rotation"; // depth at which a scale bar holds in perspective

/** Length of a scale bar at most: share of the picture's width, and pixels. */
const LONGEST = { share: 0.25, pixels: 150 };

const [INSET, BAR_WIDE, BAR_HIGH, ROW] = [16, 180, 10, 18]; // sizes of a legend, pixels

/** States of scale bar and axes. */
export const RULERS = ["on", "off"];

/**
 * Return the greatest length of 1, 2 or 5 times a power of ten that does not exceed a given one.
 * @param {number} most
 * @returns {number}
 */
export function roundLength(most) {
  const power = 10 ** Math.floor(Math.log10(most));
  const length =
    [5, 2, 1].map((factor) => factor * power).find((each) => each <= most * (1 + 1e-9)) ?? power;
  return Number(length.toPrecision(1));
}

/**
 * Return the length of a scale bar in world units and in pixels; in perspective it holds at the
 * target's depth.
 * @param {Pick<Scene, "volume">} scene
 * @param {Pick<Knobs, "distance"|"fov">} values knobs of the view
 * @param {{width: number, height: number}} size of the picture, pixels
 * @returns {{length: number, pixels: number}} `length` in world units
 */
export function scaleBar(scene, { distance, fov }, { width, height }) {
  // World units per pixel at the target's depth.
  const pixel = (2 * distance * boxOf(scene).radius * Math.tan((fov * DEGREE) / 2)) / height;
  const length = roundLength(pixel * Math.min(LONGEST.pixels, LONGEST.share * width));
  return { length, pixels: length / pixel };
}

/**
 * Return the world's axes as the camera sees them, sorted from back to front.
 * @param {Pick<Scene, "volume">} scene
 * @param {Pick<Knobs, "azimuth"|"elevation">} values knobs of the view
 * @returns {{letter: string, right: number, up: number, out: number}[]} unit vectors; their letters
 *   are sides of a patient if the volume has one
 */
export function tripod({ volume }, { azimuth, elevation }) {
  const { right, up, out } = cameraAxes(azimuth, elevation);
  const letters = [...(volume.letters || "xyz")];
  return letters
    .map((letter, i) => ({ letter, right: right[i], up: up[i], out: out[i] }))
    .sort((a, b) => a.out - b.out);
}

/**
 * Return scale bar and axes for the lower left corner of a picture.
 * @param {Pick<Scene, "volume">} scene
 * @param {Knobs} values knobs of the view
 * @param {{width: number, height: number}} size of the picture, pixels
 * @returns {Shapes}
 */
export function rulerShapes(scene, values, size) {
  const { length, pixels } = scaleBar(scene, values, size);
  const [left, right] = [BAR_LEFT, BAR_LEFT + pixels];
  const axes = tripod(scene, values);
  // In perspective, say at which depth the scale bar holds.
  /** @type {Words[]} */
  const where =
    values.projection === "orthographic"
      ? []
      : [{ at: [left, BAR_UP - 13], text: DEPTH, size: 11, middle: false }];
  /** @type {(axis: {right: number, up: number}, way: number) => Place} */
  const end = (axis, way) => [CROSS[0] + way * axis.right, CROSS[1] + way * axis.up];
  return {
    lines: [
      ...axes.map((axis) => ({
        kind: axis.out < -0.01 ? "away" : "",
        points: [CROSS, end(axis, AXIS)],
      })),
      {
        kind: "",
        points: [
          [left, BAR_UP + TICK],
          [left, BAR_UP],
          [right, BAR_UP],
          [right, BAR_UP + TICK],
        ],
      },
    ],
    words: [
      ...axes.map((axis) => ({ at: end(axis, LETTER), text: axis.letter, size: 13, middle: true })),
      {
        at: [left, BAR_UP + 9],
        text: lengthInWords(scene.volume, length),
        size: 13,
        middle: false,
      },
      ...where,
    ],
  };
}

/**
 * Return the legend of a view's colours: of errors if they are shown, otherwise of data; null if
 * there are no colours.
 * @param {Pick<Scene, "colours"|"error_scale">} scene
 * @param {Pick<Knobs, "overlay"|"hide">} values knobs of the view
 * @returns {Legend|null}
 */
export function legendOf({ colours, error_scale: errors }, { overlay, hide }) {
  if (overlay === "error")
    return {
      bar: { name: "Estimated error", colours: errors.colours, ticks: decades(errors) },
      labels: [],
    };
  if (!colours) return null;
  const hidden = readHidden(hide, colours.labels);
  const labels = colours.labels.filter(({ value }) => !hidden.includes(value));
  if (labels.length) return { bar: null, labels };
  return {
    bar: {
      name: colours.name,
      colours: colours.colours,
      ticks: legendNumbers(colours.low, colours.high),
    },
    labels: [],
  };
}

/**
 * Return a legend for the lower right corner of a picture.
 * @param {Legend} legend
 * @param {{width: number, height: number}} size of the picture, pixels
 * @returns {Shapes}
 */
export function legendShapes({ bar, labels }, { width, height }) {
  const right = width - INSET;
  if (bar) {
    const left = right - BAR_WIDE;
    const { name, colours, ticks } = bar;
    const numbers = [0, (ticks.length - 1) / 2, ticks.length - 1].filter(Number.isInteger);
    return {
      lines: [],
      areas: [{ from: [left, INSET + 18], to: [right, INSET + 18 + BAR_HIGH], colours }],
      words: [
        { at: [right, INSET + 40], text: name, size: 13, middle: false, end: true },
        ...numbers.map((n) => ({
          at: /** @type {Place} */ ([left + (n * BAR_WIDE) / (ticks.length - 1), INSET + 3]),
          text: ticks[n],
          size: 12,
          middle: n > 0 && n < ticks.length - 1,
          end: n === ticks.length - 1,
        })),
      ],
    };
  }
  // As many labels as the picture has room for; the last row counts the others.
  const most = Math.max(1, Math.floor((height - 2 * INSET) / ROW));
  const seen = labels.length > most ? labels.slice(0, most - 1) : labels;
  const rest = labels.length - seen.length;
  const rows = [...seen.map(({ name }) => name), ...(rest ? [`and ${rest} more`] : [])];
  const up = (/** @type {number} */ k) => INSET + ROW * (rows.length - 1 - k);
  return {
    lines: [],
    areas: seen.map(({ colour }, k) => ({
      from: [right - 12, up(k)],
      to: [right, up(k) + 12],
      colours: [colour],
    })),
    words: rows.map((text, k) => ({
      at: [right - 18, up(k) + 2],
      text,
      size: 13,
      middle: false,
      end: true,
    })),
  };
}

/**
 * Return the numbers below a bar of errors: powers of ten.
 * @param {{low: number, high: number}} scale
 * @returns {string[]}
 */
export function decades({ low, high }) {
  return Array.from({ length: Math.round(Math.log10(high / low)) + 1 }, (_, i) =>
    errorInWords(low * 10 ** i),
  );
}

/**
 * Return five numbers below a bar of colours, from one end to the other.
 * @param {number} low
 * @param {number} high
 * @returns {string[]}
 */
export function legendNumbers(low, high) {
  const values = Array.from({ length: 5 }, (_, i) => low + (i * (high - low)) / 4);
  return values.map((value) => String(Number(value.toPrecision(3))).replace("-", "−"));
}

/**
 * Redraw scale bar and axes when the picture on the stage, its size, or the wish for them changes.
 * @param {SVGElement} root in the lower left corner of the stage
 * @param {Scene} scene
 * @param {ViewModel} view
 * @param {Seen} shown
 */
export function attachRulers(root, scene, view, shown) {
  const stage = /** @type {HTMLElement} */ (root.parentElement);
  const draw = () => {
    const off = view.values.rulers === "off";
    root.toggleAttribute("hidden", off);
    if (off) return;
    const { lines, words } = rulerShapes(scene, shown.values, sizeOf(stage));
    root.replaceChildren(...lines.flatMap(lineOf), ...words.map(wordsOf));
  };
  view.watch(({ rulers }) => rulers, draw);
  shown.subscribe(draw);
  new ResizeObserver(draw).observe(stage);
}

/**
 * Keep the letters of a patient's sides at the edges of the picture; none if the volume has no
 * patient.
 * @param {HTMLElement} root holds an element for each side
 * @param {Scene} scene
 * @param {Seen} shown
 */
export function attachSides(root, scene, shown) {
  root.hidden = !scene.volume.letters;
  const draw = () => {
    for (const [side, letter] of Object.entries(sidesOf(scene, shown.values)))
      find(root, `.${side}`).textContent = letter;
  };
  shown.subscribe(draw);
  draw();
}

/** Draw a line over a darker one. @param {Line} line */
function lineOf({ kind, points }) {
  const row = points.map(([x, y]) => `${x.toFixed(2)},${(-y).toFixed(2)}`).join(" ");
  return ["under", "line"].map((each) =>
    svgElement("polyline", { class: `${each} ${kind}`, points: row }),
  );
}

/** Draw words. @param {Words} words */
function wordsOf({ at: [x, y], text, size, middle }) {
  const anchor = {
    "text-anchor": middle ? "middle" : "start",
    "dominant-baseline": middle ? "central" : "auto",
  };
  return svgElement(
    "text",
    { x: x.toFixed(2), y: (-y).toFixed(2), "font-size": size, ...anchor },
    text,
  );
}
