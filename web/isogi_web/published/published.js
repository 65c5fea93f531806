/**
 * A published page: a scene that the visitor's graphics card draws from static files, without a
 * server that renders.
 */

import { Card } from "../card/card.js";
import { Refusal } from "../card/device.js";
import { slabsOf } from "../card/document.js";
import { find, sizeOf } from "../dom.js";
import { cardView } from "../live/view.js";
import { attachSlider } from "../panels/knobs.js";
import { errorInWords } from "../view/format.js";
import { attachGestures } from "../view/gestures.js";
import { attachKeys } from "../view/keys.js";
import { ViewModel } from "../view/model.js";
import { attachRulers } from "../view/rulers.js";
import { readAhead, readDocument, readText } from "./files.js";
import { readLight } from "./light.js";
import { fitFor, fitTo, fitsOf, followLink, linkOf, readLink } from "./place.js";
import { unpackSlabs } from "./voxels.js";

/** @typedef {import("./files.js").Published} Published */

const NO_CARD =
  "This page needs WebGL 2, which this browser or its graphics card does not have: try another browser.";
const LOST =
  "The browser has taken the graphics card from this page. It may give it back by itself; otherwise reload the page.";
const SHORT = { height: 496, width: 704 }; // size of a page below which controls begin folded
const COPIED_MS = 1600; // time that the button says “Copied”

const [stage, canvas, status] = [
  find(document, "#stage"),
  find(document, "canvas", HTMLCanvasElement),
  find(document, "[role=status]"),
];

/** Show the page, and draw the view from then on. */
async function open() {
  const published = await readDocument();
  const { scene, light, card: facts } = published;
  document.title = find(document, "h1").textContent = scene.name;
  find(document, "#caption").textContent = light.caption;
  find(document, "#poster", HTMLImageElement).alt = scene.name;
  if (light.background !== "page") document.documentElement.dataset.ground = light.background;
  foldControls();
  // Read coarse light and the volume first, as the card cannot draw without them, then the light of
  // texels, that of the first view first.
  const [coarse, ...slabs] = readAhead([light.coarse.file, ...slabsOf(facts)]);
  const files = readAhead(light.files, Promise.all([coarse, ...slabs]));
  const fits = fitsOf(scene);
  const square = fitFor(fits, 1).distance;
  Object.assign(scene.start, fitFor(fits, aspectOf(stage)));
  const view = new ViewModel(scene, { ...readLink(location.hash), background: light.background });
  attachControls(scene, view);
  placePoster(square, view);
  new ResizeObserver(() => fitTo(scene, fits, view, sizeOf(stage))).observe(stage);
  const shaders = JSON.parse(await readText("shaders.json"));
  const card = Card.open(canvas, async (name) => shaders[name]);
  await card.load(
    facts,
    Promise.all(slabs).then((some) => unpackSlabs(facts, some)),
  );
  // The poster stays until the card has light of the whole surface.
  putLight(card, await coarse, light.coarse.steps);
  const draw = keepDrawn(card, published, view);
  await refineLight(card, light, files, draw);
}

/** Return width over height of an element. @param {Element} box */
function aspectOf(box) {
  const { width, height } = sizeOf(box);
  return Math.max(width, 1) / Math.max(height, 1);
}

/** Fold the controls if the page is too small for stage and controls. */
function foldControls() {
  const { width, height } = sizeOf(document.body);
  if (height < SHORT.height && width < SHORT.width)
    find(document, "details", HTMLDetailsElement).open = false;
}

/**
 * Show the picture that is enclosed in the page at the size at which the card will draw it.
 * @param {number} distance of the camera that it was drawn with, in a square
 * @param {ViewModel} view
 */
function placePoster(distance, view) {
  const poster = find(document, "#poster");
  const across = Math.min(aspectOf(stage), 1); // largest square in the stage, in its heights
  poster.style.setProperty("--share", String(distance / view.values.distance / across));
}

/**
 * Tie sliders, gestures, keys and buttons to the view.
 * @param {Published["scene"]} scene
 * @param {ViewModel} view
 */
function attachControls(scene, view) {
  const knobs = [...document.querySelectorAll(".knob")];
  for (const knob of knobs) if (knob.matches("[data-light]") && !scene.turns) knob.remove();
  const mirrors = knobs
    .filter((knob) => knob.isConnected)
    .map((knob) => attachSlider(knob, scene, view));
  const mirror = () => mirrors.forEach((each) => each(view.values));
  view.subscribe(mirror);
  mirror();
  attachGestures(stage, scene, view, { onRest: () => {} });
  attachRulers(find(document, "#rulers", SVGElement), scene, view, view);
  const rulers = () => view.set({ rulers: view.values.rulers === "on" ? "off" : "on" });
  attachKeys(scene, view, {
    toggleHelp: () => find(document, "#help").togglePopover(),
    // Marks need a server: the key for them does nothing.
    keys: { f: toggleFull, r: rulers, o: () => {} },
  });
  find(document, "#reset").addEventListener("click", () => view.reset());
  attachLink(find(document, "#link"), scene, view);
  const full = find(document, "#full-screen");
  full.hidden = !document.fullscreenEnabled;
  full.addEventListener("click", toggleFull);
}

/**
 * Let a button copy the address of the view.
 * @param {HTMLElement} button
 * @param {Published["scene"]} scene
 * @param {ViewModel} view
 */
function attachLink(button, scene, view) {
  followLink(scene, view);
  const name = button.textContent;
  button.addEventListener("click", async () => {
    const address = new URL(linkOf(scene, view), location.href).href;
    history.replaceState(null, "", address);
    const copied = await navigator.clipboard?.writeText(address).then(
      () => true,
      () => false,
    );
    button.textContent = copied ? "Copied" : "In the address bar";
    setTimeout(() => {
      button.textContent = name;
    }, COPIED_MS);
  });
}

/** Show the picture on the whole screen, or the page again. */
function toggleFull() {
  if (document.fullscreenElement) document.exitFullscreen();
  else if (document.fullscreenEnabled) stage.requestFullscreen();
}

/**
 * Draw the view whenever it changes, and refine it while it rests.
 * @param {Card} card
 * @param {Published} published
 * @param {ViewModel} view
 * @returns {() => void} draws the view again, when there is more light
 */
function keepDrawn(card, { scene, card: document }, view) {
  let waiting = true;
  let asked = 0;
  const draw = () => {
    asked = 0;
    if (card.lost) return;
    // Draw a changed view first; refine it in the following frames of the screen.
    let finer = true;
    if (waiting) {
      waiting = !card.draw(cardView(scene, document, view.values), pixelsOf(stage));
      stage.toggleAttribute("data-drawn", !waiting || stage.hasAttribute("data-drawn"));
    } else finer = card.refine();
    if (waiting || finer) animate();
    stage.toggleAttribute("data-still", !waiting && !finer);
  };
  const animate = () => {
    asked ||= requestAnimationFrame(draw);
  };
  const change = () => {
    waiting = true;
    stage.removeAttribute("data-still");
    animate();
  };
  view.subscribe(change);
  new ResizeObserver(change).observe(stage);
  sayLost(card, change);
  change();
  return change;
}

/**
 * Show a panel while the card is lost, and offer to load the page again.
 * @param {Card} card
 * @param {() => void} draw draws the view
 */
function sayLost(card, draw) {
  const panel = find(document, "#lost");
  find(panel, "p").textContent = LOST;
  find(panel, "button").addEventListener("click", () => location.reload());
  card.onlost = () => {
    stage.removeAttribute("data-still");
    panel.hidden = false;
  };
  card.onrestored = () => {
    panel.hidden = true;
    draw();
  };
}

/**
 * Return the number of pixels to draw in an element: those of the screen, at most 2 per CSS pixel.
 * @param {HTMLElement} element
 * @returns {{width: number, height: number}}
 */
function pixelsOf(element) {
  const { width, height } = sizeOf(element);
  const ratio = Math.min(devicePixelRatio, 2);
  const count = (/** @type {number} */ side) => Math.max(Math.round(side * ratio), 1);
  return { width: count(width), height: count(height) };
}

/**
 * Put the light of a file on the card.
 * @param {Card} card
 * @param {ArrayBuffer} file
 * @param {number[]} steps quantization steps of its transfer
 * @throws {Error} if the file is damaged, or if the card has too little memory
 */
function putLight(card, file, steps) {
  card.put(readLight(file, steps));
  if (!card.drawing?.texels.takesRaw)
    throw new Error("The graphics card has too little memory for the light of this page.");
}

/**
 * Replace coarse light by that of texels, file by file, and say so until all of it is here.
 * @param {Card} card
 * @param {Published["light"]} light
 * @param {Promise<ArrayBuffer>[]} files
 * @param {() => void} draw
 * @throws {Error} if a file cannot be read, or if the card has too little memory
 */
async function refineLight(card, light, files, draw) {
  for (const [n, file] of files.entries()) {
    const share = Math.round((100 * n) / files.length);
    status.textContent = `Light is still coarse: ${share} % of the fine light is loaded.`;
    putLight(card, await file, light.steps);
    draw();
  }
  status.textContent = qualityOf(light);
  stage.dataset.lit = "";
}

/**
 * Describe the error and the size of the page.
 * @param {import("./files.js").Light} light
 * @returns {string}
 */
function qualityOf({ error, views, isovalues: [low, high], bytes }) {
  const range = `${errorInWords(error.low)} to ${errorInWords(error.high)}`;
  return `Light of isovalues ${low} to ${high}, relative error ${errorInWords(error.likely)} (${range}, measured in ${views} views); ${(bytes / 1e6).toFixed(1)} MB.`;
}

open().catch((error) => {
  status.textContent = error instanceof Refusal ? NO_CARD : error.message;
  if (!(error instanceof Refusal)) throw error;
});
