/**
 * The texels of a scene on the card: the records that the server sent, and the table that finds
 * them.
 *
 * Three groups of textures hold them:
 *
 * - `bricks`, RGBA32UI, one entry per brick of 4 × 4 × 4 texels: two words whose 64 bits tell which
 *   texels of the brick are present; the number of the brick's first record; and the distance, in
 *   bricks, to the brick whose mean stands in if this one has no texels.
 * - `records`, RGBA32UI, ROW records in a row, as the server sends them. Records of one answer
 *   begin at the start of a row and form a *run*, so that all records of a run have one light.
 * - `transfer`, layers of RGBA16F: raw transfer, at the same places as the records.
 *
 * Textures that become too small are allocated again, larger, with all runs. If a card has too few
 * rows for all texels, the oldest are dropped first.
 */

import { ones, readBlocks } from "./blocks.js";
import { Refusal } from "./device.js";
import { bytesOf, fillTexture, makeTexture } from "./textures.js";

/** @typedef {import("./blocks.js").Block} Block */
/** @typedef {import("./document.js").CardDocument} CardDocument */
/** @typedef {import("./textures.js").Texture} Texture */
/** @typedef {{records: Texture, noise: Texture}} Folded */
/**
 * @typedef {{blocks: Block[], row: number, rows: number, lightKey: string, quadric: number[], raw:
 *   Map<string, Block>}} Run
 */

const ROW = 2048; // records in a row: ROW in bricks.glsl
const BRICK = 4; // texels along a side of a brick: BRICK in bricks.glsl
const NONE = 0xffffffff; // number of no record: NONE in irradiance_ratio.glsl
const NOWHERE = 255; // distance of a brick that no mean stands in for: larger than REACH

/** Distance within which the mean of a brick stands in for bricks without texels, in bricks. */
const REACH = 4;

/** Bytes that `bricks` may take: small cards have little memory for it. */
const MOST_BRICKS = 256 << 20;

/** Rows that are allocated over rows in use, so that textures grow only after several answers. */
const SPARE = 1.5;

/** Texels of a scene on a card: keeps the server's answers, and lays them out in textures. */
export class Texels {
  /**
   * @param {import("./device.js").Device} device
   * @param {CardDocument} document
   * @param {number} budget bytes for raw transfer
   * @param {Run[]} [runs] texels that were received before the card was lost
   * @throws {Refusal} if the scene has more bricks than a card takes
   */
  constructor(
    { gl, most2d, most3d, layers },
    { lattice, plan, surfaces },
    budget,
    runs = /** @type {Run[]} */ ([]),
  ) {
    this.gl = gl;
    this.most = most2d;
    this.lattice = lattice;
    this.numbers = plan.channels * plan.columns;
    // Two more numbers follow the transfer of a texel: logarithms of its scatter and of its
    // samples.
    this.layers = Math.ceil((this.numbers + 2) / 4);
    this.budget = this.layers <= layers ? budget : 0;
    this.wantsRaw = plan.turns || runs.some(({ raw }) => raw.size > 0);
    // Sides of several surfaces lie one behind the other along z, in whole chunks each.
    const [x, y, z] = lattice.size.map((n) => Math.ceil(n / BRICK));
    const whole = (Math.ceil(lattice.size[2] / lattice.chunk) * lattice.chunk) / BRICK;
    /** Bricks of a side along z. */
    this.deep = surfaces ? whole : z;
    this.shape = [x, y, this.deep * (surfaces ? 2 * surfaces.length : 1)];
    if (this.shape[2] > most3d)
      throw new Refusal("The light of all surfaces is too deep for this card: the server draws.");
    if (bytesOf("RGBA32UI", this.shape) > MOST_BRICKS)
      throw new Refusal(
        `The light of this scene has an index of more than ${MOST_BRICKS >> 20} MB: the server draws.`,
      );
    /** Layers of the table along z that the card does not have yet: 1, or 0 if it has them. */
    this.changed = new Uint8Array(this.shape[2]);
    this.table = new Uint32Array(4 * this.shape[0] * this.shape[1] * this.shape[2]);
    this.bricks = makeTexture(gl, "RGBA32UI", this.shape);
    this.records = makeTexture(gl, "RGBA32UI", [ROW, 1]);
    this.places = makeTexture(gl, "R32UI", [ROW, 1]);
    this.turned = [foldedTextures(gl, 1), foldedTextures(gl, 1)];
    this.transfer = makeTexture(gl, "RGBA16F", [ROW, 1, 1], { layered: true });
    this.takesRaw = false;
    this.rows = 0;
    this.runs = runs;
    this.#layOut();
  }

  /** Return all textures of the texels, to delete them. @returns {Texture[]} */
  get textures() {
    return [this.bricks, ...this.#ofRows];
  }

  /**
   * Return the textures whose height follows from the number of rows of records.
   * @returns {Texture[]}
   */
  get #ofRows() {
    return [
      this.records,
      this.places,
      ...this.turned.flatMap(({ records, noise }) => [records, noise]),
      this.transfer,
    ];
  }

  /** Return true if some light that is folded here needs the noise filter. @returns {boolean} */
  get grainy() {
    return (
      this.takesRaw &&
      this.runs.some((run) => isRaw(run) && [...run.raw.values()].some(({ grainy }) => grainy))
    );
  }

  /** Return true if some bricks have a mean, and no texels. @returns {boolean} */
  get coarse() {
    return this.runs.some(({ blocks }) => blocks.some(isCoarse));
  }

  /**
   * Return the version of each chunk on the card, the turn of its light, and true in `raw` if its
   * raw transfer is here.
   * @returns {Map<string, {version: string, lightKey: string, raw: boolean}>}
   */
  get chunks() {
    const entries = this.runs.flatMap(({ blocks, lightKey, raw }) =>
      blocks.map(
        (block) =>
          /** @type {const} */ ([
            block.at,
            { version: block.version, lightKey, raw: raw.has(block.at) },
          ]),
      ),
    );
    return new Map(entries);
  }

  /**
   * Take an answer of the server: folded light, or raw transfer of texels whose folded light is
   * here.
   * @param {ArrayBuffer} answer
   * @param {string} lightKey names the turn of the light that it was folded with
   * @param {number[]} quadric unshadowed light of that turn: see `quadricOf`
   * @throws {Error} if the answer is damaged, or if the card has too few rows for it
   */
  take(answer, lightKey, quadric) {
    this.put(readBlocks(answer), lightKey, quadric);
  }

  /**
   * Put blocks on the card: folded light first, then raw transfer of texels whose folded light is
   * here.
   * @param {Block[]} blocks
   * @param {string} lightKey
   * @param {number[]} quadric
   * @throws {Error} if the card has too few rows for them
   */
  put(blocks, lightKey, quadric) {
    const folded = blocks.filter((block) => !block.raw);
    // Allocate layers for raw transfer only when the first raw block arrives: many scenes need
    // none.
    if (folded.length < blocks.length && !this.wantsRaw) {
      this.wantsRaw = true;
      this.#layOut();
    }
    if (folded.length) this.#append(folded, lightKey, quadric);
    for (const block of blocks) if (block.raw) this.#addRaw(block);
  }

  /**
   * Add a run of folded blocks; they replace older blocks of the same chunks.
   * @param {Block[]} blocks
   * @param {string} lightKey
   * @param {number[]} quadric
   */
  #append(blocks, lightKey, quadric) {
    // A chunk has one block: drop older versions, so that the table never points at stale records.
    const fresh = new Set(blocks.map((block) => block.at));
    for (const run of this.runs) {
      run.blocks = run.blocks.filter((block) => !fresh.has(block.at));
      for (const at of fresh) run.raw.delete(at);
    }
    const run = {
      blocks,
      row: this.rows,
      rows: neededRows(blocks),
      lightKey,
      quadric,
      raw: new Map(),
    };
    this.runs = [...this.runs.filter((each) => each.blocks.length), run];
    // Write the new run behind the others if it fits; else allocate larger textures for all runs.
    if (this.rows + run.rows > this.records.size[1]) this.#layOut();
    else this.#place(run);
    this.#uploadTable();
  }

  /**
   * Allocate textures for all runs, and write them: older versions of chunks give their rows back.
   * Runs of the same light are joined.
   * @throws {Error} if the newest run alone has more rows than the card's textures
   */
  #layOut() {
    this.runs = joinedRuns(youngest(this.runs, this.most));
    const { gl } = this;
    const rows = this.runs.reduce((sum, run) => sum + neededRows(run.blocks), 0);
    // Allocate some spare rows; 16 keeps small scenes from growing at each answer.
    const height = Math.min(Math.ceil(SPARE * rows) + 16, this.most);
    if (rows > height) throw new Error("The graphics card has no room for more texels.");
    for (const old of this.#ofRows) gl.deleteTexture(old.id);
    this.records = makeTexture(gl, "RGBA32UI", [ROW, height]);
    const size = [ROW, height, this.layers];
    // Keep raw transfer only if all of its layers fit the budget; else the server folds each light.
    this.takesRaw = this.wantsRaw && bytesOf("RGBA16F", size) <= this.budget;
    this.transfer = makeTexture(gl, "RGBA16F", this.takesRaw ? size : [ROW, 1, 1], {
      layered: true,
    });
    this.places = makeTexture(gl, "R32UI", [ROW, this.takesRaw ? height : 1]);
    this.turned = [foldedTextures(gl, height), foldedTextures(gl, this.takesRaw ? height : 1)];

    // Reset the table to empty bricks, then write every run.
    this.rows = 0;
    for (let b = 0; b < this.table.length; b += 4) this.table.set([0, 0, NONE, NOWHERE], b);
    this.changed.fill(1);
    for (const run of this.runs) this.#place(run);
    this.#uploadTable();
  }

  /** Write a run behind the rows in use, and list its bricks in the table. @param {Run} run */
  #place(run) {
    run.row = this.rows;
    run.rows = neededRows(run.blocks);
    const words = new Uint32Array(4 * ROW * run.rows);
    const places = new Uint32Array(ROW * run.rows).fill(NONE);
    let first = 0;
    // Pack the records of all blocks side by side; `places` maps each record back to its texel.
    for (const block of run.blocks) {
      block.first = first;
      words.set(block.records, 4 * first);
      this.#list(block, run.row * ROW + first, places.subarray(first));
      first += block.count;
    }
    if (run.rows) fillTexture(this.gl, this.records, words, [0, run.row], [ROW, run.rows]);
    if (run.rows && this.takesRaw)
      fillTexture(this.gl, this.places, places, [0, run.row], [ROW, run.rows]);
    this.rows += run.rows;
    this.#fillRaw(run);
  }

  /**
   * Enter a block's bricks into the table, and let their means stand in for nearby bricks without
   * texels.
   * @param {Block} block
   * @param {number} first number of the block's first record
   * @param {Uint32Array} places output: brick and bit of each of the block's records; means get
   *   none
   */
  #list(block, first, places) {
    const side = this.lattice.chunk / BRICK;
    for (let i = 0; i < block.bricks.length; i += 4) {
      const [low, high, local, place] = block.bricks.subarray(i, i + 4);
      // A place packs the brick's x, y, z in its chunk, 8 bits each.
      const at = [place & 255, (place >> 8) & 255, (place >> 16) & 255].map(
        (x, axis) => block.index[axis] * side + x,
      );
      const number = this.#number(at);
      this.table.set([low, high, first + local, 0], 4 * number);
      bitsOf(low, high).forEach((bit, k) => {
        // The number of the brick, then six bits: the texel in it. filter.frag.glsl reads this.
        places[local + k] = (number << 6) | bit;
      });
      // The record of the brick's mean follows those of its texels.
      this.#spreadMean(at, first + local + ones(low) + ones(high));
    }
  }

  /**
   * Let the mean of a brick, record number `mean`, stand in for bricks around it that have no
   * nearer mean.
   * @param {number[]} at x, y, z of the brick
   * @param {number} mean number of the record
   */
  #spreadMean([x, y, z], mean) {
    const [bx, by] = this.shape;
    // A mean stands in for bricks of its side alone.
    const side = z - (z % this.deep);
    const first = Math.max(z - REACH, side);
    const last = Math.min(z + REACH, side + this.deep - 1);
    this.changed.fill(1, first, last + 1);
    for (let k = first; k <= last; k++) {
      for (let j = Math.max(y - REACH, 0); j <= Math.min(y + REACH, by - 1); j++) {
        for (let i = Math.max(x - REACH, 0); i <= Math.min(x + REACH, bx - 1); i++) {
          const away = Math.max(Math.abs(i - x), Math.abs(j - y), Math.abs(k - z));
          const b = 4 * this.#number([i, j, k]);
          // Bricks with texels have distance 0, and keep their entry.
          if (away === 0 || away > this.table[b + 3]) continue;
          this.table[b + 2] = mean;
          this.table[b + 3] = away;
        }
      }
    }
  }

  /**
   * Return the number of a brick in the table, x fastest.
   * @param {number[]} at x, y, z
   * @returns {number}
   */
  #number([x, y, z]) {
    return (z * this.shape[1] + y) * this.shape[0] + x;
  }

  /** Upload the layers of the table that changed, those side by side together. */
  #uploadTable() {
    const [x, y, z] = this.shape;
    const layer = 4 * x * y;
    for (let from = this.changed.indexOf(1); from >= 0; from = this.changed.indexOf(1, from)) {
      const end = this.changed.indexOf(0, from);
      const to = end < 0 ? z : end;
      const part = this.table.subarray(layer * from, layer * to);
      fillTexture(this.gl, this.bricks, part, [0, 0, from], [x, y, to - from]);
      this.changed.fill(0, from, to);
    }
  }

  /**
   * Keep the raw transfer of a chunk whose folded light is here, and upload its run once the run is
   * complete.
   * @param {Block} block
   */
  #addRaw(block) {
    // Transfer must belong to the same version as the folded light: their records lie side by side.
    const run = this.runs.find(({ blocks }) =>
      blocks.some(
        (each) =>
          each.at === block.at && each.version === block.version && each.count === block.count,
      ),
    );
    if (!run || !this.takesRaw) return;
    run.raw.set(block.at, { ...block, grainy: this.#isGrainy(block) });
    this.#fillRaw(run);
  }

  /**
   * Return true if a texel of raw transfer has a positive number of samples: its light needs the
   * noise filter.
   * @param {Block} block
   * @returns {boolean}
   */
  #isGrainy({ layers, count }) {
    // The last number of each texel is the logarithm of its samples, a half; the sign bit marks
    // texels that need no filter.
    const last = this.numbers + 1;
    const first = 4 * count * (last >> 2) + (last & 3);
    for (let at = first; at < layers.length; at += 4)
      if (layers[at] > 0 && layers[at] < 0x8000) return true;
    return false;
  }

  /**
   * Upload the raw transfer of a run, layer by layer, if all of its chunks have it.
   * @param {Run} run
   */
  #fillRaw(run) {
    if (!this.takesRaw || !isRaw(run) || !run.rows) return;
    for (let layer = 0; layer < this.layers; layer++) {
      const halves = new Uint16Array(4 * ROW * run.rows);
      for (const { at, count, first } of run.blocks) {
        const source = /** @type {Block} */ (run.raw.get(at)).layers;
        halves.set(source.subarray(4 * count * layer, 4 * count * (layer + 1)), 4 * first);
      }
      fillTexture(this.gl, this.transfer, halves, [0, run.row, layer], [ROW, run.rows, 1]);
    }
  }
}

/**
 * Make textures for light that is folded on the card: records, and the noise of each.
 * @param {WebGL2RenderingContext} gl
 * @param {number} height rows
 * @returns {Folded}
 */
function foldedTextures(gl, height) {
  return {
    records: makeTexture(gl, "RGBA32UI", [ROW, height]),
    noise: makeTexture(gl, "R32UI", [ROW, height]),
  };
}

/**
 * Return the bits that are set in two words, in ascending order, 0 to 63.
 * @param {number} low
 * @param {number} high
 * @returns {number[]}
 */
function bitsOf(low, high) {
  return Array.from({ length: 64 }, (_, bit) => bit).filter(
    (bit) => ((bit < 32 ? low : high) >>> (bit & 31)) & 1,
  );
}

/**
 * Return true if a block has means of bricks alone: then its first brick has no texels.
 * @param {Block} block
 * @returns {boolean}
 */
function isCoarse({ bricks: [low, high] }) {
  return low === 0 && high === 0;
}

/**
 * Return true if raw transfer of all chunks of a run is here.
 * @param {Run} run
 * @returns {boolean}
 */
export function isRaw(run) {
  return run.blocks.every((block) => run.raw.has(block.at));
}

/**
 * Join runs that have the same light, and either all have raw transfer or lack some of it.
 * @param {Run[]} runs
 * @returns {Run[]}
 */
function joinedRuns(runs) {
  const groups = new Map();
  for (const run of runs) {
    const key = `${isRaw(run)} ${run.lightKey}`;
    const { blocks = [], raw = new Map() } = groups.get(key) ?? {};
    groups.set(key, {
      ...run,
      blocks: [...blocks, ...run.blocks],
      raw: new Map([...raw, ...run.raw]),
    });
  }
  return [...groups.values()];
}

/**
 * Drop the oldest blocks until the rest fits `most` rows; the newest run stays complete.
 * @param {Run[]} runs
 * @param {number} most rows
 * @returns {Run[]}
 */
function youngest(runs, most) {
  let over = runs.reduce((sum, { blocks }) => sum + neededRows(blocks), 0) - most;
  const kept = runs.map((run, n) => {
    const before = neededRows(run.blocks);
    const blocks = [...run.blocks];
    // Drop an eighth of the run at a time: rows are rounded up, so that single blocks may free
    // none.
    while (n < runs.length - 1 && blocks.length && before - neededRows(blocks) < over)
      blocks.splice(0, Math.ceil(blocks.length / 8));
    over -= before - neededRows(blocks);
    return { ...run, blocks };
  });
  return kept.filter(({ blocks }) => blocks.length);
}

/**
 * Return the number of rows that the records of some blocks take.
 * @param {Block[]} blocks
 * @returns {number}
 */
function neededRows(blocks) {
  return Math.ceil(blocks.reduce((sum, block) => sum + block.count, 0) / ROW);
}
