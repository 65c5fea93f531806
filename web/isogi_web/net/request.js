/**
 * A view as the parameters of a frame request, in words, as the name of a file, and as lines for a
 * shell and for Python.
 */

import { albedoQuery } from "../view/albedo.js";
import { exactValue, shadingName } from "../view/format.js";
import { NUMBERS } from "../view/model.js";
import { partPlanes } from "../view/planes.js";
import { inSteps } from "../view/rotation.js";
import { idleKnobs } from "../view/surfaces.js";

/** @typedef {import("../view/model.js").Knobs} Knobs */
/** @typedef {import("./schemas.js").FrameQuery} FrameQuery */
/** @typedef {import("./schemas.js").Scene} Scene */

/**
 * @typedef {object} Description the view that the page shows, for those who share or save it
 * @property {() => string} link returns the address of the page with the view in it
 * @property {() => FrameQuery & {width: number, height: number}} query the parameters of the
 *   picture shown
 * @property {() => {blob: Blob, facts: import("./schemas.js").Facts, width: number, height:
 *   number}|null} ready that picture, if it is final; null before that
 * @property {() => string} file the name of its file, without an ending
 * @property {() => string} alt a description of the picture
 * @property {() => string} empty the words for a picture that shows no surface
 * @property {(size: {width: number, height: number}) => import("../view/rulers.js").Shapes} rulers
 *   its scale bar and axes
 * @property {(size: {width: number, height: number}) => import("../view/rulers.js").Shapes|null}
 *   legend of its colours; null if it has none
 */

/** Parameters that have no meaning if the scene's light cannot be rotated. */
const LIGHT_KNOBS = new Set(["yaw", "pitch", "roll"]);

/**
 * Return the parameters of the request for a view's picture.
 * @param {Pick<Scene, "turns"|"albedo"|"albedos"> & Partial<Pick<Scene, "defaults"|"turn_step">>}
 *   scene
 * @param {Knobs} values knobs of the view
 * @param {{width: number, height: number}} size pixels
 * @param {boolean} [moving] true if the view goes on changing: cuts are then shown as windows,
 *   which leave light unchanged
 * @returns {FrameQuery & {width: number, height: number}}
 */
export function frameQuery(scene, values, { width, height }, moving = false) {
  // Leave out knobs that the material ignores, and those at the scene's default that depends on the
  // light.
  const idle = idleKnobs(values.material);
  const given = NUMBERS.filter(
    (name) => name in values && name !== "albedo" && !idle.includes(name),
  );
  const plain = (/** @type {string} */ name) =>
    name === "exposure" && values.exposure === scene.defaults?.exposure;
  const numbers = given.filter((name) => !plain(name) && (scene.turns || !LIGHT_KNOBS.has(name)));
  return {
    ...Object.fromEntries(numbers.map((name) => [name, values[name]])),
    ...(scene.turns && scene.turn_step && inSteps(values, scene.turn_step)),
    ...(!idle.includes("albedo") && albedoQuery(scene, values)),
    ...(values.shine && { shine: values.shine }),
    ...(values.projection !== (scene.defaults?.projection ?? "perspective") && {
      projection: values.projection,
    }),
    ...(values.target && { target: values.target.join(",") }),
    ...(values.environment && { environment: values.environment }),
    ...cutQuery(values, moving),
    ...(values.surfaces && { surfaces: values.surfaces }),
    ...(values.hide && { hide: values.hide }),
    ...(values.material && { material: values.material }),
    width,
    height,
    shading: values.shading,
    overlay: values.overlay,
    background: ground(values),
    f: "png",
  };
}

/**
 * Return the parameters of planes that take matter away.
 *
 * Planes along axes are cuts, which let light in. Oblique planes, and all planes of a moving view,
 * are windows, which hide matter from the eye alone.
 *
 * @param {Pick<Knobs, "planes"|"opened">} values knobs of the view
 * @param {boolean} [moving] true if the view goes on changing
 * @returns {{cut?: string, window?: string}}
 */
export function cutQuery({ planes, opened }, moving = false) {
  const { along, oblique } =
    opened && !moving ? partPlanes(planes) : { along: "", oblique: planes };
  return { ...(along && { cut: along }), ...(oblique && { window: oblique }) };
}

/**
 * Return the parameters of the request for the point at a place of a view's picture.
 * @param {FrameQuery & {width: number, height: number}} query of the picture
 * @param {number} right distance to the right of the middle, heights of the picture
 * @param {number} up distance above the middle, heights of the picture
 * @returns {FrameQuery}
 */
export function pointQuery({ overlay, background, f, ...view }, right, up) {
  const { width, height } = view;
  const inside = (/** @type {number} */ place, /** @type {number} */ pixels) =>
    Math.min(Math.max(place, 0), pixels - 0.5);
  return {
    ...view,
    x: inside(width / 2 + right * height, width),
    y: inside(height / 2 - up * height, height),
  };
}

/**
 * Return the colour scheme of the background: that of the view, or that of the page.
 * @param {Pick<Knobs, "background">} values knobs of the view
 * @returns {"light"|"dark"}
 */
export function ground({ background }) {
  if (background !== "page") return /** @type {"light"|"dark"} */ (background);
  return globalThis.matchMedia?.("(prefers-color-scheme: dark)").matches === false
    ? "light"
    : "dark";
}

/**
 * Describe a view's picture in words.
 * @param {Pick<Scene, "name"> & Partial<Pick<Scene, "volume">>} scene
 * @param {Pick<Knobs, "isovalue"|"azimuth"|"elevation"|"shading">} values knobs of the view
 * @returns {string}
 */
export function describe(scene, values) {
  const from = `azimuth ${Math.round(values.azimuth)}°, elevation ${Math.round(values.elevation)}°`;
  return `Isosurface of ${scene.name} at ${spelled(scene, values.isovalue)}, seen from ${from}; ${shadingName(values.shading)}`;
}

const DIGEST = /^[0-9a-f]{20}([0-9a-f]{12})?$/; // the id of an upload
const MOST_LETTERS = 40; // letters of a file's name

/**
 * Return true if a scene is an upload, whose id means nothing to people.
 * @param {Pick<Scene, "id">} scene
 * @returns {boolean}
 */
export function isUpload({ id }) {
  return DIGEST.test(id);
}

/**
 * Return the beginning of names of a scene's files: its id, or the name of an upload.
 * @param {Pick<Scene, "id"|"name">} scene
 * @returns {string}
 */
export function nameOfFiles(scene) {
  if (!isUpload(scene)) return scene.id;
  const words = scene.name
    .replace(/[^\p{L}\p{N}.]+/gu, "-")
    .slice(0, MOST_LETTERS)
    .replace(/^[-.]+|[-.]+$/g, "");
  return words || scene.id;
}

/**
 * Return the name of a view's file, without an ending.
 * @param {Pick<Scene, "id"|"name"> & Partial<Pick<Scene, "volume">>} scene
 * @param {Pick<Knobs, "isovalue">} values knobs of the view
 * @returns {string}
 */
export function fileName(scene, values) {
  return `${nameOfFiles(scene)}-${spelled(scene, values.isovalue)}`;
}

/**
 * Return the parameters that differ from the scene's defaults, and always the isovalue.
 * @param {Pick<Scene, "defaults">} scene
 * @param {FrameQuery} query
 * @returns {FrameQuery}
 */
export function changedParameters(scene, query) {
  /** @type {Record<string, string|number>} */
  const defaults = { ...scene.defaults, overlay: "none", background: "light", f: "png" };
  /** @type {(parameter: [string, string|number]) => boolean} */
  const changed = ([name, value]) =>
    name === "isovalue" || String(value) !== String(defaults[name]);
  return Object.fromEntries(Object.entries(query).filter(changed));
}

/** Keys of the table `[view]` of a scene file. */
const VIEW_KEYS = [
  ...["azimuth", "elevation", "distance", "target", "fov"],
  ...["yaw", "pitch", "roll", "exposure", "background"],
];

/** Keys of a scene file that views may change. */
const SCENE_KEYS = ["isovalue", "smooth", "projection", "environment", "cut", "albedo"];

/**
 * Write the view as lines of a scene file: keys of the scene, and its table `[view]`.
 * @param {FrameQuery} query the parameters of the picture shown
 * @returns {string}
 */
export function sceneText(query) {
  /** @param {string} name */
  const line = (name) => `${name} = ${tomlValue(name, query[name])}`;
  const given = (/** @type {string[]} */ names) =>
    names.filter((name) => query[name] !== undefined);
  const made = materialLines(query.material);
  return [
    ...given(SCENE_KEYS).map(line),
    ...made,
    "[view]",
    ...given(VIEW_KEYS).map(line),
  ].join("\n");
}

/**
 * Write a parameter as a value of TOML; lists are given with commas.
 * @param {string} name
 * @param {string|number} value
 * @returns {string}
 */
function tomlValue(name, value) {
  if (["target", "albedo"].includes(name) && String(value).includes(","))
    return `[${String(value).split(",").join(", ")}]`;
  return typeof value === "number" || name === "albedo" ? String(value) : JSON.stringify(value);
}

/**
 * Write the keys of a material that is spelled as in `glass,index=1.3,absorption=0.1,0.2,0.3`.
 * @param {string|number|undefined} text
 * @returns {string[]}
 */
function materialLines(text) {
  if (!text) return [];
  const [kind, ...rest] = String(text).split(/,(?=[a-z])/);
  const numbers = rest.map((each) => {
    const [key, value] = each.split("=");
    return `${key} = ${value.includes(",") ? `[${value.split(",").join(", ")}]` : value}`;
  });
  return [`material = ${JSON.stringify(kind)}`, ...numbers];
}

/**
 * Return a line for a shell that saves the picture. It names the variable that holds the token,
 * never the token itself.
 * @param {URL} address of the frame
 * @param {string} file
 * @param {boolean} token true if the server asks for one
 * @returns {string}
 */
export function curlLine(address, file, token) {
  const header = token ? ['-H "Authorization: Bearer $ISOGI_TOKEN"'] : [];
  return ["curl -f", ...header, quoted(address.href), "-o", plain(file) ? file : quoted(file)].join(
    " ",
  );
}

/**
 * Return a line of Python that saves the final picture. The client reads the token from the
 * environment.
 * @param {string} server address of the server
 * @param {string} scene
 * @param {FrameQuery} view
 * @param {string} file
 * @returns {string}
 */
export function pythonLine(server, scene, view, file) {
  const knobs = Object.entries(view)
    .map(([name, value]) => `, ${name}=${literal(value)}`)
    .join("");
  const frame = `frame(${literal(scene)}${knobs}, wait="final")`;
  return `from isogi.client import Isogi; Isogi(${literal(server)}).${frame}.save(${literal(file)})`;
}

/**
 * Write an isovalue with the digits that give the same surface again.
 * @param {Partial<Pick<Scene, "volume">>} scene
 * @param {number} isovalue
 */
function spelled({ volume }, isovalue) {
  return volume ? exactValue(isovalue, volume.value_range) : isovalue;
}

/**
 * Write a value for Python: its strings and numbers are those of JSON.
 * @param {string|number} value
 */
function literal(value) {
  return JSON.stringify(value);
}

/** Return true if a shell needs no quotes around a word. @param {string} word */
function plain(word) {
  return /^[\w.+-]+$/.test(word);
}

/** Put a word in single quotes for a shell. @param {string} word */
function quoted(word) {
  return `'${word.replaceAll("'", "'\\''")}'`;
}
