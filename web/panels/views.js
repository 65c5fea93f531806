/**
 * Views that a person keeps in this browser, to go back to, and as a file of keyframes that `isogi
 * film` reads.
 */

import { find, textElement } from "../dom.js";
import { readAddress, writeAddress } from "../net/address.js";
import { nameOfFiles } from "../net/request.js";
import { download } from "../net/save.js";

/** @typedef {import("../net/schemas.js").FrameQuery} FrameQuery */
/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {import("../view/model.js").ViewModel} ViewModel */
/**
 * @typedef {{address: string, view: FrameQuery}} KeptView the page's own query, and the parameters
 *   of its picture
 */

// what a film is given once for all of its frames
const OF_THE_FILM = ["width", "height", "overlay", "f"];

/**
 * The parameters of a keyframe.
 * @param {FrameQuery} query of a picture
 * @returns {FrameQuery}
 */
export function keyframe(query) {
  return Object.fromEntries(Object.entries(query).filter(([name]) => !OF_THE_FILM.includes(name)));
}

/**
 * The file of keyframes that `isogi film --views-file` reads.
 * @param {KeptView[]} kept
 * @returns {string}
 */
export function viewsFile(kept) {
  return `${JSON.stringify({ views: kept.map(({ view }) => view) }, null, 1)}\n`;
}

/**
 * What tells a kept view from others.
 * @param {FrameQuery} view
 * @returns {string}
 */
export function keyframeInWords({ isovalue, azimuth, elevation }) {
  const [value, around, above] = [isovalue, azimuth, elevation].map(Number);
  return `${value}, azimuth ${Math.round(around)}°, elevation ${Math.round(above)}°`;
}

/**
 * The views in a text that was kept; none where it is no list of such, as a page of another version
 * may have written.
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
 * Tie the list to the view.
 * @param {HTMLElement} part holds `#views-list`, `#views-keep`, `#views-save` and `#views-line`
 * @param {Scene} scene
 * @param {ViewModel} view
 * @param {() => FrameQuery} query the parameters of the picture shown
 */
export function attachViews(part, scene, view, query) {
  const key = `isogi: views of ${scene.id}`;
  const file = `${nameOfFiles(scene)}-views.json`;
  let kept = parseViews(stored(key));
  const save = find(part, "#views-save", HTMLButtonElement);
  const build = () => {
    find(part, "#views-list").replaceChildren(...kept.map((each, n) => row(each, n, show, forget)));
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
 * @param {KeptView} kept
 * @param {number} n its place, from 0
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
 * A browser may refuse to keep anything; what is kept then lasts as long as the page.
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
