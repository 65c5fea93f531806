/**
 * The light of a scene, turned, as shaders take it. Source in the core: `RotatedLight` of
 * isogi_core/frame/lighting.py.
 */

import { bandRotations, turned } from "./harmonics.js";

/** @typedef {import("./document.js").CardDocument} CardDocument */
/** @typedef {import("./document.js").Vec3} Vec3 */
/** @typedef {[number, number, number, number]} Quaternion w, x, y, z */

/**
 * @typedef {object} TurnedLight
 * @property {number[][]} columns what each column of a texel's transfer meets, r, g, b, and their
 *   luminance squared
 * @property {number[]} quadric unshadowed light, nine times r, g, b
 * @property {Vec3[]} towards of each lobe
 * @property {[Vec3, Vec3][]} edges of each lobe
 */

/**
 * The matrix that turns a vector by a unit quaternion.
 * @param {Quaternion} q
 * @returns {[Vec3, Vec3, Vec3]} rows
 */
export function rotationMatrix([w, x, y, z]) {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
    [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
    [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
  ];
}

/**
 * The rotation in a box whose axes in the world are the columns of `rotation`: rotationᵀ · Q.
 * @param {Vec3[]} rotation
 * @param {Vec3[]} q
 * @returns {[Vec3, Vec3, Vec3]}
 */
function inBox(rotation, q) {
  const row = (/** @type {number} */ i) =>
    /** @type {Vec3} */ (
      [0, 1, 2].map(
        (j) => rotation[0][i] * q[0][j] + rotation[1][i] * q[1][j] + rotation[2][i] * q[2][j],
      )
    );
  return [row(0), row(1), row(2)];
}

/**
 * Harmonics of a colour, of order 3 at most, as a polynomial of the unit vector: over 1, y, z, x,
 * xy, yz, z², xz, x² - y².
 * Source: Ramamoorthi and Hanrahan 2001, eq. 13; `quadric_of` in the core.
 * @param {readonly number[]} harmonics
 * @returns {number[]}
 */
export function quadricOf(harmonics) {
  const s = Array.from({ length: 9 }, (_, i) => harmonics[i] ?? 0);
  s[0] -= Math.sqrt(5 / 4) * s[6];
  return s.map(
    (x, i) => x * Math.sqrt([1, 3, 3, 3, 15, 15, 45 / 4, 15, 15 / 4][i] / (4 * Math.PI)),
  );
}

/**
 * The light of a scene as a rotation in the world turns it.
 * @param {CardDocument} document
 * @param {Quaternion} rotation
 * @returns {TurnedLight}
 */
export function turnLight({ grid, light }, rotation) {
  const matrix = inBox(grid.rotation, rotationMatrix(rotation));
  const order = Math.max(...light.terms.map((term) => term.order), Math.sqrt(light.sky[0].length));
  const bands = bandRotations(order, matrix);
  const terms = light.terms.flatMap((term) =>
    byColumn([...term.light, term.square].map((each) => turned(bands, each))),
  );
  const quadric = byColumn(light.sky.map((colour) => quadricOf(turned(bands, colour)))).flat();
  const turn = (/** @type {Vec3} */ v) =>
    /** @type {Vec3} */ (matrix.map((row) => row[0] * v[0] + row[1] * v[1] + row[2] * v[2]));
  const edges = light.lobes.map(
    (lobe) => /** @type {[Vec3, Vec3]} */ ([turn(lobe.edges[0]), turn(lobe.edges[1])]),
  );
  return { columns: terms, quadric, towards: light.lobes.map((lobe) => turn(lobe.towards)), edges };
}

/** Numbers of colours, each side by side. @param {number[][]} colours @returns {number[][]} */
function byColumn(colours) {
  return colours[0].map((_, i) => colours.map((each) => each[i]));
}
