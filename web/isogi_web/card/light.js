/**
 * The rotated light of a scene, as shaders read it. Source in the core: `RotatedLight` of
 * isogi_core/frame/lighting.py.
 */

import { bandRotations, turned } from "./harmonics.js";

/** @typedef {import("./document.js").CardDocument} CardDocument */
/** @typedef {import("./document.js").Vec3} Vec3 */
/** @typedef {[number, number, number, number]} Quaternion w, x, y, z */

/**
 * @typedef {object} TurnedLight
 * @property {number[][]} columns light that each column of a texel's transfer is multiplied with:
 *   r, g, b, and their squared luminance
 * @property {number[]} quadric unshadowed light: r, g, b of each of nine coefficients, see
 *   `quadricOf`
 * @property {Vec3[]} towards direction to the middle of each lobe, in the volume's box
 * @property {[Vec3, Vec3][]} edges two radii of the disc of each lobe
 * @property {[Vec3, Vec3, Vec3]} matrix rows of its rotation in the box
 * @property {Vec3} key direction to the key light of local models, unless it follows the camera
 */

/**
 * Return the matrix that rotates a vector as a unit quaternion does.
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

/** The matrix that rotates nothing. */
const IDENTITY = rotationMatrix([1, 0, 0, 0]);

/**
 * Return a rotation of the world, followed by that from the world to the volume's box:
 * rotationᵀ · Q.
 * @param {Vec3[]} rotation rows of the rotation from the box to the world
 * @param {Vec3[]} q rows of the rotation in the world
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
 * Return spherical harmonics of one colour, up to order 3, as a polynomial of the unit vector (x,
 * y, z).
 *
 * The result holds its coefficients over 1, y, z, x, xy, yz, z², xz, x² - y². Source: Ramamoorthi
 * and Hanrahan 2001, eq. 13; `quadric_of` in the core.
 *
 * @param {readonly number[]} harmonics coefficients by l(l + 1) + m; missing ones are 0
 * @returns {number[]} nine coefficients
 */
export function quadricOf(harmonics) {
  const s = Array.from({ length: 9 }, (_, i) => harmonics[i] ?? 0);
  // The harmonic of l = 2, m = 0 is 3z² - 1 but for its factor: its constant part joins the first
  // coefficient.
  s[0] -= Math.sqrt(5 / 4) * s[6];
  return s.map(
    (x, i) => x * Math.sqrt([1, 3, 3, 3, 15, 15, 45 / 4, 15, 15 / 4][i] / (4 * Math.PI)),
  );
}

/**
 * Return the light of a scene in the volume's box, after a rotation in the world.
 * @param {CardDocument} document
 * @param {Quaternion} rotation unit quaternion; without effect if the scene's light does not turn
 * @returns {TurnedLight}
 */
export function turnLight({ grid, plan, light, model }, rotation) {
  // Light that turns is in the world in the document: turn it there, and bring it into the box.
  // Light that does not turn is in the box already, as the server bakes it there.
  const matrix = plan.turns ? inBox(grid.rotation, rotationMatrix(rotation)) : IDENTITY;
  const order = Math.max(...light.terms.map((term) => term.order), Math.sqrt(light.sky[0].length));
  const bands = bandRotations(order, matrix);
  // Rotate each colour of each term, and the squares that estimate noise, by the same bands.
  const terms = light.terms.flatMap((term) =>
    byColumn([...term.light, term.square].map((each) => turned(bands, each))),
  );
  const quadric = byColumn(light.sky.map((colour) => quadricOf(turned(bands, colour)))).flat();
  const turn = (/** @type {Vec3} */ v) =>
    /** @type {Vec3} */ (matrix.map((row) => row[0] * v[0] + row[1] * v[1] + row[2] * v[2]));
  const edges = light.lobes.map(
    (lobe) => /** @type {[Vec3, Vec3]} */ ([turn(lobe.edges[0]), turn(lobe.edges[1])]),
  );
  const towards = light.lobes.map((lobe) => turn(lobe.towards));
  const key = model.follows === "light" ? turn(model.key) : model.key;
  return { columns: terms, quadric, towards, edges, matrix, key };
}

/**
 * Transpose colours: return the numbers of all colours side by side, one entry per coefficient.
 * @param {number[][]} colours
 * @returns {number[][]}
 */
function byColumn(colours) {
  return colours[0].map((_, i) => colours.map((each) => each[i]));
}
