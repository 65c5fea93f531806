/**
 * A view in a notebook: the visitor's graphics card draws moving views, and the kernel sends the
 * server's picture of a view at rest.
 */

import { Card } from "../card/card.js";
import { Live } from "../live/live.js";
import { readAddress } from "../net/address.js";
import { describe } from "../net/request.js";
import { errorInWords } from "../view/format.js";
import { attachGestures, dragObject } from "../view/gestures.js";
import { ARROWS } from "../view/keys.js";
import { NUMBERS, ViewModel } from "../view/model.js";
import { dragLight } from "../view/rotation.js";
import { Bridge } from "./bridge.js";

/** @typedef {import("./bridge.js").Model} Model */
/** @typedef {import("../view/model.js").Knobs} Knobs */
/** @typedef {import("../net/schemas.js").Scene} Scene */

/**
 * @typedef {{stage: HTMLElement, picture: HTMLImageElement, canvas: HTMLCanvasElement, slider:
 *   HTMLInputElement, line: HTMLOutputElement}} Parts
 */

/**
 * Knobs of the view that page and kernel share.
 * @type {("isovalue"|"azimuth"|"elevation"|"distance"|"yaw"|"pitch"|"roll"|"target")[]}
 */
const SHARED = ["isovalue", "azimuth", "elevation", "distance", "yaw", "pitch", "roll", "target"];

/** Parameters of a view that the page knows; a view with others is drawn by the server. */
const KNOWN = new Set([
  ...NUMBERS,
  "target",
  "projection",
  "shading",
  "background",
  "width",
  "height",
  "max_error",
  "draw",
]);
const REST_MS = 200; // time without a change after which a view is at rest
const STEP = 5; // degrees of rotation by an arrow key

/**
 * Show the widget of a model in an element.
 * @param {Model} model
 * @param {HTMLElement} element
 * @returns {() => void} ends it
 */
export function show(model, element) {
  const scene = /** @type {Scene} */ ({ ...model.get("scene"), start: { target: null } });
  const parts = partsIn(element, model.get("size"));
  const view = new ViewModel(scene, startOf(model));
  const bridge = new Bridge(model);
  const live = liveIn(parts, scene, model, bridge);
  const follow = followed(parts, scene, view, live, model);
  attachControls(parts, scene, view, follow.settle);
  return () => {
    follow.end();
    bridge.close();
  };
}

/**
 * Make the elements of the widget.
 * @param {HTMLElement} element
 * @param {[number, number]} size pixels of the picture
 * @returns {Parts}
 */
function partsIn(element, [width, height]) {
  const make =
    /** @type {<T extends keyof HTMLElementTagNameMap>(tag: T, facts: object) => HTMLElementTagNameMap[T]} */ (
      (tag, facts) => Object.assign(document.createElement(tag), facts)
    );
  const picture = make("img", { draggable: false });
  const canvas = make("canvas", { hidden: true });
  const stage = make("div", { className: "stage", tabIndex: 0 });
  const slider = make("input", { type: "range", step: "any", ariaLabel: "Isovalue" });
  const line = make("output", {});
  Object.assign(stage.style, { width: `${width}px`, aspectRatio: `${width} / ${height}` });
  stage.append(picture, canvas);
  element.classList.add("isogi");
  element.append(stage, slider, line);
  return { stage, picture, canvas, slider, line };
}

/**
 * Return the first knobs, as the kernel gives them.
 * @param {Model} model
 * @returns {Partial<Knobs>}
 */
function startOf(model) {
  const { start } = readAddress(`?${new URLSearchParams(model.get("given"))}`);
  return { background: "light", ...start, ...sharedOf(model) };
}

/** Return the knobs that the kernel shares. @param {Model} model @returns {Partial<Knobs>} */
function sharedOf(model) {
  return Object.fromEntries(SHARED.map((name) => [name, model.get(name)]));
}

/**
 * Return the part that must draw moving views: "card" or "server"; null to let the page choose.
 * @param {Model} model
 * @returns {string|null}
 */
function choiceOf(model) {
  const given = model.get("given");
  const known = Object.entries(given).every(
    ([name, value]) =>
      KNOWN.has(name) && (!NUMBERS.some((each) => each === name) || Number.isFinite(Number(value))),
  );
  return known ? (given.draw ?? null) : "server";
}

/**
 * Make the part of the widget that draws with the card.
 * @param {Parts} parts
 * @param {Scene} scene
 * @param {Model} model
 * @param {Bridge} bridge
 * @returns {Live}
 */
function liveIn({ canvas, line }, scene, model, bridge) {
  const [width, height] = model.get("size");
  // The line below the picture tells how good the card's picture is.
  /** @type {Live} */
  const live = new Live(
    canvas,
    scene,
    bridge.source,
    {
      open: () => Card.open(canvas, (name) => bridge.readShader(name)),
      size: () => ({ width, height }),
      drawn() {
        line.textContent = `Drawn by the graphics card${qualityInWords(live)}`;
      },
      lost: () => share(model, { moving: false }),
      refused: (reason) => {
        line.textContent = reason;
      },
    },
    choiceOf(model),
  );
  return live;
}

/**
 * Say how good the card's picture is.
 * @param {Pick<Live, "predicted"|"shines">} live
 * @returns {string}
 */
function qualityInWords({ predicted, shines }) {
  if (shines) return ", shine by few rays";
  return predicted === null ? "; light is coming" : `, about ${errorInWords(predicted)} error`;
}

/** Send values to the kernel. @param {Model} model @param {Record<string, any>} values */
function share(model, values) {
  for (const [name, value] of Object.entries(values)) model.set(name, value);
  model.save_changes();
}

/**
 * Keep page, kernel and card at the same view.
 * @param {Parts} parts
 * @param {Scene} scene
 * @param {ViewModel} view
 * @param {Live} live
 * @param {Model} model
 * @returns {{settle: () => void, end: () => void}} `settle` ends a motion; `end` removes all
 *   listeners
 */
function followed(parts, scene, view, live, model) {
  let timer = 0;
  let led = false; // true while the kernel changes the view
  let shares = false; // true while the page sends knobs to the kernel, one by one
  const tell = (/** @type {Record<string, any>} */ values) => {
    shares = true;
    share(model, values);
    shares = false;
  };
  const settle = () => {
    clearTimeout(timer);
    live.move(false);
    tell({ moving: false });
  };
  view.subscribe((values) => {
    clearTimeout(timer);
    live.show(values);
    live.move(true);
    // Send knobs to the kernel, unless it has just sent them.
    const shared = led ? {} : Object.fromEntries(SHARED.map((name) => [name, values[name]]));
    tell({ ...shared, moving: live.draws(values) });
    timer = setTimeout(settle, REST_MS);
    mirror(parts, model);
  });
  const lead = () => {
    if (shares) return;
    led = true;
    view.set(sharedOf(model));
    led = false;
  };
  const came = () => {
    put(parts, model, describe(scene, view.values));
    // Only a picture of the newest view can replace the card's.
    const isNewest =
      JSON.stringify(model.get("seen")) === JSON.stringify(SHARED.map((name) => model.get(name)));
    if (isNewest) live.rest(view.values, { coverage: { provisional: model.get("provisional") } });
  };
  const listeners = /** @type {[string, () => void][]} */ ([
    ["change:shown", came],
    ["change:told", () => mirror(parts, model)],
    ...SHARED.map((name) => [`change:${name}`, lead]),
  ]);
  listeners.forEach(([event, listener]) => model.on(event, listener));
  mirror(parts, model);
  if (model.get("shown")) came();
  return {
    settle,
    end: () => {
      settle();
      listeners.forEach(([event, listener]) => model.off(event, listener));
      URL.revokeObjectURL(parts.picture.src);
    },
  };
}

/**
 * Show the server's picture, below the card's.
 * @param {Parts} parts
 * @param {Model} model
 * @param {string} alt
 */
function put({ picture }, model, alt) {
  URL.revokeObjectURL(picture.src);
  picture.src = URL.createObjectURL(new Blob([model.get("picture")], { type: "image/jpeg" }));
  picture.alt = alt;
}

/** Show the kernel's state: isovalue and status line. @param {Parts} parts @param {Model} model */
function mirror({ slider, line }, model) {
  const [low, high] = model.get("span").map(String);
  Object.assign(slider, {
    min: low,
    max: high,
    value: String(model.get("isovalue")),
    hidden: low === high,
  });
  line.textContent = model.get("told");
}

/**
 * Let pointer, wheel, arrow keys and the slider change the view.
 * @param {Parts} parts
 * @param {Scene} scene
 * @param {ViewModel} view
 * @param {() => void} onRest
 */
function attachControls({ stage, slider }, scene, view, onRest) {
  attachGestures(stage, scene, view, { onRest });
  slider.addEventListener("input", () => view.set({ isovalue: slider.valueAsNumber }));
  stage.addEventListener("keydown", (event) => {
    if (!(event.key in ARROWS)) return;
    event.preventDefault();
    event.stopPropagation(); // the notebook would select another cell
    const [right, down] = ARROWS[event.key];
    const turn = event.shiftKey && scene.turns ? dragLight : dragObject;
    view.set(turn(view.values, STEP * right, STEP * down));
  });
}
