/**
 * The view of the page's controls, as the graphics card draws it, and as parameters of the requests
 * that the card needs.
 */

import { cutQuery, frameQuery, ground } from "../net/request.js";
import { albedoQuery } from "../view/albedo.js";
import { rayThrough } from "../view/camera.js";
import { NUMBERS, UNITS } from "../view/model.js";
import { planesOf } from "../view/planes.js";
import { fromAngles, inSteps, vector } from "../view/rotation.js";

/** @typedef {import("../card/document.js").CardDocument} CardDocument */
/** @typedef {import("../net/schemas.js").FrameQuery} FrameQuery */
/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {import("../view/model.js").Knobs} Knobs */
/** @typedef {import("../view/rotation.js").Angles} Angles */
/** @typedef {import("../view/rotation.js").Vec3} Vec3 */

/** Parameters that the transfer of texels depends on. */
const VARIANT = ["environment", "cut", "time", "smooth", "surfaces", "hide", "material"];

/** Parameters of a lobe, which a card draws by any document of a scene that shines. */
const OF_LOBE = ["shine", "roughness", "strength"];

/** Parameters that a scene's document depends on. */
const OF_DOCUMENT = [
  ...VARIANT,
  ...NUMBERS.filter((name) => UNITS[name] === "share" && !OF_LOBE.includes(name)),
];
/** Angles by which the light is turned. */
const ANGLES = ["yaw", "pitch", "roll"];

/** Parameters that a list of chunks does not depend on. */
const OF_PICTURE = ["f", "overlay", "background", "exposure"];

/** Width of the picture for which chunks are listed, pixels: chunks are seldom smaller on it. */
const WIDEST = 160;

/** Degrees between the views for which chunks are listed while the camera turns. */
const STEP = 15;

/**
 * Return the parameters with some names.
 * @param {FrameQuery} query
 * @param {string[]} names
 * @returns {FrameQuery}
 */
function only(query, names) {
  return Object.fromEntries(Object.entries(query).filter(([name]) => names.includes(name)));
}

/**
 * Return the parameters of the request for a scene's document: all that it depends on. It serves all
 * shadings that a card draws.
 * @param {Scene} scene
 * @param {Knobs} values
 * @returns {FrameQuery}
 */
export function documentQuery(scene, values) {
  const query = frameQuery(scene, values, { width: 1, height: 1 });
  // Light that is baked for each turn is another light at each.
  const names = scene.turn_step ? [...OF_DOCUMENT, ...ANGLES] : OF_DOCUMENT;
  return { ...only(query, names), shading: "gi" };
}

/**
 * Return the parameters of the request for the chunks that a view reads: those of a small picture,
 * which lists the chunks quickly.
 * @param {Scene} scene
 * @param {Knobs} values
 * @param {{width: number, height: number}} size of the picture
 * @returns {FrameQuery}
 */
export function chunksQuery(scene, values, { width, height }) {
  // A small picture with the proportions of the stage reads the same chunks.
  const size = { width: WIDEST, height: Math.max(Math.round((WIDEST * height) / width), 1) };
  return Object.fromEntries(
    Object.entries(frameQuery(scene, values, size)).filter(([name]) => !OF_PICTURE.includes(name)),
  );
}

/**
 * Return a nearby view that reads almost the same chunks, one for many moving views.
 *
 * Camera angles are rounded. The light's rotation and the albedo, which no list depends on, are
 * reset, unless light is baked for each turn. A visitor who turns the object thus causes few
 * requests, and one who turns the light causes none.
 *
 * @param {Knobs} values
 * @param {Partial<Pick<Scene, "turn_step">>} [scene]
 * @returns {Knobs}
 */
export function viewNear(values, { turn_step = null } = {}) {
  const near = (/** @type {number} */ angle) => STEP * Math.round(angle / STEP);
  return {
    ...values,
    albedo: undefined,
    ...(!turn_step && { yaw: 0, pitch: 0, roll: 0 }),
    azimuth: ((near(values.azimuth) + 540) % 360) - 180,
    elevation: near(values.elevation),
  };
}

/**
 * Return the parameters of the request for records of texels, or for their transfer. Light of pinned
 * surfaces depends on the isovalue of the one that slides.
 * @param {Scene} scene
 * @param {Pick<CardDocument, "plan"|"surfaces">} document
 * @param {Knobs} values
 * @param {Angles|null} turn rotation of the light; null for transfer, which depends on none
 * @returns {FrameQuery}
 */
export function lightQuery(scene, { plan, surfaces }, values, turn) {
  const query = frameQuery(scene, values, { width: 1, height: 1 });
  if (!turn) return only(query, VARIANT);
  const names = [...VARIANT, "albedo", ...(surfaces ? ["isovalue"] : [])];
  // Light that is baked for each turn is that of the view's angles.
  if (!plan.turns) return only(query, [...names, ...ANGLES]);
  return { ...only(query, names), ...(scene.turns && anglesOf(turn)) };
}

/**
 * Return the angles by which the card turns the light: none if the server bakes it for each turn.
 *
 * The document says which, as hidden surfaces leave light that turns; the angles are still those of
 * the server's pictures, in steps if the scene has them.
 *
 * @param {Pick<Scene, "turns"|"turn_step">} scene
 * @param {Pick<CardDocument, "plan">} document
 * @param {Angles} values
 * @returns {Angles} degrees
 */
export function turnOf({ turns, turn_step }, { plan }, values) {
  return turns && plan.turns ? inSteps(values, turn_step) : { yaw: 0, pitch: 0, roll: 0 };
}

/**
 * Return the angles of the light's rotation alone, degrees.
 * @param {Angles} values
 * @returns {Angles} degrees
 */
export function anglesOf({ yaw, pitch, roll }) {
  return { yaw, pitch, roll };
}

/**
 * Return the albedo of a view, linear RGB.
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
 * Return the lobe that a view asks for.
 * @param {import("../card/shine.js").Lobe} lobe that of the scene
 * @param {Knobs} values
 * @returns {import("../card/shine.js").Lobe}
 */
function lobeOf({ kind, roughness, strength }, values) {
  return {
    kind: values.shine ?? kind,
    roughness: values.roughness ?? roughness,
    strength: values.strength ?? strength,
  };
}

/**
 * Return the view as a card draws it.
 * @param {Scene} scene
 * @param {CardDocument} document
 * @param {Knobs} values
 * @param {Vec3} [folded] albedo that the card's light was computed for, if views may change it
 * @returns {import("../card/drawing.js").View}
 */
export function cardView(scene, document, values, folded) {
  const { eye, target, up } = rayThrough(scene, { ...values, projection: "perspective" }, 0, 0);
  // The card makes parallel rays by itself, from the perspective camera.
  const parallel = values.projection === "orthographic";
  return {
    isovalue: values.isovalue,
    camera: { eye, target, up, fov: values.fov, parallel },
    light: fromAngles(turnOf(scene, document, values)),
    exposure: values.exposure,
    ...(folded && {
      albedo: vector((i) => (folded[i] > 0 ? albedoOf(scene, values)[i] / folded[i] : 1)),
    }),
    ...(document.shine && { shine: lobeOf(document.shine, values) }),
    ground: document.grounds[ground(values)],
    window: planesOf(cutQuery(values).window ?? ""),
    shading: values.shading,
    marked: values.overlay === "provisional",
  };
}
