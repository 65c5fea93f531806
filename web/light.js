/** A ball that shows how the light is turned, seen from the camera, and that turns it when dragged. */

import { dragLight, cameraAxes, fromAngles, turnVector } from "./rotation.js";
import { make } from "./svg.js";

const POINTS = 36; // of half a circle
const DEGREES_ACROSS = 180;

/**
 * Draw the ball and tie it to the view. Where turning the light would show nothing, say so instead.
 * @param {HTMLElement} section holds `#globe` and `#light-note`
 * @param {object} scene answer of `readScene`
 * @param {import("./view.js").ViewModel} view
 * @param {() => void} onRest called when a drag ends
 */
export function attachLight(section, scene, view, onRest) {
  const globe = section.querySelector("#globe");
  if (!scene.turns) return explainFixed(section, scene);
  const draw = (values) => drawGlobe(globe, values);
  draw(view.values);
  view.subscribe(draw);
  attachDrag(globe, view, onRest);
}

function explainFixed(section, { rotating }) {
  const note = section.querySelector("#light-note");
  note.textContent = rotating ? "The light is the same from all sides." : "The light of this scene is fixed.";
  note.hidden = false;
  section.querySelector(".light").hidden = true;
}

function attachDrag(globe, view, onRest) {
  globe.addEventListener("pointerdown", (event) => {
    globe.setPointerCapture(event.pointerId);
    globe.dataset.dragging = "light";
  });
  globe.addEventListener("pointermove", (event) => {
    if (!globe.hasPointerCapture(event.pointerId)) return;
    const degrees = DEGREES_ACROSS / globe.clientWidth;
    view.set(dragLight(view.values, event.movementX * degrees, event.movementY * degrees));
  });
  globe.addEventListener("lostpointercapture", () => {
    delete globe.dataset.dragging;
    onRest();
  });
}

function drawGlobe(globe, values) {
  const toScreen = projector(values);
  const meridians = [0, 45, 90, 135].map((angle) => arcPath(toScreen, [-Math.sin(radians(angle)), Math.cos(radians(angle)), 0]));
  const parallels = [-30, 30, 60, -60].map((latitude) => parallelPath(toScreen, radians(latitude)));
  const start = toScreen([1, 0, 0]);
  globe.replaceChildren(
    make("circle", { r: 1, class: "ground" }),
    make("path", { d: skyPath(toScreen), class: "sky" }),
    make("path", { d: [...meridians, ...parallels].join(""), class: "graticule" }),
    make("path", { d: arcPath(toScreen, [0, 0, 1]), class: "horizon" }),
    make("circle", { cx: start[0], cy: start[1], r: 0.07, class: start[2] > 0 ? "mark" : "mark behind" }),
    make("circle", { r: 1, class: "limb" }),
  );
}

/** Gives a function from a direction of the unturned light to picture x, y (down) and depth towards the eye. */
function projector(values) {
  const turn = fromAngles(values);
  const { right, up, out } = cameraAxes(values.azimuth, values.elevation);
  return (direction) => {
    const turned = turnVector(turn, direction);
    return [dot(turned, right), -dot(turned, up), dot(turned, out)];
  };
}

/** The front half of the great circle about `normal`, as points on the picture, from limb to limb. */
function frontArc(toScreen, normal) {
  const [nx, ny, nz] = toScreen(normal);
  const length = Math.hypot(nx, ny) || 1e-9;
  const limb = [-ny / length, nx / length];
  const front = [(-nx * nz) / length, (-ny * nz) / length];
  return sweep(0, Math.PI).map((t) => [
    limb[0] * Math.cos(t) + front[0] * Math.sin(t), limb[1] * Math.cos(t) + front[1] * Math.sin(t),
  ]);
}

function arcPath(toScreen, normal) {
  return polyline(frontArc(toScreen, normal));
}

function skyPath(toScreen) {
  const [zx, zy] = toScreen([0, 0, 1]);
  const horizon = frontArc(toScreen, [0, 0, 1]);
  const middle = Math.atan2(zy, zx);
  const limb = sweep(-Math.PI / 2, Math.PI / 2).map((t) => [Math.cos(middle - t), Math.sin(middle - t)]);
  const [last, first] = [horizon.at(-1), limb[0]];
  const meets = Math.hypot(last[0] - first[0], last[1] - first[1]) < 1;
  return `${polyline([...horizon, ...(meets ? limb : limb.reverse())])}Z`;
}

function parallelPath(toScreen, latitude) {
  const ring = sweep(0, 2 * Math.PI).map((t) => toScreen([
    Math.cos(latitude) * Math.cos(t), Math.cos(latitude) * Math.sin(t), Math.sin(latitude),
  ]));
  return ring.map(([x, y, z], i) => `${z > 0 && i > 0 && ring[i - 1][2] > 0 ? "L" : "M"}${number(x)} ${number(y)}`).join("");
}

function polyline(points) {
  return points.map(([x, y], i) => `${i ? "L" : "M"}${number(x)} ${number(y)}`).join("");
}

function sweep(from, to) {
  return Array.from({ length: POINTS + 1 }, (_, i) => from + ((to - from) * i) / POINTS);
}

function dot(a, b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

function radians(degrees) {
  return (degrees * Math.PI) / 180;
}

function number(x) {
  return x.toFixed(3);
}
