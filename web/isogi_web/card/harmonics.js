/**
 * Rotation of real spherical harmonics: orthonormal, without the Condon-Shortley phase, index l(l +
 * 1) + m. Kernel: isogi_core/kernels/transport/harmonics.py.
 *
 * Source: Ivanic and Ruedenberg, J. Phys. Chem. 100, 6342 (1996), with the corrections in A 102,
 * 9099 (1998). Tables in the comments below are theirs.
 */

/** @typedef {number[][]} Matrix rows */

/**
 * Return P_i(l; m, n) of table 2.
 * @param {Matrix} first matrix of band 1
 * @param {Matrix} before matrix of band l - 1
 * @param {number} l
 * @param {number} i
 * @param {number} m
 * @param {number} n
 * @returns {number}
 */
function step(first, before, l, i, m, n) {
  const row = before[m + l - 1];
  if (n === l) return first[1 + i][2] * row[2 * l - 2] - first[1 + i][0] * row[0];
  if (n === -l) return first[1 + i][2] * row[0] + first[1 + i][0] * row[2 * l - 2];
  return first[1 + i][1] * row[n + l - 1];
}

/**
 * Return the weights of P₁ and P₋₁ within V, as table 2 has them for m.
 * @param {number} m
 * @returns {[number, number]}
 */
function innerWeights(m) {
  const [same, other] = Math.abs(m) === 1 ? [Math.SQRT2, 0] : [1, 1];
  if (m === 0) return [-Math.SQRT2, -Math.SQRT2];
  return m > 0 ? [same, -other] : [other, same];
}

/**
 * Return element (m, n) of the matrix of band l: u U + v V + w W of tables 1 and 2, as corrected.
 * @param {Matrix} first matrix of band 1
 * @param {Matrix} before matrix of band l - 1
 * @param {number} l
 * @param {number} m
 * @param {number} n
 * @returns {number}
 */
function element(first, before, l, m, n) {
  // Table 1: the factors u, v, w.
  const k = Math.abs(m);
  const s = m > 0 ? 1 : -1;
  const below = Math.abs(n) === l ? 2 * l * (2 * l - 1) : (l + n) * (l - n);
  const u = Math.sqrt(((l + m) * (l - m)) / below);
  const v = 0.5 * Math.sqrt(((l + k - 1) * (l + k)) / below);
  const w = k > 0 ? 0.5 * Math.sqrt(Math.max(0, (l - k - 1) * (l - k)) / below) : 0;
  // Table 2: U, V and W as a sum of terms [i, row, weight], each of which adds weight · P_i of that
  // row. Rows outside band l - 1 have weight 0.
  const [plus, minus] = innerWeights(m);
  const parts = /** @type {[number, number, number][]} */ ([
    [0, m, u],
    [1, m - s, v * plus],
    [-1, s - m, v * minus],
    [1, m + s, -w],
    [-1, -m - s, -s * w],
  ]);
  return parts.reduce(
    (sum, [i, row, weight]) =>
      weight === 0 || Math.abs(row) > l - 1
        ? sum
        : sum + weight * step(first, before, l, i, row, n),
    0,
  );
}

/**
 * Return the matrices that rotate the bands 0 … order - 1, by recursion from band to band. Source:
 * Ivanic and Ruedenberg 1996 and 1998.
 * @param {number} order number of bands
 * @param {Matrix} matrix the rotation, 3 × 3
 * @returns {Matrix[]} element (m, n) of band l at [m + l][n + l]
 */
export function bandRotations(order, matrix) {
  const first = [1, 2, 0].map((i) => [1, 2, 0].map((j) => matrix[i][j])); // band 1 runs y, z, x
  const bands = [[[1]], first];
  for (let l = 2; l < order; l++) {
    const each = Array.from({ length: 2 * l + 1 }, (_, i) => i - l);
    bands.push(each.map((m) => each.map((n) => element(first, bands[l - 1], l, m, n))));
  }
  return bands.slice(0, order);
}

/**
 * Return the coefficients of a rotated function.
 *
 * Pass the coefficients before any rotation: rotating those of a rotated function again accumulates
 * rounding.
 *
 * @param {Matrix[]} bands matrices of the rotation, at least one per band of the function
 * @param {readonly number[]} coefficients
 * @returns {number[]}
 */
export function turned(bands, coefficients) {
  const out = [];
  for (let l = 0; l * l < coefficients.length; l++) {
    const band = coefficients.slice(l * l, (l + 1) * (l + 1));
    out.push(...bands[l].map((row) => row.reduce((sum, x, n) => sum + x * band[n], 0)));
  }
  return out;
}
