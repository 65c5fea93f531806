/** A view as others know it: as the parameters of a frame request, in words, and as the name of a file. */

import { shadingName } from "./knobs.js";
import { albedoQuery } from "./surface.js";
import { NUMBERS } from "./view.js";

const LIGHT_KNOBS = new Set(["yaw", "pitch", "roll"]);

/**
 * The parameters of the request for a view's picture.
 * @param {object} scene answer of `readScene`
 * @param {object} values knobs of the view
 * @param {{width: number, height: number}} size pixels
 * @returns {Record<string, string|number>}
 */
export function frameQuery(scene, values, { width, height }) {
  const told = (name) => name in values && name !== "albedo";
  const numbers = NUMBERS.filter((name) => told(name) && (scene.turns || !LIGHT_KNOBS.has(name)));
  return {
    ...Object.fromEntries(numbers.map((name) => [name, values[name]])),
    ...albedoQuery(scene, values),
    ...(values.target && { target: values.target.join(",") }),
    width,
    height,
    shading: values.shading,
    overlay: values.overlay,
    f: "png",
  };
}

/**
 * What a view's picture shows.
 * @param {object} scene answer of `readScene`
 * @param {object} values knobs of the view
 * @returns {string}
 */
export function describe(scene, values) {
  const from = `azimuth ${Math.round(values.azimuth)}°, elevation ${Math.round(values.elevation)}°`;
  return `Isosurface of ${scene.name} at ${short(values.isovalue)}, seen from ${from}; ${shadingName(values.shading)}`;
}

/**
 * The name of a view's file, without an ending.
 * @param {object} scene answer of `readScene`
 * @param {object} values knobs of the view
 * @returns {string}
 */
export function fileName(scene, values) {
  return `${scene.id}-${short(values.isovalue)}`;
}

function short(isovalue) {
  return Number(isovalue.toPrecision(6));
}
