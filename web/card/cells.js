/** The active-cell map: which cells of a volume may hold an isosurface, and how far rays may skip from where none does.
 *
 * Bricks of 4 cells a side; of one that holds the isovalue 64 bits, of the others their Chebyshev distance to the next
 * that does. Kernel: isogi_core/kernels/tracing/active_cells.py.
 */

const BRICK = 4;

/** Marks bricks without active cells in `tops`; the bits below are their distance. */
export const EMPTY = 0x80000000;

const FARTHEST = 255; // of a distance, in bricks

/** @typedef {readonly [number, number, number]} Shape along x, y, z */
/** @typedef {Uint8Array|Uint16Array|Float32Array} Voxels x fastest, then y */

/** Bricks along x, y, z of a volume. @param {Shape} size voxels along x, y, z @returns {[number, number, number]} */
export function brickShape(size) {
  return [Math.ceil((size[0] - 1) / BRICK), Math.ceil((size[1] - 1) / BRICK), Math.ceil((size[2] - 1) / BRICK)];
}

/**
 * Least and greatest voxel of each brick's cells, which serve every isovalue; all values where some voxel has none.
 * @param {Voxels} voxels
 * @param {Shape} size voxels along x, y, z
 * @returns {{low: Float32Array, high: Float32Array}} by brick, x fastest
 */
export function findRanges(voxels, size) {
  const [nx, ny, nz] = size, [bx, by, bz] = brickShape(size);
  const low = new Float32Array(bx * by * bz).fill(Infinity), high = new Float32Array(bx * by * bz).fill(-Infinity);
  for (let z = 0; z < nz; z++) {
    for (let y = 0; y < ny; y++) {
      const row = (z * ny + y) * nx;
      forBricksOf(z, bz, (k) => forBricksOf(y, by, (j) => widenRow(voxels, row, nx, (k * by + j) * bx, low, high)));
    }
  }
  return { low, high };
}

/** The one or two bricks along an axis that a voxel belongs to. @param {number} i @param {number} count @param {(brick: number) => void} visit */
function forBricksOf(i, count, visit) {
  const brick = Math.floor(i / BRICK);
  if (brick < count) visit(brick);
  if (i % BRICK === 0 && i > 0) visit(brick - 1);
}

/**
 * Widen the ranges of a row of bricks, from `brick` on, by a row of `nx` voxels.
 * @param {Voxels} voxels @param {number} row @param {number} nx @param {number} brick @param {Float32Array} low @param {Float32Array} high
 */
function widenRow(voxels, row, nx, brick, low, high) {
  for (let first = 0; first < nx - 1; first += BRICK, brick++) {
    let least = low[brick], most = high[brick];
    for (let i = row + first, end = row + Math.min(first + BRICK, nx - 1); i <= end; i++) {
      const v = voxels[i];
      if (v < least) least = v;
      if (v > most) most = v;
      if (v !== v) [least, most] = [-Infinity, Infinity];
    }
    low[brick] = least;
    high[brick] = most;
  }
}

/**
 * The map of one isovalue.
 * @param {Voxels} voxels
 * @param {Shape} size voxels along x, y, z
 * @param {{low: Float32Array, high: Float32Array}} ranges of its bricks
 * @param {number} isovalue in the units of the voxels
 * @returns {{tops: Uint32Array, cells: Uint32Array, marked: number}} by brick, its number among marked ones, or EMPTY
 *   with its distance; and two words of each marked brick
 */
export function markCells(voxels, size, ranges, isovalue) {
  const [bx, by, bz] = brickShape(size), tops = new Uint32Array(bx * by * bz).fill(EMPTY);
  const { low, high } = ranges, found = [];
  for (let b = 0; b < tops.length; b++) if (high[b] > isovalue && low[b] <= isovalue) found.push(b);
  const cells = new Uint32Array(2 * found.length), solid = new Uint8Array((BRICK + 1) ** 3);
  let marked = 0;
  for (const b of found) {
    readBrick(voxels, size, (b % bx) * BRICK, (Math.floor(b / bx) % by) * BRICK, Math.floor(b / (bx * by)) * BRICK, isovalue, solid);
    if (markBrick(solid, cells, 2 * marked)) tops[b] = marked++;
  }
  spreadDistances(tops, [bx, by, bz]);
  return { tops, cells: cells.subarray(0, 2 * marked), marked };
}

const OUT = 1, SOLID = 2, HOLE = 4, BEYOND = 8;

/**
 * What the 5 × 5 × 5 voxels of a brick's cells are: OUT, SOLID, HOLE where there is no value, or BEYOND the volume.
 * @param {Voxels} voxels @param {Shape} size @param {number} i @param {number} j @param {number} k @param {number} isovalue @param {Uint8Array} solid
 */
function readBrick(voxels, [nx, ny, nz], i, j, k, isovalue, solid) {
  let at = 0;
  for (let z = k; z <= k + BRICK; z++) {
    for (let y = j; y <= j + BRICK; y++) {
      const row = (z * ny + y) * nx, end = z < nz && y < ny ? nx : 0;
      for (let x = i; x <= i + BRICK; x++) {
        const v = voxels[row + x];
        solid[at++] = x >= end ? BEYOND : v > isovalue ? SOLID : v <= isovalue ? OUT : HOLE;
      }
    }
  }
}

/**
 * Write the two words of a brick: a bit for each cell that has corners of two kinds, all in the volume.
 * @param {Uint8Array} solid of its voxels @param {Uint32Array} cells @param {number} place of the words @returns {boolean} whether any is set
 */
function markBrick(solid, cells, place) {
  const row = BRICK + 1, layer = row * row, words = [0, 0];
  for (let bit = 0; bit < BRICK ** 3; bit++) {
    const p = (bit & 3) + row * ((bit >> 2) & 3) + layer * (bit >> 4), q = p + layer;
    const corners = solid[p] | solid[p + 1] | solid[p + row] | solid[p + row + 1] | solid[q] | solid[q + 1] | solid[q + row] | solid[q + row + 1];
    if (corners < BEYOND && (corners & (corners - 1)) !== 0) words[bit >> 5] |= 1 << (bit & 31);
  }
  cells[place] = words[0];
  cells[place + 1] = words[1];
  return (words[0] | words[1]) !== 0;
}

/**
 * Add to the empty bricks of `tops` their Chebyshev distances to the next marked one, by a pass forwards and one back.
 * Source: Borgefors 1986, chessboard distance.
 * @param {Uint32Array} tops @param {Shape} shape bricks along x, y, z
 */
function spreadDistances(tops, [bx, by, bz]) {
  const sx = bx + 2, sy = sx * (by + 2), distance = new Uint8Array(sy * (bz + 2)).fill(FARTHEST);
  const before = [];
  for (let d = 1; d <= 13; d++) before.push(((13 - d) % 3) - 1 + (Math.floor((13 - d) / 3) % 3 - 1) * sx + (Math.floor((13 - d) / 9) - 1) * sy);
  for (const back of [false, true]) {
    for (let n = 0; n < tops.length; n++) {
      const b = back ? tops.length - 1 - n : n;
      const at = (Math.floor(b / (bx * by)) + 1) * sy + ((Math.floor(b / bx) % by) + 1) * sx + (b % bx) + 1;
      let nearest = tops[b] < EMPTY ? 0 : distance[at];
      if (nearest > 0) for (const step of before) nearest = Math.min(nearest, distance[back ? at - step : at + step] + 1);
      distance[at] = nearest;
      if (back && nearest > 0) tops[b] = EMPTY + nearest;
    }
  }
}
