/**
 * Two pictures side by side, seen by linked cameras: the view on the left; another shading,
 * isovalue, step or scene on the right; and a divider that can be moved.
 */

import { find } from "../dom.js";
import { Polling } from "../net/polling.js";
import { isOneWorld, linkedCamera } from "../view/camera.js";
import { exactValue, shadingName } from "../view/format.js";
import {
  COMPARED_NUMBERS,
  ViewModel,
  comparedRange,
  inShort,
  readDifference,
} from "../view/model.js";
import { setLimits } from "./knobs.js";

/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {import("../view/model.js").Knobs} Knobs */
/** @typedef {import("../view/model.js").Difference} Difference */
/** @typedef {{id: string, name: string}} Link a scene by its id */

/** @typedef {"moving"|"coming"|"lost"|"provisional"|"final"} State of the right side */

/** Percent by which an arrow moves the divider, and an arrow with shift or a page key. */
const [STEP, STRIDE] = [2, 10];

/** Words behind the name of the right side. @type {Record<State, string>} */
const WORDS = {
  moving: " · when the view rests",
  coming: " · drawing…",
  lost: " · not up to date",
  provisional: " · refining",
  final: "",
};

/**
 * The right side: a picture of the current view, or none. It is dimmed while the view moves, as
 * drafts are drawn on the left only.
 */
export class Comparison {
  #root;
  #picture;
  #polling;
  #view;
  #names;
  #moving = false;

  /**
   * @param {HTMLElement} root holds two `.side`s and `#divider`
   * @param {import("../view/picture.js").Picture} picture shows the right side
   * @param {(options: import("../net/polling.js").FrameOptions, signal: AbortSignal)
   *   => Promise<import("../net/schemas.js").Frame & {of: import("../net/shown.js").Asked}>} ask
   * sends one request for the right side
   * @param {ViewModel} view
   * @param {(values: Knobs) => [string, string]} names returns the names of both sides
   */
  constructor(root, picture, ask, view, names) {
    this.#root = root;
    this.#picture = picture;
    this.#view = view;
    this.#names = names;
    this.#polling = new Polling(ask, {
      frame: (frame) => this.#show(frame),
      trouble: () => this.#hide("lost"),
    });
    attachDivider(find(root, "#divider"), (at) => this.#divide(at));
    document.addEventListener(
      "visibilitychange",
      () => this.#on && !document.hidden && this.#polling.resume(),
    );
    view.watch(
      ({ shading, compare }) => [shading, compare],
      () => this.#compare(),
    );
    this.#compare();
  }

  /** Name the picture on the left. @param {Knobs} values that it shows */
  name(values) {
    const { compare } = this.#view.values;
    find(this.#root, ".left").textContent = this.#names({ ...values, compare })[0];
  }

  /** Note that the view goes on changing, or rests. @param {boolean} moving */
  moving(moving) {
    this.#moving = moving;
    if (!this.#on) return;
    if (moving) this.#hide("moving");
    else if (this.#picture.hidden) this.#ask();
  }

  /** Request a better picture of the same view; the present one is shown meanwhile. */
  improve() {
    if (!this.#on || this.#moving) return;
    this.#mark("provisional");
    this.#polling.show(false);
  }

  /** Return true if there is a right side. */
  get #on() {
    return this.#view.values.compare !== "";
  }

  /** Begin, change or end the comparison. */
  #compare() {
    this.#root.hidden = !this.#on;
    this.#hide("moving");
    if (!this.#on) return;
    this.#divide(Number(find(this.#root, "#divider").ariaValueNow));
    if (!this.#moving) this.#ask();
  }

  /** Request the picture of the right side. */
  #ask() {
    this.#mark("coming");
    this.#polling.show(false);
  }

  /**
   * Show a picture and its state.
   * @param {{blob: Blob|null, facts: import("../net/schemas.js").Facts|null}} frame
   */
  async #show({ blob, facts }) {
    const alt = `The same view; ${this.#names(this.#view.values)[1]}`;
    if (blob && !(await this.#picture.show(blob, alt))) return;
    this.#mark(facts?.provisional ? "provisional" : "final");
  }

  /** Hide the picture. After trouble, requests continue. @param {State} state */
  #hide(state) {
    if (state !== "lost") this.#polling.stop();
    this.#picture.hide();
    this.#mark(state);
  }

  /** Show the state of the right side. @param {State} state */
  #mark(state) {
    this.#root.dataset.state = state;
    const [, right] = this.#names(this.#view.values);
    find(this.#root, ".right").textContent = `${right}${WORDS[state]}`;
  }

  /** Put the divider at a place. @param {number} at percent from the left */
  #divide(at) {
    const [left, right] = this.#names(this.#view.values);
    this.#root.style.setProperty("--at", `${at}%`);
    const words = `${Math.round(at)} % ${left}, ${Math.round(100 - at)} % ${right}`;
    find(this.#root, "#divider").ariaValueText = words;
  }
}

/**
 * Offer all that a view can be compared with, and tie the choice to the view, both ways.
 * @param {HTMLElement} form holds `#compare`, `#compare-at` with a range input, and `#compare-note`
 * @param {Scene} scene
 * @param {ViewModel} view
 * @param {Link[]} others all other scenes
 */
export function attachComparison(form, scene, view, others) {
  const select = find(form, "#compare", HTMLSelectElement);
  const at = find(form, "#compare-at");
  const input = find(at, "input", HTMLInputElement);
  const numbers = COMPARED_NUMBERS.filter((name) => comparedRange(scene, name));
  const words = { isovalue: "Another isovalue", time: "Another step" };
  select.replaceChildren(
    new Option("Nothing", ""),
    ...scene.shadings.map((id) => new Option(shadingName(id), id)),
    ...numbers.map((name) => new Option(words[name], name)),
    ...others.map(({ id, name }) => new Option(`Scene ${name}`, `scene:${id}`)),
  );

  // Choosing a number begins with the next stop, or the next step; its slider changes it.
  const named = () => COMPARED_NUMBERS.find((name) => name === select.value);
  select.addEventListener("change", () => {
    const name = named();
    const value = name ? `${name}:${firstOther(scene, name, view.values)}` : select.value;
    view.set({ compare: value });
  });
  input.addEventListener("change", () => view.set({ compare: `${named()}:${input.value}` }));
  const spell = () => {
    const name = named();
    if (!name) return;
    const value = input.valueAsNumber;
    const shown = name === "time" ? `step ${value}` : String(inShort(scene, name, value));
    find(at, "output").textContent = shown;
    input.setAttribute("aria-valuetext", shown);
  };
  input.addEventListener("input", spell);

  /** @param {Knobs} values */
  const mirror = ({ compare, shading }) => {
    const difference = readDifference(scene, compare) ?? {};
    const name = numbers.find((each) => difference[each] !== undefined);
    select.value = name ?? compare;
    // A shading is not compared with itself.
    for (const option of select.options)
      option.hidden = option.disabled = option.value === shading;
    at.hidden = !name;
    find(form, "#compare-note").hidden = difference.scene === undefined;
    if (!name) return;
    const { min, max } = /** @type {{min: number, max: number}} */ (comparedRange(scene, name));
    setLimits(input, min, max);
    if (name === "time") input.step = "1";
    input.value = String(difference[name]);
    find(at, "label").textContent = name === "time" ? "Step at the right" : "Isovalue at the right";
    spell();
  };
  mirror(view.values);
  view.subscribe(mirror);
}

/**
 * Return a first number to compare a view with: the next stop of the isovalue, or the next step.
 * @param {Pick<Scene, "ranges"|"volume"|"stops">} scene
 * @param {"isovalue"|"time"} name
 * @param {Knobs} values
 * @returns {number}
 */
export function firstOther(scene, name, values) {
  const { min, max } = /** @type {{min: number, max: number}} */ (comparedRange(scene, name));
  const now = values[name] ?? min;
  if (name === "time") return now < max ? now + 1 : now - 1;
  const next = scene.stops.find((stop) => stop > now && stop <= max);
  return next ?? (now < max ? (now + max) / 2 : (now + min) / 2);
}

/**
 * Name both sides by what is different.
 * @param {Pick<Scene, "name"|"volume">} scene the scene on the left
 * @param {Knobs} values of the left side
 * @param {Difference} difference
 * @param {(id: string) => string} nameOf returns the name of a scene
 * @returns {[string, string]} left and right
 */
export function sideNames(scene, values, difference, nameOf) {
  const { shading, isovalue, time } = difference;
  if (shading !== undefined) return [shadingName(values.shading), shadingName(shading)];
  if (time !== undefined) return [`step ${values.time}`, `step ${time}`];
  if (difference.scene !== undefined) return [scene.name, nameOf(difference.scene)];
  const range = scene.volume.value_range;
  const [left, right] = [values.isovalue, /** @type {number} */ (isovalue)];
  return [`isovalue ${exactValue(left, range)}`, `isovalue ${exactValue(right, range)}`];
}

/**
 * End a comparison with a scene that the server does not have.
 * @param {ViewModel} view
 * @param {Link[]} others all other scenes
 * @returns {string[]} a sentence about it, if there is one
 */
export function refuseUnknown(view, others) {
  const [, id] = /^scene:(.*)$/.exec(view.values.compare) ?? [];
  if (id === undefined || others.some((each) => each.id === id)) return [];
  view.set({ compare: "" }, true);
  return [`There is no scene “${id}” to compare with.`];
}

/** Finds the scene and the knobs of the right side, and reads other scenes when they are asked for. */
export class RightSide {
  #scene;
  #read;
  #note;
  /** @type {Map<string, Promise<Scene>>} */
  #others = new Map();

  /**
   * @param {Scene} scene the scene on the left
   * @param {(id: string) => Promise<Scene>} read returns the document of another scene
   * @param {HTMLElement} note says how the cameras of two scenes are linked
   */
  constructor(scene, read, note) {
    this.#scene = scene;
    this.#read = read;
    this.#note = note;
  }

  /**
   * Return the scene and the knobs of the right side.
   * @param {Knobs} values of the left side
   * @param {string} compare the difference
   * @returns {Promise<{scene: Scene, values: Knobs}>}
   * @throws {import("../net/trouble.js").Trouble} if another scene cannot be read
   */
  async of(values, compare) {
    const { scene: id, ...changed } = readDifference(this.#scene, compare) ?? {};
    if (id === undefined) return { scene: this.#scene, values: { ...values, ...changed } };
    const other = await this.#document(id);
    const { shading, background, overlay, yaw, pitch, roll } = values;
    const camera = linkedCamera(this.#scene, values, other);
    this.#note.textContent = isOneWorld(this.#scene, other)
      ? "Both volumes fill the same box: one camera shows them."
      : "The volumes differ in size: both are seen from the same direction, each as large as it was.";
    const alike = { shading, background, overlay, yaw, pitch, roll };
    return { scene: other, values: new ViewModel(other, { ...camera, ...alike }).values };
  }

  /** Read another scene, once. A failure is not kept. @param {string} id */
  #document(id) {
    const known = this.#others.get(id) ?? this.#read(id);
    this.#others.set(id, known);
    known.catch(() => this.#others.delete(id));
    return known;
  }
}

/**
 * Return the names of both sides.
 * @param {Scene} scene
 * @param {Link[]} scenes
 * @returns {(values: Knobs) => [string, string]}
 */
export function namesOf(scene, scenes) {
  /** @param {string} id */
  const nameOf = (id) => scenes.find((each) => each.id === id)?.name ?? id;
  return (values) => {
    const difference = readDifference(scene, values.compare);
    return difference ? sideNames(scene, values, difference, nameOf) : ["", ""];
  };
}

/**
 * Return the place to which a key moves the divider, in percent from the left; null for other keys.
 * @param {{key: string, shiftKey: boolean}} event
 * @param {number} now
 * @returns {number|null}
 */
export function dividerPlace({ key, shiftKey }, now) {
  const step = shiftKey ? STRIDE : STEP;
  /** @type {Record<string, number>} */
  const places = {
    ArrowLeft: now - step,
    ArrowDown: now - step,
    ArrowRight: now + step,
    ArrowUp: now + step,
    PageDown: now - STRIDE,
    PageUp: now + STRIDE,
    Home: 0,
    End: 100,
  };
  return key in places ? Math.min(100, Math.max(0, places[key])) : null;
}

/**
 * Let pointer and keys move the divider.
 * @param {HTMLElement} divider
 * @param {(at: number) => void} onMove called with the percent from the left
 */
function attachDivider(divider, onMove) {
  /** @param {number} at */
  const move = (at) => {
    divider.ariaValueNow = String(at);
    onMove(at);
  };
  divider.addEventListener("pointerdown", (event) => {
    event.stopPropagation(); // on the stage a drag turns the object
    divider.setPointerCapture(event.pointerId);
  });
  divider.addEventListener("pointermove", (event) => {
    if (!divider.hasPointerCapture(event.pointerId) || !divider.parentElement) return;
    const { left, width } = divider.parentElement.getBoundingClientRect();
    const at = Math.round((1000 * (event.clientX - left)) / width) / 10;
    move(Math.min(100, Math.max(0, at)));
  });
  divider.addEventListener("dblclick", (event) => event.stopPropagation());
  divider.addEventListener("keydown", (event) => {
    const at = dividerPlace(event, Number(divider.ariaValueNow));
    if (at === null) return;
    event.preventDefault();
    event.stopPropagation();
    move(at);
  });
}
