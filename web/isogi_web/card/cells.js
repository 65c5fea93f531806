/**
 * The active-cell map: cells of a volume that may hold an isosurface, and distances that rays may
 * skip elsewhere.
 *
 * Cells form bricks of 4 × 4 × 4. A brick with active cells has 64 bits, one per cell; any other
 * brick has its Chebyshev distance, in bricks, to the nearest brick with active cells. Kernel:
 * isogi_core/kernels/tracing/active_cells.py.
 */

const BRICK = 4; // cells along a side of a brick: BRICK in bricks.glsl

/** Marks bricks without active cells in `tops`; the bits below hold their distance. */
export const EMPTY = 0x80000000;

const FARTHEST = 31; // largest distance that is stored, in bricks

/** @typedef {readonly [number, number, number]} Shape along x, y, z */
/** @typedef {Uint8Array|Uint16Array|Float32Array} Voxels x fastest, then y */

/**
 * Return the number of bricks of a volume along x, y, z.
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
 * Find the least and the greatest voxel of each brick, which serve every isovalue.
 *
 * Cells of neighbouring bricks share voxels, so that a voxel at a face belongs to both. A brick
 * with a NaN gets the range of all values, as its cells must be looked at.
 *
 * @param {Voxels} voxels
 * @param {Shape} size voxels along x, y, z
 * @returns {{low: Float32Array, high: Float32Array}} one entry per brick, x fastest
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
 * Call `visit` for the one or two bricks along an axis that a voxel belongs to.
 * @param {number} i index of the voxel along the axis
 * @param {number} count number of bricks along the axis
 * @param {(brick: number) => void} visit
 */
function forBricksOf(i, count, visit) {
  const brick = Math.floor(i / BRICK);
  if (brick < count) visit(brick);
  if (i % BRICK === 0 && i > 0) visit(brick - 1);
}

/**
 * Widen the ranges of a row of bricks, from number `brick` on, by the `nx` voxels from index `row`
 * on.
 * @param {Voxels} voxels
 * @param {number} row
 * @param {number} nx
 * @param {number} brick
 * @param {Float32Array} low
 * @param {Float32Array} high
 */
function widenRow(voxels, row, nx, brick, low, high) {
  for (let first = 0; first < nx - 1; first += BRICK, brick++) {
    let least = low[brick];
    let most = high[brick];
    for (let i = row + first, end = row + Math.min(first + BRICK, nx - 1); i <= end; i++) {
      const v = voxels[i];
      if (v < least) least = v;
      if (v > most) most = v;
      // Only NaN differs from itself.
      if (v !== v) [least, most] = [-Infinity, Infinity];
    }
    low[brick] = least;
    high[brick] = most;
  }
}

/**
 * Make the active-cell map of one isovalue.
 * @param {Voxels} voxels
 * @param {Shape} size voxels along x, y, z
 * @param {{low: Float32Array, high: Float32Array}} ranges as `findRanges` returns them
 * @param {number} isovalue in the units of the voxels
 * @returns {{tops: Uint32Array, cells: Uint32Array, marked: number}} `tops`, one word per brick:
 *   its number among bricks with active cells, or EMPTY plus its distance; `cells`, two words per
 *   brick with active cells; `marked`, the number of these
 */
export function markCells(voxels, size, { low, high }, isovalue) {
  const [bx, by, bz] = brickShape(size);
  const tops = new Uint32Array(bx * by * bz).fill(EMPTY);
  const found = [];
  // Bricks whose range does not hold the isovalue have no active cell: look at the others alone.
  for (let b = 0; b < tops.length; b++) if (high[b] > isovalue && low[b] <= isovalue) found.push(b);
  const cells = new Uint32Array(2 * found.length);
  const rows = new Uint32Array((BRICK + 1) ** 2);
  let marked = 0;
  for (const b of found) {
    const i = (b % bx) * BRICK;
    const j = (Math.floor(b / bx) % by) * BRICK;
    const k = Math.floor(b / (bx * by)) * BRICK;
    const first = /** @type {Shape} */ ([i, j, k]);
    // A brick whose range holds the isovalue may still have no active cell: then it counts as
    // empty.
    readBrick(voxels, size, first, isovalue, rows);
    if (markBrick(rows, lengths(size, first), cells, 2 * marked)) tops[b] = marked++;
  }
  spreadDistances(tops, [bx, by, bz]);
  return { tops, cells: cells.subarray(0, 2 * marked), marked };
}

/**
 * Return the number of cells of a brick along x, y, z that lie in the volume.
 * @param {Shape} size
 * @param {Shape} first first cell of the brick
 * @returns {number[]}
 */
function lengths(size, first) {
  return size.map((n, axis) => Math.min(n - 1 - first[axis], BRICK));
}

/**
 * Classify the 5 × 5 × 5 voxels of a brick's cells, one word per row along x.
 *
 * Bit i is set if voxel i is solid (above the isovalue), bit 8 + i if it is not, and bit 16 + i if
 * it has no value. Rows beyond the volume keep old words, which no caller reads.
 *
 * @param {Voxels} voxels
 * @param {Shape} size
 * @param {Shape} first first cell of the brick
 * @param {number} isovalue
 * @param {Uint32Array} rows output: 25 words, y fastest
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
        if (v > isovalue) word |= 1 << x;
        else if (v <= isovalue) word |= 256 << x;
        else word |= 65536 << x;
      }
      rows[(BRICK + 1) * (z - k) + y - j] = word;
    }
  }
}

/**
 * Write the two words of a brick: a bit for each cell whose corners are of two kinds or more.
 * @param {Uint32Array} rows as `readBrick` writes them
 * @param {number[]} size cells along x, y, z that lie in the volume
 * @param {Uint32Array} cells output
 * @param {number} place of the first word
 * @returns {boolean} true if any bit is set
 */
function markBrick(rows, [nx, ny, nz], cells, place) {
  let any = 0;
  for (let z = 0; z < nz; z++) {
    for (let y = 0; y < ny; y++) {
      const r = (BRICK + 1) * z + y;
      // Join the four rows that bound a row of cells; a shift by one then joins the two corners
      // along x, for all cells at once.
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

const WORD = 32; // bricks along x whose bits share a word

/**
 * Write the Chebyshev distance of each empty brick to the nearest marked one into `tops`.
 *
 * Marks, one bit per brick, grow by one brick on all sides per step, 32 bricks at a time. A brick
 * that is first reached in step n has distance n.
 *
 * @param {Uint32Array} tops
 * @param {Shape} shape bricks along x, y, z
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
    // A cube grows along one axis at a time.
    growAlongX(reached, words, next);
    growAlong(next, words, words * by, wider);
    growAlong(wider, words * by, count, next);
    for (let w = 0; w < count; w++) {
      const first = Math.floor(w / words) * bx + (w % words) * WORD;
      const end = Math.min(WORD, bx - (w % words) * WORD);
      // Visit the bits that are new in this step, lowest first.
      for (let fresh = next[w] & ~reached[w]; fresh !== 0; fresh &= fresh - 1) {
        const bit = 31 - Math.clz32(fresh & -fresh);
        if (bit < end) tops[first + bit] = EMPTY + n;
      }
    }
    [reached, next] = [next, reached];
  }
  // Bricks that were never reached are at least FARTHEST away.
  for (let b = 0; b < tops.length; b++) if (tops[b] === EMPTY) tops[b] = EMPTY + FARTHEST;
}

/**
 * Spread bits to their neighbours along x, across words of the same row.
 * @param {Uint32Array} bits rows of bits
 * @param {number} words number of words in a row
 * @param {Uint32Array} grown output
 */
function growAlongX(bits, words, grown) {
  for (let w = 0; w < bits.length; w++) {
    const left = w % words > 0 ? bits[w - 1] >>> 31 : 0;
    const right = w % words < words - 1 ? bits[w + 1] << 31 : 0;
    grown[w] = bits[w] | (bits[w] << 1) | (bits[w] >>> 1) | left | right;
  }
}

/**
 * Spread bits to words `step` before and behind, within each group of `period` words.
 * @param {Uint32Array} bits
 * @param {number} step
 * @param {number} period
 * @param {Uint32Array} grown output
 */
function growAlong(bits, step, period, grown) {
  for (let w = 0; w < bits.length; w++) {
    const at = w % period;
    const before = at >= step ? bits[w - step] : 0;
    const behind = at < period - step ? bits[w + step] : 0;
    grown[w] = bits[w] | before | behind;
  }
}
