/** The active-cell map: which cells of a volume may hold an isosurface, and how far rays may skip from where none does.
 *
 * Bricks of 4 cells a side; of one that holds the isovalue 64 bits, of the others their Chebyshev
 * distance to the next
 * that does. Kernel: isogi_core/kernels/tracing/active_cells.py.
 */

const BRICK = 4;

/** Marks bricks without active cells in `tops`; the bits below are their distance. */
export const EMPTY = 0x80000000;

const FARTHEST = 31; // of a distance, in bricks

/** @typedef {readonly [number, number, number]} Shape along x, y, z */
/** @typedef {Uint8Array|Uint16Array|Float32Array} Voxels x fastest, then y */

/**
 * Bricks along x, y, z of a volume.
 * @param {Shape} size voxels along x, y, z
 * @returns {[number, number, number]}
 */
export function brickShape(size) {
  return [
    Math.ceil((size[0] - 1) / BRICK),
    Math.ceil((size[1] - 1) / BRICK),
    Math.ceil((size[2] - 1) / BRICK),
  ];
}

/**
 * Least and greatest voxel of each brick's cells, which serve every isovalue; all values where some
 * voxel has none.
 * @param {Voxels} voxels
 * @param {Shape} size voxels along x, y, z
 * @returns {{low: Float32Array, high: Float32Array}} by brick, x fastest
 */
export function findRanges(voxels, size) {
  const [nx, ny, nz] = size;
  const [bx, by, bz] = brickShape(size);
  const low = new Float32Array(bx * by * bz).fill(Infinity);
  const high = new Float32Array(bx * by * bz).fill(-Infinity);
  for (let z = 0; z < nz; z++) {
    for (let y = 0; y < ny; y++) {
      const row = (z * ny + y) * nx;
      forBricksOf(z, bz, (k) =>
        forBricksOf(y, by, (j) => widenRow(voxels, row, nx, (k * by + j) * bx, low, high)),
      );
    }
  }
  return { low, high };
}

/**
 * The one or two bricks along an axis that a voxel belongs to.
 * @param {number} i
 * @param {number} count
 * @param {(brick: number) => void} visit
 */
function forBricksOf(i, count, visit) {
  const brick = Math.floor(i / BRICK);
  if (brick < count) visit(brick);
  if (i % BRICK === 0 && i > 0) visit(brick - 1);
}

/**
 * Widen the ranges of a row of bricks, from `brick` on, by a row of `nx` voxels.
 * @param {Voxels} voxels @param {number} row @param {number} nx @param {number} brick @param
 *   {Float32Array} low @param {Float32Array} high
 */
function widenRow(voxels, row, nx, brick, low, high) {
  for (let first = 0; first < nx - 1; first += BRICK, brick++) {
    let least = low[brick];
    let most = high[brick];
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
 * @returns {{tops: Uint32Array, cells: Uint32Array, marked: number}} by brick, its number among
 *   marked ones, or EMPTY
 *   with its distance; and two words of each marked brick
 */
export function markCells(voxels, size, { low, high }, isovalue) {
  const [bx, by, bz] = brickShape(size);
  const tops = new Uint32Array(bx * by * bz).fill(EMPTY);
  const found = [];
  for (let b = 0; b < tops.length; b++) if (high[b] > isovalue && low[b] <= isovalue) found.push(b);
  const cells = new Uint32Array(2 * found.length);
  const rows = new Uint32Array((BRICK + 1) ** 2);
  let marked = 0;
  for (const b of found) {
    const i = (b % bx) * BRICK;
    const j = (Math.floor(b / bx) % by) * BRICK;
    const k = Math.floor(b / (bx * by)) * BRICK;
    const first = /** @type {Shape} */ ([i, j, k]);
    readBrick(voxels, size, first, isovalue, rows);
    if (markBrick(rows, lengths(size, first), cells, 2 * marked)) tops[b] = marked++;
  }
  spreadDistances(tops, [bx, by, bz]);
  return { tops, cells: cells.subarray(0, 2 * marked), marked };
}

/**
 * Cells of a brick, along x, y, z, that are in the volume.
 * @param {Shape} size
 * @param {Shape} first cell
 * @returns {number[]}
 */
function lengths(size, first) {
  return size.map((n, axis) => Math.min(n - 1 - first[axis], BRICK));
}

/**
 * What the 5 × 5 × 5 voxels of a brick's cells are, a word for each row along x: bit i where voxel
 * i is solid, bit 8 + i
 * where it is not, and bit 16 + i where it has no value. What lies beyond the volume is never asked
 * for.
 * @param {Voxels} voxels @param {Shape} size @param {Shape} first cell @param {number} isovalue
 *   @param {Uint32Array} rows
 */
function readBrick(voxels, [nx, ny, nz], [i, j, k], isovalue, rows) {
  const count = Math.min(BRICK + 1, nx - i);
  const yEnd = Math.min(j + BRICK, ny - 1);
  const zEnd = Math.min(k + BRICK, nz - 1);
  for (let z = k; z <= zEnd; z++) {
    for (let y = j; y <= yEnd; y++) {
      const at = (z * ny + y) * nx + i;
      let word = 0;
      for (let x = 0; x < count; x++) {
        const v = voxels[at + x];
        word |= v > isovalue ? 1 << x : v <= isovalue ? 256 << x : 65536 << x;
      }
      rows[(BRICK + 1) * (z - k) + y - j] = word;
    }
  }
}

/**
 * Write the two words of a brick: a bit for each cell that has corners of two kinds.
 * @param {Uint32Array} rows of its voxels @param {number[]} size cells in the volume @param
 *   {Uint32Array} cells @param {number} place
 * @returns {boolean} whether any is set
 */
function markBrick(rows, [nx, ny, nz], cells, place) {
  let any = 0;
  for (let z = 0; z < nz; z++) {
    for (let y = 0; y < ny; y++) {
      const r = (BRICK + 1) * z + y;
      const four = rows[r] | rows[r + 1] | rows[r + BRICK + 1] | rows[r + BRICK + 2];
      const pairs = four | (four >> 1);
      const solid = pairs;
      const out = pairs >> 8;
      const hole = pairs >> 16;
      const mixed = ((solid & out) | (solid & hole) | (out & hole)) & ((1 << nx) - 1);
      cells[place + (z >> 1)] |= mixed << (BRICK * y + 16 * (z & 1));
      any |= mixed;
    }
  }
  return any !== 0;
}

const WORD = 32; // bricks along x whose bits are in one word

/**
 * Add to the empty bricks of `tops` their Chebyshev distances to the next marked one: marks grow by
 * a brick on all sides,
 * 32 bricks at once, and whom they reach first in step n is n away.
 * @param {Uint32Array} tops @param {Shape} shape bricks along x, y, z
 */
function spreadDistances(tops, [bx, by, bz]) {
  const words = Math.ceil(bx / WORD);
  const count = words * by * bz;
  const wider = new Uint32Array(count);
  let reached = new Uint32Array(count);
  let next = new Uint32Array(count);
  for (let b = 0; b < tops.length; b++)
    if (tops[b] < EMPTY) reached[Math.floor(b / bx) * words + ((b % bx) >> 5)] |= 1 << (b % bx);
  for (let n = 1; n <= FARTHEST; n++) {
    growAlongX(reached, words, next);
    growAlong(next, words, words * by, wider);
    growAlong(wider, words * by, count, next);
    for (let w = 0; w < count; w++) {
      const first = Math.floor(w / words) * bx + (w % words) * WORD;
      const end = Math.min(WORD, bx - (w % words) * WORD);
      for (let news = next[w] & ~reached[w]; news !== 0; news &= news - 1) {
        const bit = 31 - Math.clz32(news & -news);
        if (bit < end) tops[first + bit] = EMPTY + n;
      }
    }
    [reached, next] = [next, reached];
  }
  for (let b = 0; b < tops.length; b++) if (tops[b] === EMPTY) tops[b] = EMPTY + FARTHEST;
}

/**
 * Bits of rows of so many words, and those beside them.
 * @param {Uint32Array} bits
 * @param {number} words
 * @param {Uint32Array} grown
 */
function growAlongX(bits, words, grown) {
  for (let w = 0; w < bits.length; w++) {
    const left = w % words > 0 ? bits[w - 1] >>> 31 : 0;
    const right = w % words < words - 1 ? bits[w + 1] << 31 : 0;
    grown[w] = bits[w] | (bits[w] << 1) | (bits[w] >>> 1) | left | right;
  }
}

/**
 * Bits, and those `step` words before and behind, within every `period` words.
 * @param {Uint32Array} bits
 * @param {number} step
 * @param {number} period
 * @param {Uint32Array} grown
 */
function growAlong(bits, step, period, grown) {
  for (let w = 0; w < bits.length; w++) {
    const at = w % period;
    const before = at >= step ? bits[w - step] : 0;
    const behind = at < period - step ? bits[w + step] : 0;
    grown[w] = bits[w] | before | behind;
  }
}
