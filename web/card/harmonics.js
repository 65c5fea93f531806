/** Rotation of real spherical harmonics: orthonormal, without the Condon-Shortley phase, index l(l + 1) + m.
 * Kernel: isogi_core/kernels/transport/harmonics.py.
 */

/** @typedef {number[][]} Matrix rows */

/**
 * P_i(l; m, n) of table 2.
 * @param {Matrix} first of band 1
 * @param {Matrix} before of band l - 1
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

/** Weights of P₁ and P₋₁ within V. @param {number} m @returns {[number, number]} */
function innerWeights(m) {
  const [same, other] = Math.abs(m) === 1 ? [Math.SQRT2, 0] : [1, 1];
  if (m === 0) return [-Math.SQRT2, -Math.SQRT2];
  return m > 0 ? [same, -other] : [other, same];
}

/**
 * Element (m, n) of band l: u U + v V + w W of tables 1 and 2 as corrected.
 * @param {Matrix} first
 * @param {Matrix} before
 * @param {number} l
 * @param {number} m
 * @param {number} n
 * @returns {number}
 */
function element(first, before, l, m, n) {
  const k = Math.abs(m);
  const s = m > 0 ? 1 : -1;
  const below = Math.abs(n) === l ? 2 * l * (2 * l - 1) : (l + n) * (l - n);
  const u = Math.sqrt(((l + m) * (l - m)) / below);
  const v = 0.5 * Math.sqrt(((l + k - 1) * (l + k)) / below);
  const w = k > 0 ? 0.5 * Math.sqrt(Math.max(0, (l - k - 1) * (l - k)) / below) : 0;
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
 * Matrices of the bands 0 … order - 1 of a rotation.
 * Source: Ivanic and Ruedenberg, J. Phys. Chem. 100, 6342 (1996), with the corrections in A 102,
 * 9099 (1998).
 * @param {number} order
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
 * Coefficients of a function that is turned: always of the unturned ones, as chained rotations
 * drift.
 * @param {Matrix[]} bands of the rotation, at least as many as the function has
 * @param {readonly number[]} coefficients
 * @returns {number[]}
 */
export function turned(bands, coefficients) {
  const out = [];
  for (let l = 0; l * l < coefficients.length; l++) {
    const own = coefficients.slice(l * l, (l + 1) * (l + 1));
    out.push(...bands[l].map((row) => row.reduce((sum, x, n) => sum + x * own[n], 0)));
  }
  return out;
}
