/**
 * The view in the address bar: read on load, and written shortly after a change, so that a link
 * shows the same picture.
 */

import { WHITE, startAlbedo } from "../view/albedo.js";
import { exactValue } from "../view/format.js";
import {
  readCrossHair,
  readMeasure,
  readNotes,
  writeCrossHair,
  writeMeasure,
} from "../view/measures.js";
import { NUMBERS, inShort, readDifference } from "../view/model.js";
import { arePlanes } from "../view/planes.js";
import { areHidden, areSurfaces, idleKnobs, isMaterial } from "../view/surfaces.js";
import { cutQuery, isUpload } from "./request.js";

/** @typedef {import("../view/model.js").Knobs} Knobs */
/** @typedef {import("../view/model.js").ViewModel} ViewModel */
/** @typedef {import("./schemas.js").Scene} Scene */

/** Parameters that are names, and are copied as they are. */
const CHOICES = [
  "shading",
  "overlay",
  "compare",
  "tint",
  "background",
  "environment",
  "shine",
  "rulers",
  "projection",
];

/** Parameters of an address that this page knows, besides numbers. */
const KNOWN = new Set([
  ...CHOICES,
  "scene",
  "name",
  "target",
  "token",
  "measure",
  "slices",
  "cut",
  "window",
  "surfaces",
  "hide",
  "material",
  "draw",
]);

/** Values of `draw`, by which an address forces the card or the server to draw, to compare them. */
const DRAWS = ["card", "server"];
const PAUSE_MS = 150; // time without a change before the address is written
const REST_MS = 1000; // time at rest after which a view becomes an entry of the history

/**
 * Read the knobs of a view from an address. Values that are not numbers are left out, so that the
 * scene's defaults apply.
 * @param {string} search the part of the address from `?` on
 * @returns {{scene: string|null, draw: string|null, start: Partial<Knobs>}} `draw` is "card",
 *   "server" or null; `start` holds the knobs that the address gives
 */
export function readAddress(search) {
  const query = new URLSearchParams(search);
  const numbers = NUMBERS.filter((name) => query.get(name)?.trim()).map((name) => [
    name,
    Number(query.get(name)),
  ]);
  const start = Object.fromEntries(numbers.filter(([, value]) => Number.isFinite(value)));
  const target = query.get("target");
  if (target !== null) start.target = target.split(",").map(Number);
  else if (query.has("distance")) start.target = null; // the address gives a whole camera
  for (const name of CHOICES.filter((each) => query.has(each))) start[name] = query.get(name);
  // Cut and window together are the planes of the view; with a cut, light comes in.
  const planes = ["cut", "window"]
    .map((name) => query.get(name))
    .filter(Boolean)
    .join(";");
  if (planes) Object.assign(start, { planes, opened: query.has("cut") });
  for (const name of ["surfaces", "hide", "material"])
    if (query.get(name)) start[name] = query.get(name);
  const measures = query
    .getAll("measure")
    .map(readMeasure)
    .filter((points) => points !== null);
  if (measures.length) Object.assign(start, { measures, notes: readNotes(query.getAll("measure")) });
  const slices = readCrossHair(query.get("slices") ?? "");
  if (slices) start.slices = slices;
  return {
    scene: query.get("scene"),
    draw: DRAWS.find((each) => each === query.get("draw")) ?? null,
    start,
  };
}

/**
 * Write the address query of a view, with the names of the frame request.
 *
 * Values that equal the scene's defaults are written as short as their slider can tell them apart,
 * and the default exposure is left out.
 *
 * @param {Scene} scene
 * @param {Knobs} values knobs of the view
 * @returns {string}
 */
export function writeAddress(scene, values) {
  const query = new URLSearchParams({ scene: scene.id });
  if (isUpload(scene)) query.set("name", scene.name);
  const idle = idleKnobs(values.material);
  for (const name of NUMBERS.filter((each) => each in values && !idle.includes(each))) {
    const value = /** @type {number} */ (values[name]);
    // The exposure's default depends on the light, so that a link should not fix it.
    const usual = value === scene.defaults[name];
    if (!usual || name !== "exposure")
      query.set(name, String(usual ? inShort(scene, name, value) : value));
  }
  if (values.target) query.set("target", values.target.join(","));
  if (
    values.tint &&
    !idle.includes("tint") &&
    [values.tint, startAlbedo(scene).tint].some((tint) => tint !== WHITE)
  )
    query.set("tint", values.tint);
  if (values.shine) query.set("shine", values.shine);
  query.set("shading", values.shading);
  if (values.overlay !== "none") query.set("overlay", values.overlay);
  if (values.environment) query.set("environment", values.environment);
  if (values.background !== "page") query.set("background", values.background);
  Object.entries(cutQuery(values)).forEach(([name, planes]) => query.set(name, planes));
  if (values.surfaces) query.set("surfaces", values.surfaces);
  if (values.hide) query.set("hide", values.hide);
  if (values.material) query.set("material", values.material);
  if (values.projection !== (scene.defaults?.projection ?? "perspective"))
    query.set("projection", values.projection);
  if (values.rulers !== "on") query.set("rulers", values.rulers);
  if (values.compare) query.set("compare", values.compare);
  for (const name of values.measures.map(writeMeasure))
    query.append("measure", name in values.notes ? `${name}~${values.notes[name]}` : name);
  if (values.slices) query.set("slices", writeCrossHair(values.slices));
  return `?${query}`;
}

/**
 * Return sentences about the parts of an address that cannot be shown.
 * @param {string} search the part of the address from `?` on
 * @param {Pick<Scene, "id"|"name"|"shadings"|"ranges"|"volume"> & Partial<Pick<Scene,
 *   "environments">>} scene the scene that is shown
 * @returns {string[]}
 */
export function complaints(search, scene) {
  const query = new URLSearchParams(search);
  const named = query.get("scene");
  /** @type {(name: string, value: string) => string} */
  const complaint = (name, value) => {
    const number = NUMBERS.find((each) => each === name);
    if (!number) return choiceComplaint(scene, name, value);
    if (!value.trim() || !Number.isFinite(Number(value)))
      return `“${value}” is no number for ${name}.`;
    return number === "isovalue" ? isovalueComplaint(scene, Number(value)) : "";
  };
  const lost =
    named && named !== scene.id
      ? [`There is no scene “${query.get("name") ?? named}”: this is ${scene.name}.`]
      : [];
  return [...lost, ...[...query].map(([name, value]) => complaint(name, value)).filter(Boolean)];
}

/**
 * Return a sentence if a scene has no surface at an isovalue, otherwise "".
 * @param {Pick<Scene, "ranges"|"volume">} scene
 * @param {number} isovalue
 * @returns {string}
 */
export function isovalueComplaint({ ranges, volume }, isovalue) {
  const [low, high] = volume.value_range;
  const { min, max } = ranges.isovalue ?? { min: low, max: high };
  if (isovalue >= min && isovalue <= max) return "";
  const [from, to] = [min, max].map((value) => exactValue(value, volume.value_range));
  const what = min > low || max < high ? "this scene shows" : "values go from";
  return `No surface at ${isovalue}: ${what} ${from} to ${to}.`;
}

/**
 * Return a sentence if a parameter that is not a number does not fit the scene, otherwise "".
 * @type {(scene: Pick<Scene, "id"|"shadings"|"ranges"|"volume"> & Partial<Pick<Scene,
 *   "environments"|"surfaces"|"colours"|"materials">>, name: string, value: string) => string}
 */
function choiceComplaint(scene, name, value) {
  const { shadings, environments = [], surfaces = [], colours, materials = [] } = scene;
  // Check each kind of parameter; the first problem is reported.
  const lit = name !== "environment" || !value || environments.some(({ id }) => id === value);
  if (!lit) return `There is no light “${value}” here.`;
  if (["cut", "window"].includes(name) && !arePlanes(value))
    return `“${value}” is no ${name}: it is planes such as x>40.`;
  if (name === "measure" && !readMeasure(value))
    return `“${value}” is no measure: it has two or three points.`;
  if (name === "slices" && !readCrossHair(value))
    return `“${value}” is no place of slices: it is a voxel such as 12,30,5.`;
  if (name === "surfaces" && !areSurfaces(value, surfaces.length))
    return `“${value}” does not fit the other surfaces of this scene.`;
  if (name === "hide" && !areHidden(value, colours?.labels ?? []))
    return `“${value}” does not fit the labels.`;
  if (name === "material" && value && !isMaterial(value, materials))
    return materialComplaint(materials, value);
  if (name === "compare" && value && !readDifference(scene, value))
    return `There is no “${value}” to compare with.`;
  if (name === "draw" && !DRAWS.includes(value))
    return `“${value}” draws nothing here: choose card or server.`;
  if (name === "shading" && value && !shadings.includes(value))
    return `There is no shading “${value}”.`;
  return KNOWN.has(name) ? "" : `The link says ${name}, which this page does not know.`;
}

/**
 * Return a sentence that says why a material does not fit the scene.
 * @type {(materials: import("../documents.js").Material[], value: string) => string}
 */
function materialComplaint(materials, value) {
  const { refused } = materials.find(({ kind }) => kind === value.split(",")[0]) ?? {};
  return `“${value}” is no material of this scene${refused ? `: ${refused}` : "."}`;
}

/**
 * Keep the address bar up to date with the view.
 *
 * Browsers limit how often pages may do so: the address is written after a short pause. A view that
 * was at rest becomes an entry of the history; going back and forward shows the view of the entry.
 *
 * @param {Scene} scene
 * @param {ViewModel} view
 * @returns {() => string} writes a pending address now, and returns the whole address
 */
export function followAddress(scene, view) {
  let timer = 0;
  let changed = -Infinity; // time of the view's last change
  const { draw } = readAddress(location.search);
  const kept = draw ? `&draw=${draw}` : "";
  /** @type {"replaceState"|"pushState"} */
  let entry = "replaceState";
  const write = () => {
    clearTimeout(timer);
    const address = writeAddress(scene, view.values) + kept;
    if (address !== location.search) history[entry](null, "", address);
    entry = "replaceState";
    return location.href;
  };
  view.subscribe((_, follows) => {
    const now = performance.now();
    if (now - changed > REST_MS && !follows) entry = "pushState";
    changed = now;
    clearTimeout(timer);
    timer = setTimeout(write, PAUSE_MS);
  });
  window.addEventListener("popstate", () => {
    view.set({ ...view.defaults, ...readAddress(location.search).start });
    entry = "replaceState";
    changed = -Infinity;
  });
  return write;
}
