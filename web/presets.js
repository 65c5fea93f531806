/** Isovalues worth a look, as chips: where the scene starts, those that it names, and those that a person keeps. */

import { niceStep, showNumber, sliderRange } from "./view.js";

const FOUND = "A boundary between materials, found in the volume";

/**
 * Fill the group with a button for each preset, and one that keeps the present isovalue, or forgets it.
 * @param {HTMLElement} group
 * @param {object} scene answer of `readScene`
 * @param {import("./view.js").ViewModel} view
 */
export function attachPresets(group, scene, view) {
  const { min, max } = sliderRange(scene, "isovalue");
  group.hidden = min === max;
  if (group.hidden) return;
  const show = (isovalue) => showNumber(isovalue, niceStep(max - min));
  const told = toldPresets(scene);
  let kept = readKept(scene.id).filter((isovalue) => isovalue >= min && isovalue <= max);
  const star = Object.assign(document.createElement("button"), { type: "button", className: "keep" });

  const mirror = ({ isovalue }) => {
    for (const chip of group.querySelectorAll(".chip")) chip.setAttribute("aria-pressed", Number(chip.value) === isovalue);
    const own = kept.includes(isovalue);
    star.textContent = own ? "★" : "☆";
    star.disabled = told.some((preset) => preset.isovalue === isovalue);
    star.title = star.ariaLabel = own ? `Forget isovalue ${show(isovalue)}` : `Keep isovalue ${show(isovalue)}`;
  };
  const build = () => {
    const own = kept.map((isovalue) => ({ name: `★ ${show(isovalue)}`, isovalue }));
    const chips = [...told, ...own].map((preset) => chip(preset, show, () => view.set({ isovalue: preset.isovalue })));
    group.replaceChildren(...chips, star);
    mirror(view.values);
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

function toldPresets({ defaults, presets }) {
  const start = { name: "start", isovalue: defaults.isovalue };
  return presets.some(({ isovalue }) => isovalue === start.isovalue) ? presets : [start, ...presets];
}

function chip({ name, isovalue, suggested }, show, onPress) {
  const button = Object.assign(document.createElement("button"), { type: "button", className: "chip", value: isovalue });
  button.append(suggested ? show(isovalue) : name);
  if (suggested) button.title = FOUND;
  else if (!name.startsWith("★")) button.append(" ", Object.assign(document.createElement("small"), { textContent: show(isovalue) }));
  button.addEventListener("click", onPress);
  return button;
}

function toggled(kept, isovalue) {
  if (kept.includes(isovalue)) return kept.filter((each) => each !== isovalue);
  return [...kept, isovalue].sort((a, b) => a - b);
}

/** A browser may refuse to keep anything; what is kept then lasts as long as the page. */
function readKept(scene) {
  try {
    const kept = JSON.parse(localStorage.getItem(key(scene)) ?? "[]");
    return Array.isArray(kept) ? kept.filter(Number.isFinite) : [];
  } catch {
    return [];
  }
}

function writeKept(scene, kept) {
  try {
    localStorage.setItem(key(scene), JSON.stringify(kept));
  } catch {
    /* not kept beyond this page */
  }
}

function key(scene) {
  return `isogi: isovalues of ${scene}`;
}
