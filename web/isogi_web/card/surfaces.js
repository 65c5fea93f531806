/**
 * Several surfaces on a card: the maps of all of them in one texture, and the light of their sides
 * as shaders read it, see surfaces.glsl. A ray meets them front to back: peels.glsl.
 */

import { EMPTY } from "./cells.js";
import { codeOf } from "./document.js";
import { quadricOf } from "./light.js";

/** @typedef {import("./document.js").CardDocument} CardDocument */
/** @typedef {ReturnType<typeof import("./cells.js").markCells>} CellMap */

/** Return the number of surfaces of a scene. @param {CardDocument} document @returns {number} */
export const countOf = ({ surfaces }) => surfaces?.length ?? 1;

/**
 * Return the names that shaders of a scene are compiled with: none if it has one surface, which
 * then pays for nothing.
 * @param {CardDocument} document
 * @returns {Record<string, number>}
 */
export const definesOf = ({ surfaces }) => (surfaces ? { SURFACES: surfaces.length } : {});

/**
 * Return the isovalue of each surface as a code, the one that slides first.
 * @param {CardDocument} document
 * @param {number} shown isovalue of the surface that slides, in the file's units
 * @returns {number[]}
 */
export function codesOf(document, shown) {
  const surfaces = document.surfaces ?? [{ isovalue: null }];
  return surfaces.map(({ isovalue }) => codeOf(document, isovalue ?? shown));
}

/**
 * Join the active-cell maps of surfaces: their tops one behind the other along z, and their cells
 * in one list.
 * @param {CellMap[]} maps
 * @returns {CellMap}
 */
export function joinMaps(maps) {
  if (maps.length === 1) return maps[0];
  const each = maps[0].tops.length;
  const tops = new Uint32Array(maps.length * each);
  const marked = maps.reduce((sum, map) => sum + map.marked, 0);
  const cells = new Uint32Array(2 * marked);
  let first = 0;
  maps.forEach((map, k) => {
    // Numbers of bricks count on over all maps; distances of empty bricks stay.
    map.tops.forEach((top, b) => {
      tops[k * each + b] = top < EMPTY ? first + top : top;
    });
    cells.set(map.cells, 2 * first);
    first += map.marked;
  });
  return { tops, cells, marked };
}

/**
 * Return the uniforms of several surfaces; none if the scene has one.
 * @param {CardDocument} document
 * @param {number} shown isovalue of the surface that slides, in the file's units
 * @param {object} textures
 * @param {import("./textures.js").Texture} textures.tops
 * @param {import("./textures.js").Texture} textures.bricks
 * @returns {Record<string, import("./programs.js").Value>}
 */
export function uniformsOf(document, shown, { tops, bricks }) {
  const { surfaces } = document;
  if (!surfaces) return {};
  const isovalues = codesOf(document, shown);
  const sides = surfaces.flatMap(({ outer, inner }) => [outer, inner]);
  return {
    isovalues,
    // A surface at the isovalue of an earlier one coincides with it, and is not seen.
    clears: surfaces.map(({ clear }, k) => (isovalues.indexOf(isovalues[k]) < k ? 1 : clear)),
    shares: surfaces.flatMap(({ albedo }) => albedo),
    skies: sides.flatMap(({ sky }) => skyOf(sky)),
    darkest: sides.flatMap(({ least }) => (document.plan.ratios ? least : [0, 0, 0])),
    map_layers: tops.size[2] / surfaces.length,
    light_layers: bricks.size[2] / sides.length,
  };
}

/**
 * Return harmonics of unshadowed light as polynomials: r, g, b of each of nine coefficients.
 * @param {number[][]} sky of red, green and blue
 * @returns {number[]}
 */
function skyOf(sky) {
  const colours = sky.map(quadricOf);
  return colours[0].flatMap((_, i) => colours.map((each) => each[i]));
}
