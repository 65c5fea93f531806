/** A mirror ball that shows the light and how it is turned, as the camera sees it, and that turns it. */

import { readSky } from "./api.js";
import { rollLight } from "./rotation.js";
import { MirrorBall } from "./sky.js";

const DEGREES_ACROSS = 720 / Math.PI; // in the middle, what is mirrored follows the pointer
const KEY_STEP = 10;
const SKY_WIDTH = 128; // a pixel of the ball sees about as much as one of these
const HIGHEST_RATIO = 1.5; // finer than this costs much and shows little
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const FROM_AFAR = new Set(["sky", "probe", "directional"]);

/**
 * Show the ball and tie it to the view. Where turning the light would show nothing, say so.
 * @param {HTMLElement} section holds `#globe`, its knobs and `#light-note`
 * @param {object} scene answer of `readScene`
 * @param {import("./view.js").ViewModel} view
 * @param {() => void} onRest called when a drag ends
 */
export function attachLight(section, scene, view, onRest) {
  const globe = section.querySelector("#globe");
  if (!scene.turns) explainFixed(section, scene);
  if (section.querySelector(".light").hidden) return;
  paintBall(globe, scene, view);
  if (!scene.turns) return;
  attachDrag(globe, view, onRest);
  attachArrows(globe, view);
}

function explainFixed(section, { rotating, lights }) {
  const [note, ball, globe] = ["#light-note", ".light", "#globe"].map((each) => section.querySelector(each));
  note.textContent = rotating ? "The light is the same from all sides." : "The light of this scene is fixed.";
  note.hidden = false;
  ball.hidden = rotating || !lights.some(({ type }) => FROM_AFAR.has(type));
  ball.querySelector("div").hidden = true;
  for (const name of ["tabindex", "aria-roledescription"]) globe.removeAttribute(name);
  globe.role = "img";
  globe.ariaLabel = "The light, seen in a mirror ball";
}

async function paintBall(globe, scene, view) {
  const ratio = Math.min(window.devicePixelRatio || 1, HIGHEST_RATIO);
  globe.width = globe.height = Math.round(globe.clientWidth * ratio);
  const light = await readSky(scene.id, SKY_WIDTH * Math.ceil(ratio)).then(pixelsOf, () => null);
  if (!light) return; // no ball; the knobs do the same
  const ball = new MirrorBall(globe, light);
  const draw = (values) => ball.draw(values);
  draw(view.values);
  view.subscribe(draw);
  globe.dataset.painted = "";
}

async function pixelsOf(blob) {
  const picture = await createImageBitmap(blob);
  const canvas = Object.assign(document.createElement("canvas"), { width: picture.width, height: picture.height });
  const paint = canvas.getContext("2d");
  paint.drawImage(picture, 0, 0);
  return paint.getImageData(0, 0, canvas.width, canvas.height);
}

function attachDrag(globe, view, onRest) {
  globe.addEventListener("pointerdown", (event) => {
    globe.setPointerCapture(event.pointerId);
    globe.dataset.dragging = "light";
  });
  globe.addEventListener("pointermove", (event) => {
    if (!globe.hasPointerCapture(event.pointerId)) return;
    const degrees = DEGREES_ACROSS / globe.clientWidth;
    view.set(rollLight(view.values, event.movementX * degrees, event.movementY * degrees));
  });
  globe.addEventListener("lostpointercapture", () => {
    delete globe.dataset.dragging;
    onRest();
  });
}

function attachArrows(globe, view) {
  globe.addEventListener("keydown", (event) => {
    if (!(event.key in ARROWS) || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault();
    const [right, down] = ARROWS[event.key];
    view.set(rollLight(view.values, right * KEY_STEP, down * KEY_STEP));
  });
}
