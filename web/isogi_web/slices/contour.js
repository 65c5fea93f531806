/**
 * The contour of an isosurface on a slice by marching squares, linear along the edges between
 * voxels.
 */

/** @typedef {import("./values.js").Values} Values */
/** @typedef {"top"|"right"|"foot"|"left"} Edge of the square between four voxels */
/**
 * @typedef {[number, number, number, number]} Corners values less the isovalue, row by row
 */

/**
 * Pairs of edges that the contour joins, by the number of a square: the sum of 1, 2, 4 and 8 for a
 * solid upper left, upper right, lower left and lower right corner. Squares 6 and 9, in which two
 * opposite corners are solid, are ambiguous: see `twoLines`.
 * @type {[Edge, Edge][][]}
 */
const JOINED = [];
JOINED[1] = JOINED[14] = [["top", "left"]];
JOINED[2] = JOINED[13] = [["top", "right"]];
JOINED[3] = JOINED[12] = [["left", "right"]];
JOINED[4] = JOINED[11] = [["left", "foot"]];
JOINED[5] = JOINED[10] = [["top", "foot"]];
JOINED[7] = JOINED[8] = [["right", "foot"]];
const ALL_SOLID = 15;

/**
 * Return the lines in which an isosurface crosses a slice.
 * @param {Values} slice
 * @param {number} isovalue in the units of the values
 * @returns {number[]} x and y of both ends of each line, in voxels from the upper left corner; the
 *   middle of a voxel has the fraction 0.5
 */
export function contourOf({ values, width, height }, isovalue) {
  /** @type {number[]} */
  const lines = [];
  for (let y = 0; y + 1 < height; y += 1) {
    for (let x = 0; x + 1 < width; x += 1) {
      const i = y * width + x;
      const [a, b, c, d] = [values[i], values[i + 1], values[i + width], values[i + width + 1]];
      // Number the square by its solid corners, those above the isovalue.
      const solid =
        Number(a > isovalue) +
        2 * Number(b > isovalue) +
        4 * Number(c > isovalue) +
        8 * Number(d > isovalue);
      if (solid > 0 && solid < ALL_SOLID)
        cross(lines, x + 0.5, y + 0.5, solid, [
          a - isovalue,
          b - isovalue,
          c - isovalue,
          d - isovalue,
        ]);
    }
  }
  return lines;
}

/**
 * Add the lines in a square; none next to a hole.
 * @param {number[]} lines
 * @param {number} x middle of its upper left voxel
 * @param {number} y
 * @param {number} solid number of the square in JOINED
 * @param {Corners} corners
 */
function cross(lines, x, y, solid, corners) {
  const [a, b, c, d] = corners;
  if (Number.isNaN(a + b + c + d)) return;
  for (const [from, to] of JOINED[solid] ?? twoLines(corners)) {
    addEnd(lines, x, y, from, corners);
    addEnd(lines, x, y, to, corners);
  }
}

/**
 * Add the point at which the contour meets an edge, by linear interpolation between its corners.
 * @param {number[]} lines
 * @param {number} x
 * @param {number} y
 * @param {Edge} edge
 * @param {Corners} corners
 */
function addEnd(lines, x, y, edge, [a, b, c, d]) {
  if (edge === "top") lines.push(x + a / (a - b), y);
  else if (edge === "right") lines.push(x + 1, y + b / (b - d));
  else if (edge === "foot") lines.push(x + c / (c - d), y + 1);
  else lines.push(x, y + a / (a - c));
}

/**
 * Return both lines in a square whose opposite corners are solid, as the bilinear contour runs: the
 * sign of the value at the saddle decides.
 * @param {Corners} corners
 * @returns {[Edge, Edge][]}
 */
function twoLines([a, b, c, d]) {
  return a * d < b * c
    ? [
        ["top", "left"],
        ["right", "foot"],
      ]
    : [
        ["top", "right"],
        ["left", "foot"],
      ];
}
