/**
 * Isovalues worth a look, as chips: where the scene starts, those that it names, and those that a
 * person keeps.
 */

import { textElement } from "../dom.js";
import { exactValue } from "../view/format.js";
import { sliderRange } from "../view/model.js";

/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {{name: string, isovalue: number, suggested?: boolean}} Preset */

const FOUND = "A boundary between materials, found in the volume";

/**
 * Fill the group with a button for each preset, and one that keeps the present isovalue, or forgets
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
 * The presets of a scene, and first where it starts, unless that is one of them.
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
 * The isovalues with one more, in order, or without it where it is one of them.
 * @param {number[]} kept
 * @param {number} isovalue
 * @returns {number[]}
 */
export function toggled(kept, isovalue) {
  if (kept.includes(isovalue)) return kept.filter((each) => each !== isovalue);
  return [...kept, isovalue].sort((a, b) => a - b);
}

/**
 * The isovalues in a text that was kept, those outside the range left out; none where it is no
 * list, as a page of
 * another version may have written it.
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
 * A browser may refuse to keep anything; what is kept then lasts as long as the page.
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

/** @param {string} scene */
function key(scene) {
  return `isogi: isovalues of ${scene}`;
}
