/** Slices through a point, beside the picture: what planes take away is hatched there, and their lines are dragged. */

import { find, resize, svgElement, textElement } from "../dom.js";
import { attachGrip, tell } from "./handles.js";
import { movablePlanes, planesOf } from "./planes.js";
import { dot, vector } from "./rotation.js";

/** @typedef {import("./planes.js").Movable} Movable */
/** @typedef {import("./planes.js").Plane} Plane */
/** @typedef {import("./rotation.js").Vec3} Vec3 */
/** @typedef {import("./model.js").ViewModel} ViewModel */
/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {[number, number]} Share of a slice's width, from its left, and of its height, from its foot */
/** @typedef {{at: number, right: number, up: number, near: number}} Slope how far beyond a plane a slice's lower left corner
 *   is, and by how much more so its lower right and its upper left one; what is nearer than `near` is on it; world units */

/**
 * @typedef {object} Slice
 * @property {"x"|"y"|"z"} axis of the voxels, that it is across
 * @property {number} at voxel index
 * @property {string} name
 * @property {number} ratio its width over its height, in the world
 * @property {Share} point the share of the point that it goes through
 * @property {Vec3} corner the lower left one, in the world
 * @property {Vec3} width from there to the lower right one
 * @property {Vec3} height from there to the upper left one
 * @property {Vec3} normal along its axis, of length 1
 * @property {Vec3[]} steps from a voxel to the next one, along each axis
 */

/**
 * @typedef {object} SliceHooks
 * @property {(axis: "x"|"y"|"z", at: number) => string} address of a slice's picture
 * @property {(normal: Vec3) => void} cut along the slice with this normal, through the point
 * @property {() => void} onFold is called when slices are opened or folded
 * @property {() => void} onRest is called when a line is let go
 */

/** @type {["x"|"y"|"z", number, number, number][]} */
const AXES = [["z", 2, 0, 1], ["y", 1, 0, 2], ["x", 0, 1, 2]]; // an axis, its number, and those of columns and rows
const NEAR = 0.125; // voxels: the face of a cut lies up to a ninth of one beyond its plane
const DOT = 4; // pixels
/** @type {Share[]} */
const SQUARE = [[0, 0], [1, 0], [1, 1], [0, 1]];

/**
 * The slices through a point.
 * @param {Pick<Scene["volume"], "size"|"spacing"|"affine">} volume
 * @param {Vec3} voxel indices, x first
 * @returns {Slice[]}
 */
export function slicesAt({ size, spacing, affine }, voxel) {
  const steps = [0, 1, 2].map((axis) => vector((i) => affine[i][axis]));
  const scaled = (/** @type {number} */ axis, /** @type {number} */ factor) => vector((i) => factor * steps[axis][i]);
  return AXES.map(([axis, across, column, row]) => {
    const at = Math.min(size[across] - 1, Math.max(0, voxel[across]));
    const share = (/** @type {number} */ i) => (voxel[i] + 0.5) / size[i]; // a voxel is as wide as its pixel
    const first = vector((i) => (i === across ? at : -0.5));
    return {
      axis, at, name: `${axis} ${Number(at.toFixed(1))}`,
      ratio: (size[column] * spacing[column]) / (size[row] * spacing[row]),
      point: [share(column), share(row)],
      corner: vector((i) => dot(/** @type {Vec3} */ (affine[i].slice(0, 3)), first) + affine[i][3]),
      width: scaled(column, size[column]),
      height: scaled(row, size[row]),
      normal: scaled(across, 1 / spacing[across]),
      steps,
    };
  });
}

/**
 * How the distance from a plane changes over a slice.
 * @param {Slice} slice
 * @param {Plane} plane
 * @returns {Slope}
 */
export function slopeOf({ corner, width, height, steps }, { normal, limit }) {
  const near = NEAR * Math.hypot(...steps.map((step) => dot(normal, step)));
  return { at: dot(normal, corner) - limit, right: dot(normal, width), up: dot(normal, height), near };
}

/**
 * The part of a slice that planes leave.
 * @param {Slice} slice
 * @param {string} text of the planes
 * @returns {Share[]} corners of a convex polygon, in turn; none where nothing is left
 */
export function partLeft(slice, text) {
  return planesOf(text).reduce((polygon, plane) => {
    const { at, near, ...rest } = slopeOf(slice, plane), slope = { at: at - near, near, ...rest };
    return polygon.flatMap((corner, i) => [
      ...(beyond(slope, corner) <= 0 ? [corner] : []), ...crossing(slope, corner, polygon[(i + 1) % polygon.length]),
    ]);
  }, SQUARE);
}

/**
 * The line in which a plane crosses a slice.
 * @param {Slope} slope of the plane
 * @returns {Share[]} its two ends; none where they do not cross
 */
export function lineAcross(slope) {
  if (Math.abs(slope.right) + Math.abs(slope.up) <= slope.near) return [];
  return SQUARE.flatMap((corner, i) => crossing(slope, corner, SQUARE[(i + 1) % SQUARE.length]));
}

/** @param {Slope} slope @param {Share} place */
function beyond({ at, right, up }, [x, y]) {
  return at + right * x + up * y;
}

/** Where an edge goes through a plane. @param {Slope} slope @param {Share} a @param {Share} b @returns {Share[]} one place, or none */
function crossing(slope, a, b) {
  const [from, to] = [beyond(slope, a), beyond(slope, b)];
  if (from <= 0 === to <= 0) return [];
  const share = from / (from - to);
  return [[a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])]];
}

/**
 * Show slices in a part of the page that is folded at first: none is asked for before it is opened.
 * @param {HTMLDetailsElement} root
 * @param {Pick<Scene, "volume">} scene
 * @param {ViewModel} view
 * @param {SliceHooks} hooks
 * @returns {(voxel: Vec3) => void} shows those through a point
 */
export function attachSlices(root, { volume }, view, hooks) {
  /** @type {Vec3|null} */
  let shown = null;
  /** @type {Drawn[]} */
  let drawn = [];
  const follow = () => drawn.forEach(({ draw }) => draw());
  const show = () => {
    if (!shown || !root.open) return;
    drawn = slicesAt(volume, shown).map((slice) => figureOf(slice, volume, view, hooks));
    find(root, "div").replaceChildren(...drawn.map(({ figure }) => figure));
    follow();
  };
  root.addEventListener("toggle", () => {
    show();
    hooks.onFold();
  });
  view.watch(({ planes }) => planes, follow);
  return (voxel) => {
    if (String(voxel) === String(shown)) return;
    shown = voxel;
    show();
  };
}

/** @typedef {{figure: HTMLElement, draw: () => void}} Drawn a slice, and what brings it up with the planes */

/**
 * @param {Slice} slice
 * @param {Scene["volume"]} volume
 * @param {ViewModel} view
 * @param {SliceHooks} hooks
 * @returns {Drawn}
 */
function figureOf(slice, volume, view, { address, cut, onRest }) {
  const { axis, at, name, ratio, point: [right, up] } = slice;
  const [figure, plane, gone, caption] = ["figure", "div", "div", "figcaption"].map((tag) => document.createElement(tag));
  const picture = Object.assign(new Image(), { src: address(axis, at), alt: `Slice at ${name}`, draggable: false });
  const lines = svgElement("svg", { role: "group", "aria-label": `Planes of the cut, at ${name}` });
  const button = Object.assign(textElement("button", "Cut here"), {
    type: "button", title: "Cut along this slice, on your side of it", ariaLabel: `Cut here, along ${name}`,
  });
  button.addEventListener("click", () => cut(slice.normal));
  plane.style.aspectRatio = String(ratio);
  plane.style.setProperty("--right", `${100 * right}%`);
  plane.style.setProperty("--up", `${100 * up}%`);
  gone.className = "gone";
  plane.append(picture, gone, lines);
  caption.append(textElement("span", name), button);
  figure.append(plane, caption);
  /** @type {SVGGElement[]} */
  const grips = [];
  const draw = () => {
    const { planes } = view.values, all = movablePlanes(volume, planes);
    gone.style.clipPath = around(partLeft(slice, planes));
    resize(grips, all.length, (k) => lines.appendChild(gripOf(slice, () => movablePlanes(volume, view.values.planes)[k], plane, view, onRest)));
    all.forEach((each, k) => place(grips[k], slice, each));
  };
  return { figure, draw };
}

/**
 * The line of a plane in a slice, which moves it: it follows the pointer, and arrows as they point.
 * @param {Slice} slice
 * @param {() => Movable} plane
 * @param {HTMLElement} box that the slice fills
 * @param {ViewModel} view
 * @param {() => void} onRest
 */
function gripOf(slice, plane, box, view, onRest) {
  const grip = svgElement("g", { tabindex: 0 });
  grip.append(...["hit", "under", "line"].map((kind) => svgElement("line", { class: kind })), svgElement("circle", { r: DOT }));
  const slope = () => slopeOfMovable(slice, plane());
  attachGrip(grip, view, {
    plane,
    draggedBy: (right, down) => (slope().right * right) / box.clientWidth - (slope().up * down) / box.clientHeight,
    sign: () => Math.sign(isUpright(slice, slope()) ? slope().right : slope().up),
    onRest,
  });
  return grip;
}

/** Put a line where its plane crosses a slice; it is hidden where it does not. @param {SVGGElement} grip @param {Slice} slice @param {Movable} plane */
function place(grip, slice, plane) {
  const slope = slopeOfMovable(slice, plane), [a, b] = lineAcross(slope);
  tell(grip, plane);
  grip.toggleAttribute("hidden", !a);
  if (!a) return;
  grip.toggleAttribute("data-open", plane.value === plane.open);
  grip.style.cursor = isUpright(slice, slope) ? "ew-resize" : "ns-resize";
  const [[x1, y1], [x2, y2], [cx, cy]] = [a, b, [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2]].map(([x, y]) => [`${100 * x}%`, `${100 * (1 - y)}%`]);
  for (const part of grip.children) {
    const at = part.tagName === "circle" ? { cx, cy } : { x1, y1, x2, y2 };
    Object.entries(at).forEach(([name, value]) => part.setAttribute(name, value));
  }
}

/** @param {Slice} slice @param {Movable} plane */
function slopeOfMovable(slice, { normal, value }) {
  return slopeOf(slice, { normal, limit: value });
}

/** Whether a plane's line goes up rather than across. @param {Slice} slice @param {Slope} slope */
function isUpright({ ratio }, { right, up }) {
  return Math.abs(right) > ratio * Math.abs(up);
}

/** A shape for `clip-path`: all but a polygon. @param {Share[]} polygon */
function around(polygon) {
  const ring = [SQUARE, polygon].flatMap((corners) => [...corners, ...corners.slice(0, 1)]);
  return `polygon(evenodd, ${ring.map(([x, y]) => `${100 * x}% ${100 * (1 - y)}%`).join(", ")})`;
}
