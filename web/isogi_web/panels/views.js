/**
 * Views that the visitor keeps in this browser, to go back to, and as a file of keyframes for
 * `isogi film`.
 */

import { find, textElement } from "../dom.js";
import { readAddress, writeAddress } from "../net/address.js";
import { nameOfFiles } from "../net/request.js";
import { download } from "../net/save.js";

/** @typedef {import("../net/schemas.js").FrameQuery} FrameQuery */
/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {import("../view/model.js").ViewModel} ViewModel */
/**
 * @typedef {{address: string, view: FrameQuery}} KeptView the query of the page's address, and the
 *   parameters of its picture
 */

/** Parameters that a film has only once for all of its frames. */
const OF_THE_FILM = ["width", "height", "overlay", "f"];

/**
 * Return the parameters of a keyframe.
 * @param {FrameQuery} query of a picture
 * @returns {FrameQuery}
 */
export function keyframe(query) {
  return Object.fromEntries(Object.entries(query).filter(([name]) => !OF_THE_FILM.includes(name)));
}

/**
 * Write the file of keyframes that `isogi film --views-file` reads.
 * @param {KeptView[]} kept
 * @returns {string}
 */
export function viewsFile(kept) {
  return `${JSON.stringify({ views: kept.map(({ view }) => view) }, null, 1)}\n`;
}

/**
 * Describe a kept view.
 * @param {FrameQuery} view
 * @returns {string}
 */
export function keyframeInWords({ isovalue, azimuth, elevation }) {
  const [value, around, above] = [isovalue, azimuth, elevation].map(Number);
  return `${value}, azimuth ${Math.round(around)}°, elevation ${Math.round(above)}°`;
}

/**
 * Read kept views. A text that is no list of views gives none: a page of another version may have
 * written it.
 * @param {string|null} text
 * @returns {KeptView[]}
 */
export function parseViews(text) {
  try {
    const kept = JSON.parse(text ?? "[]");
    const whole = (/** @type {any} */ each) =>
      typeof each?.address === "string" && Number.isFinite(each.view?.isovalue);
    return Array.isArray(kept) ? kept.filter(whole) : [];
  } catch {
    return [];
  }
}

/**
 * Tie the list of kept views to the view.
 * @param {HTMLElement} part holds `#views-list`, `#views-keep`, `#views-save` and `#views-line`
 * @param {Scene} scene
 * @param {ViewModel} view
 * @param {() => FrameQuery} query the parameters of the picture shown
 */
export function attachViews(part, scene, view, query) {
  const key = `isogi: views of ${scene.id}`;
  const file = `${nameOfFiles(scene)}-views.json`;
  // Kept views belong to this browser, and to this scene.
  let kept = parseViews(stored(key));
  const save = find(part, "#views-save", HTMLButtonElement);
  const build = () => {
    find(part, "#views-list").replaceChildren(...kept.map((each, n) => row(each, n, show, forget)));
    // A film needs two keyframes.
    save.disabled = kept.length < 2;
    find(part, "#views-line").hidden = save.disabled;
    find(part, "code").textContent =
      `isogi film ${scene.id}.toml --views-file ${file} -o ${nameOfFiles(scene)}.mp4`;
  };
  const change = (/** @type {KeptView[]} */ views) => {
    kept = views;
    store(key, JSON.stringify(kept));
    build();
  };
  const show = (/** @type {KeptView} */ { address }) =>
    view.set({ ...view.defaults, ...readAddress(address).start });
  const forget = (/** @type {KeptView} */ gone) => change(kept.filter((each) => each !== gone));
  find(part, "#views-keep").addEventListener("click", () => {
    change([...kept, { address: writeAddress(scene, view.values), view: keyframe(query()) }]);
  });
  save.addEventListener("click", () =>
    download(new Blob([viewsFile(kept)], { type: "application/json" }), file),
  );
  build();
}

/**
 * Make the row of a kept view.
 * @param {KeptView} kept
 * @param {number} n number of the view, from 0
 * @param {(kept: KeptView) => void} show
 * @param {(kept: KeptView) => void} forget
 */
function row(kept, n, show, forget) {
  const go = Object.assign(textElement("button", keyframeInWords(kept.view)), {
    type: "button",
    className: "go",
  });
  const drop = Object.assign(textElement("button", "×"), {
    type: "button",
    ariaLabel: `Forget view ${n + 1}`,
  });
  go.addEventListener("click", () => show(kept));
  drop.addEventListener("click", () => forget(kept));
  const item = document.createElement("li");
  item.append(go, drop);
  return item;
}

/**
 * Keep a text in this browser; if it refuses, the text lasts as long as the page.
 * @param {string} key
 */
function stored(key) {
  try {
    return localStorage.getItem(key);
  } catch {
    return null;
  }
}

/**
 * Keep a text in this browser; if it refuses, the text lasts as long as the page.
 * @param {string} key
 * @param {string} text
 */
function store(key, text) {
  try {
    localStorage.setItem(key, text);
  } catch {
    /* not kept beyond this page */
  }
}
