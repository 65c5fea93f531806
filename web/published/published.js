/**
 * A published page: a scene that the visitor's graphics card draws from static files, with no
 * server behind it.
 */

import { Card } from "../card/card.js";
import { Refusal } from "../card/device.js";
import { find, sizeOf } from "../dom.js";
import { cardView } from "../live/view.js";
import { attachSlider } from "../panels/knobs.js";
import { errorInWords } from "../view/format.js";
import { attachGestures } from "../view/gestures.js";
import { ViewModel } from "../view/model.js";
import { readDocument, readFile } from "./files.js";

/** @typedef {import("./files.js").Published} Published */

const NO_CARD =
  "This page needs WebGL 2, which this browser or its graphics card does not have: try another browser.";

const [stage, canvas, status] = [
  find(document, "#stage"),
  find(document, "canvas", HTMLCanvasElement),
  find(document, "[role=status]"),
];

/** Show the page, and draw whatever view it is put to. */
async function open() {
  const published = await readDocument();
  const { scene, light } = published;
  document.title = find(document, "h1").textContent = scene.name;
  if (light.background !== "page") document.documentElement.dataset.ground = light.background;
  const view = new ViewModel(scene, { background: light.background });
  const card = Card.open(canvas);
  const knobs = [...document.querySelectorAll(".knob")];
  for (const knob of knobs) if (knob.matches("[data-light]") && !scene.turns) knob.remove();
  const mirrors = knobs
    .filter((knob) => knob.isConnected)
    .map((knob) => attachSlider(knob, scene, view));
  const mirror = () => mirrors.forEach((each) => each(view.values));
  view.subscribe(mirror);
  mirror();
  await card.load(
    published.card,
    Promise.all(published.card.volume.slabs.map(({ href }) => readFile(href))),
  );
  const draw = keepDrawn(card, published, view);
  attachGestures(stage, scene, view, { onRest: () => {} });
  await bringLight(card, published, draw);
}

/**
 * Draw the view whenever it changes, and finer while it rests.
 * @param {Card} card
 * @param {Published} published
 * @param {ViewModel} view
 * @returns {() => void} draws it once more: there is more light
 */
function keepDrawn(card, { scene, card: document }, view) {
  let waiting = true;
  let asked = 0;
  const draw = () => {
    asked = 0;
    let finer = true;
    if (waiting) waiting = !card.draw(cardView(scene, document, view.values), pixelsOf(stage));
    else finer = card.refine();
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
  card.onrestored = change;
  change();
  return change;
}

/**
 * The pixels of the stage that are drawn.
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
 * Bring the light, file after file.
 * @param {Card} card
 * @param {Published} published
 * @param {() => void} draw
 */
async function bringLight(card, { light }, draw) {
  for (const [n, name] of light.files.entries()) {
    card.take(await readFile(name), null, light.steps);
    if (!card.drawing?.texels.takesRaw)
      throw new Error("The graphics card has too little memory for the light of this page.");
    draw();
    status.textContent = `Loading light: ${Math.round((100 * (n + 1)) / light.files.length)} %`;
  }
  status.textContent = qualityOf(light);
  stage.dataset.lit = "";
}

/**
 * How good and how large the page is.
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
