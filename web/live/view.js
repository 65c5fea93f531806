/**
 * The view of the page's knobs, as the graphics card draws it, and as the server is asked for what
 * that takes.
 */

import { cutQuery, frameQuery, ground } from "../net/request.js";
import { albedoQuery } from "../view/albedo.js";
import { rayThrough } from "../view/camera.js";
import { NUMBERS, UNITS } from "../view/model.js";
import { planesOf } from "../view/planes.js";
import { fromAngles, vector } from "../view/rotation.js";

/** @typedef {import("../card/document.js").CardDocument} CardDocument */
/** @typedef {import("../net/schemas.js").FrameQuery} FrameQuery */
/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {import("../view/model.js").Knobs} Knobs */
/** @typedef {import("../view/rotation.js").Angles} Angles */
/** @typedef {import("../view/rotation.js").Vec3} Vec3 */

const VARIANT = ["environment", "cut", "time", "smooth", "surfaces", "hide", "material"];
const OF_DOCUMENT = [
  ...VARIANT,
  "shading",
  "shine",
  ...NUMBERS.filter((name) => UNITS[name] === "share"),
];
// what a list of chunks does not depend on
const OF_PICTURE = ["f", "overlay", "background", "exposure"];
// pixels across, of a view whose chunks are asked for: a chunk is seldom smaller
const WIDEST = 160;

const STEP = 15; // degrees between the views that are listed while the camera turns

/** @param {FrameQuery} query @param {string[]} names @returns {FrameQuery} */
function only(query, names) {
  return Object.fromEntries(Object.entries(query).filter(([name]) => names.includes(name)));
}

/**
 * The parameters that a scene's document is asked for by: all on which it depends.
 * @param {Scene} scene
 * @param {Knobs} values
 * @returns {FrameQuery}
 */
export function documentQuery(scene, values) {
  return only(frameQuery(scene, values, { width: 1, height: 1 }), OF_DOCUMENT);
}

/**
 * The parameters that the chunks of a view are asked for by: it is looked at coarsely.
 * @param {Scene} scene
 * @param {Knobs} values
 * @param {{width: number, height: number}} size of the picture
 * @returns {FrameQuery}
 */
export function chunksQuery(scene, values, { width, height }) {
  const size = { width: WIDEST, height: Math.max(Math.round((WIDEST * height) / width), 1) };
  return Object.fromEntries(
    Object.entries(frameQuery(scene, values, size)).filter(([name]) => !OF_PICTURE.includes(name)),
  );
}

/**
 * A view that reads nearly the same chunks, one for many that move: whoever turns the object asks
 * for few lists, and
 * whoever turns the light, or changes the albedo, for none.
 * @param {Knobs} values
 * @returns {Knobs}
 */
export function viewNear(values) {
  const near = (/** @type {number} */ angle) => STEP * Math.round(angle / STEP);
  return {
    ...values,
    albedo: undefined,
    yaw: 0,
    pitch: 0,
    roll: 0,
    azimuth: ((near(values.azimuth) + 540) % 360) - 180,
    elevation: near(values.elevation),
  };
}

/**
 * The parameters that records of texels are asked for by, or their transfer.
 * @param {Scene} scene
 * @param {Knobs} values
 * @param {Angles|null} turn of the light; null for transfer, which is of none
 * @returns {FrameQuery}
 */
export function lightQuery(scene, values, turn) {
  const query = only(
    frameQuery(scene, values, { width: 1, height: 1 }),
    turn ? [...VARIANT, "albedo"] : VARIANT,
  );
  return turn && scene.turns ? { ...query, ...anglesOf(turn) } : query;
}

/** How the light is turned, and nothing else. @param {Angles} values @returns {Angles} degrees */
export function anglesOf({ yaw, pitch, roll }) {
  return { yaw, pitch, roll };
}

/**
 * What share of the light the surface reflects in a view.
 * @param {Scene} scene
 * @param {Knobs} values
 * @returns {Vec3} linear RGB
 */
export function albedoOf(scene, values) {
  const { albedo } = albedoQuery(scene, values);
  if (albedo === undefined) return scene.albedo;
  const shares = String(albedo).split(",").map(Number);
  return vector((i) => shares[i] ?? shares[0]);
}

/**
 * The view as a card draws it.
 * @param {Scene} scene
 * @param {CardDocument} document
 * @param {Knobs} values
 * @param {Vec3} [folded] the albedo that the card's light is for, where views may choose it
 * @returns {import("../card/drawing.js").View}
 */
export function cardView(scene, document, values, folded) {
  const { eye, target, up } = rayThrough(scene, { ...values, projection: "perspective" }, 0, 0);
  const parallel = values.projection === "orthographic";
  return {
    isovalue: values.isovalue,
    camera: { eye, target, up, fov: values.fov, parallel },
    light: fromAngles(scene.turns ? values : { yaw: 0, pitch: 0, roll: 0 }),
    exposure: values.exposure,
    ...(folded && {
      albedo: vector((i) => (folded[i] > 0 ? albedoOf(scene, values)[i] / folded[i] : 1)),
    }),
    ground: document.grounds[ground(values)],
    window: planesOf(cutQuery(values).window ?? ""),
    marked: values.overlay === "provisional",
  };
}
