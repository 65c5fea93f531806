/**
 * The contour of an isosurface on a slice: marching squares, linear along the edges between voxels.
 */

/** @typedef {import("./values.js").Values} Values */
/** @typedef {"top"|"right"|"foot"|"left"} Edge of the square between four voxels */
/**
 * @typedef {[number, number, number, number]} Corners their values over the isovalue, row by row
 */

/**
 * The edges that the contour joins, by which corners are solid: 1 for the upper left one, 2 for the
 * upper right one, 4
 * and 8 for those below. Squares 6 and 9, where two corners across are solid, are apart.
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
 * The lines in which an isosurface crosses a slice.
 * @param {Values} slice
 * @param {number} isovalue in the units of its values
 * @returns {number[]} x and y of both ends of each line, in voxels from the upper left corner; a
 *   voxel's middle is at a half
 */
export function contourOf({ values, width, height }, isovalue) {
  /** @type {number[]} */
  const lines = [];
  for (let y = 0; y + 1 < height; y += 1) {
    for (let x = 0; x + 1 < width; x += 1) {
      const i = y * width + x;
      const [a, b, c, d] = [values[i], values[i + 1], values[i + width], values[i + width + 1]];
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
 * Add the lines in a square; none beside a hole.
 * @param {number[]} lines
 * @param {number} x of the middle of its upper left voxel
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
 * Add where the contour meets an edge.
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
 * Both lines in a square of which two corners across are solid: as the hyperbola goes that is the
 * contour there.
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
