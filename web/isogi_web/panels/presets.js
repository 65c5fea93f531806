/**
 * Remarkable isovalues as buttons: the scene's first one, those that the scene names, and those
 * that the visitor keeps.
 */

import { textElement } from "../dom.js";
import { exactValue } from "../view/format.js";
import { sliderRange } from "../view/model.js";

/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {{name: string, isovalue: number, suggested?: boolean}} Preset */

const FOUND = "A boundary between materials, found in the volume";

/**
 * Fill the group with a button for each preset, and one that keeps the current isovalue, or forgets
 * it.
 * @param {HTMLElement} group
 * @param {Scene} scene
 * @param {import("../view/model.js").ViewModel} view
 */
export function attachPresets(group, scene, view) {
  const { min, max } = sliderRange(scene, "isovalue");
  group.hidden = min === max;
  if (group.hidden) return;
  const show = (/** @type {number} */ isovalue) =>
    String(exactValue(isovalue, scene.volume.value_range));
  const presets = scenePresets(scene);
  // Presets of the scene are fixed; kept isovalues belong to this browser.
  let kept = readKept(scene.id, { min, max });
  /** @type {HTMLButtonElement[]} */
  let chips = [];
  const star = Object.assign(document.createElement("button"), {
    type: "button",
    className: "keep",
  });

  const mirror = ({ isovalue } = view.values) => {
    for (const each of chips)
      each.setAttribute("aria-pressed", String(Number(each.value) === isovalue));
    const isKept = kept.includes(isovalue);
    star.textContent = isKept ? "★" : "☆";
    star.disabled = presets.some((preset) => preset.isovalue === isovalue);
    star.title = star.ariaLabel = isKept
      ? `Forget isovalue ${show(isovalue)}`
      : `Keep isovalue ${show(isovalue)}`;
  };
  // Replace the buttons whenever the kept isovalues change.
  const build = () => {
    const keptPresets = kept.map((isovalue) => ({ name: `★ ${show(isovalue)}`, isovalue }));
    chips = [...presets, ...keptPresets].map((preset) =>
      chip(preset, show, () => view.set({ isovalue: preset.isovalue })),
    );
    group.replaceChildren(...chips, star);
    mirror();
  };
  star.addEventListener("click", () => {
    kept = toggled(kept, view.values.isovalue);
    writeKept(scene.id, kept);
    build();
    star.focus();
  });
  build();
  view.subscribe(mirror);
}

/**
 * Return the presets of a scene, preceded by its first isovalue unless that is one of them.
 * @param {Pick<Scene, "defaults"|"presets">} scene
 * @returns {Preset[]}
 */
export function scenePresets({ defaults, presets }) {
  const start = { name: "start", isovalue: defaults.isovalue };
  return presets.some(({ isovalue }) => isovalue === start.isovalue)
    ? presets
    : [start, ...presets];
}

/**
 * Add an isovalue to a list in order, or remove it if the list has it.
 * @param {number[]} kept
 * @param {number} isovalue
 * @returns {number[]}
 */
export function toggled(kept, isovalue) {
  if (kept.includes(isovalue)) return kept.filter((each) => each !== isovalue);
  return [...kept, isovalue].sort((a, b) => a - b);
}

/**
 * Read kept isovalues, and leave out those outside the range. A text that is no list gives none: a
 * page of another version may have written it.
 * @param {string|null} text
 * @param {{min: number, max: number}} range
 * @returns {number[]}
 */
export function parseKept(text, { min, max }) {
  try {
    const kept = JSON.parse(text ?? "[]");
    return Array.isArray(kept)
      ? kept.filter((each) => Number.isFinite(each) && each >= min && each <= max)
      : [];
  } catch {
    return [];
  }
}

/**
 * Make the button of a preset.
 * @param {Preset} preset
 * @param {(isovalue: number) => string} show
 * @param {() => void} onPress
 */
function chip({ name, isovalue, suggested }, show, onPress) {
  const button = Object.assign(document.createElement("button"), {
    type: "button",
    className: "chip",
    value: String(isovalue),
  });
  button.append(suggested ? show(isovalue) : name);
  if (suggested) button.title = FOUND;
  else if (!name.startsWith("★")) button.append(" ", textElement("small", show(isovalue)));
  button.addEventListener("click", onPress);
  return button;
}

/**
 * Read the isovalues that this browser keeps; none if it refuses to keep anything.
 * @param {string} scene
 * @param {{min: number, max: number}} range
 */
function readKept(scene, range) {
  try {
    return parseKept(localStorage.getItem(key(scene)), range);
  } catch {
    return [];
  }
}

/**
 * Keep isovalues in this browser; if it refuses, they last as long as the page.
 * @param {string} scene
 * @param {number[]} kept
 */
function writeKept(scene, kept) {
  try {
    localStorage.setItem(key(scene), JSON.stringify(kept));
  } catch {
    /* not kept beyond this page */
  }
}

/** Return the name under which isovalues of a scene are kept. @param {string} scene */
function key(scene) {
  return `isogi: isovalues of ${scene}`;
}
