/** The texels on the card: which there are, and what each shows.
 *
 * A table of bricks, RGBA32UI: two words which of 64 texels are there, the number of the first
 * record, and how far away
 * the brick is, in bricks, whose mean stands in where there are none. Records, ROW in a row of
 * RGBA32UI, as the server
 * sends them; those of one answer begin a row of their own, a *run*, so that each run has one
 * light. Raw transfer lies at
 * the same places in the layers of an array. What grows too large is laid out once more; what a
 * card has no rows for goes,
 * the oldest first.
 */

import { ones, readBlocks } from "./blocks.js";
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
const BRICK = 4;
const NONE = 0xffffffff;
const NOWHERE = 255;

/** How far bricks without texels look for one whose mean they show, in bricks. */
const REACH = 4;

/** Share of rows by which a texture is larger than it must be, so that it need not grow at once. */
const SPARE = 1.5;

/** Texels of a scene on a card. */
export class Texels {
  /**
   * @param {import("./device.js").Device} device
   * @param {CardDocument} document
   * @param {number} budget bytes for raw transfer
   * @param {Run[]} [runs] what was taken before the card was lost
   */
  constructor({ gl, most2d, layers }, { lattice, plan }, budget, runs = /** @type {Run[]} */ ([])) {
    this.gl = gl;
    this.most = most2d;
    this.lattice = lattice;
    this.numbers = plan.channels * plan.columns;
    this.layers = Math.ceil((this.numbers + 2) / 4);
    this.budget = this.layers <= layers ? budget : 0;
    this.wantsRaw = plan.turns || runs.some(({ raw }) => raw.size > 0);
    this.shape = lattice.size.map((n) => Math.ceil(n / BRICK));
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

  /** All of its textures. @returns {Texture[]} */
  get textures() {
    return [this.bricks, ...this.#ofRows];
  }

  /** Textures of a size that follows from the rows of records. @returns {Texture[]} */
  get #ofRows() {
    return [
      this.records,
      this.places,
      ...this.turned.flatMap(({ records, noise }) => [records, noise]),
      this.transfer,
    ];
  }

  /** Whether light of any run, folded here, is to be filtered for its noise. */
  get grainy() {
    return (
      this.takesRaw &&
      this.runs.some((run) => isRaw(run) && [...run.raw.values()].some(({ grainy }) => grainy))
    );
  }

  /**
   * Versions of the chunks that are here, and whether with raw transfer.
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
   * Take an answer of folded light, or of raw transfer of texels whose folded light is here.
   * @param {ArrayBuffer} answer
   * @param {string} lightKey names the turn of the light that it was folded by
   * @param {number[]} quadric of that light
   * @param {readonly number[]} [steps] of codes, where it is transfer in few bits
   */
  take(answer, lightKey, quadric, steps) {
    const blocks = readBlocks(answer, steps);
    const folded = blocks.filter((block) => !block.raw);
    if (folded.length < blocks.length && !this.wantsRaw) {
      this.wantsRaw = true;
      this.#layOut();
    }
    if (folded.length) this.#append(folded, lightKey, quadric);
    for (const block of blocks) if (block.raw) this.#addRaw(block);
  }

  /** @param {Block[]} blocks @param {string} lightKey @param {number[]} quadric */
  #append(blocks, lightKey, quadric) {
    const fresh = new Set(blocks.map((block) => block.at));
    for (const run of this.runs) run.blocks = run.blocks.filter((block) => !fresh.has(block.at));
    const run = {
      blocks,
      row: this.rows,
      rows: neededRows(blocks),
      lightKey,
      quadric,
      raw: new Map(),
    };
    this.runs = [...this.runs.filter((each) => each.blocks.length), run];
    if (this.rows + run.rows > this.records.size[1]) this.#layOut();
    else this.#place(run);
    this.#finish();
  }

  /**
   * Lay all runs out in textures of their size, one for each light: what chunks had before goes.
   */
  #layOut() {
    this.runs = joinedRuns(youngest(this.runs, this.most));
    const { gl } = this;
    const rows = this.runs.reduce((sum, run) => sum + neededRows(run.blocks), 0);
    for (const old of this.#ofRows) gl.deleteTexture(old.id);
    const height = Math.min(Math.ceil(SPARE * rows) + 16, this.most);
    if (rows > height) throw new Error("The graphics card takes no more texels.");
    this.records = makeTexture(gl, "RGBA32UI", [ROW, height]);
    const size = [ROW, height, this.layers];
    this.takesRaw = this.wantsRaw && bytesOf("RGBA16F", size) <= this.budget;
    this.transfer = makeTexture(gl, "RGBA16F", this.takesRaw ? size : [ROW, 1, 1], {
      layered: true,
    });
    this.places = makeTexture(gl, "R32UI", [ROW, this.takesRaw ? height : 1]);
    this.turned = [foldedTextures(gl, height), foldedTextures(gl, this.takesRaw ? height : 1)];
    this.rows = 0;
    for (let b = 0; b < this.table.length; b += 4) this.table.set([0, 0, NONE, NOWHERE], b);
    for (const run of this.runs) this.#place(run);
    this.#finish();
  }

  /** Put a run at the end of what is used. @param {Run} run */
  #place(run) {
    run.row = this.rows;
    run.rows = neededRows(run.blocks);
    const words = new Uint32Array(4 * ROW * run.rows);
    const places = new Uint32Array(ROW * run.rows).fill(NONE);
    let first = 0;
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
   * Enter a block's bricks into the table, whose records begin at `first`, and lend means to bricks
   * without texels.
   * @param {Block} block
   * @param {number} first
   * @param {Uint32Array} places of its records in the lattice, to be filled
   */
  #list(block, first, places) {
    const side = this.lattice.chunk / BRICK;
    for (let i = 0; i < block.bricks.length; i += 4) {
      const [low, high, own, place] = block.bricks.subarray(i, i + 4);
      const at = [place & 255, (place >> 8) & 255, (place >> 16) & 255].map(
        (x, axis) => block.index[axis] * side + x,
      );
      const number = this.#number(at);
      this.table.set([low, high, first + own, 0], 4 * number);
      bitsOf(low, high).forEach((bit, k) => {
        places[own + k] = (number << 6) | bit;
      });
      this.#lend(at, first + own + ones(low) + ones(high));
    }
  }

  /**
   * Lend the mean of the brick at a place, record number `mean`, to bricks about it that have no
   * nearer one.
   * @param {number[]} at
   * @param {number} mean
   */
  #lend([x, y, z], mean) {
    const [bx, by, bz] = this.shape;
    for (let k = Math.max(z - REACH, 0); k <= Math.min(z + REACH, bz - 1); k++) {
      for (let j = Math.max(y - REACH, 0); j <= Math.min(y + REACH, by - 1); j++) {
        for (let i = Math.max(x - REACH, 0); i <= Math.min(x + REACH, bx - 1); i++) {
          const away = Math.max(Math.abs(i - x), Math.abs(j - y), Math.abs(k - z));
          const b = 4 * this.#number([i, j, k]);
          if (away === 0 || away > this.table[b + 3]) continue;
          this.table[b + 2] = mean;
          this.table[b + 3] = away;
        }
      }
    }
  }

  /** @param {number[]} at x, y, z @returns {number} */
  #number([x, y, z]) {
    return (z * this.shape[1] + y) * this.shape[0] + x;
  }

  /** Have the card know what the table says. */
  #finish() {
    fillTexture(this.gl, this.bricks, this.table);
  }

  /**
   * Keep the raw transfer of a chunk whose folded light is here, and hand all of a run on once it
   * is whole.
   * @param {Block} block
   */
  #addRaw(block) {
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
   * Whether any texel of raw transfer has samples that are not negative: its light is grainy.
   * @param {Block} block
   */
  #isGrainy({ layers, count }) {
    const last = this.numbers + 1;
    const first = 4 * count * (last >> 2) + (last & 3);
    for (let at = first; at < layers.length; at += 4)
      if (layers[at] > 0 && layers[at] < 0x8000) return true;
    return false;
  }

  /** Fill the layers of a run, if there is raw transfer of all of it. @param {Run} run */
  #fillRaw(run) {
    if (!this.takesRaw || !isRaw(run) || !run.rows) return;
    for (let layer = 0; layer < this.layers; layer++) {
      const halves = new Uint16Array(4 * ROW * run.rows);
      for (const { at, count, first } of run.blocks) {
        const own = /** @type {Block} */ (run.raw.get(at)).layers;
        halves.set(own.subarray(4 * count * layer, 4 * count * (layer + 1)), 4 * first);
      }
      fillTexture(this.gl, this.transfer, halves, [0, run.row, layer], [ROW, run.rows, 1]);
    }
  }
}

/**
 * Textures of folded light: records, and the noise of each.
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
 * The bits that are set in two words, ascending.
 * @param {number} low
 * @param {number} high
 * @returns {number[]}
 */
function bitsOf(low, high) {
  return Array.from({ length: 64 }, (_, bit) => bit).filter(
    (bit) => ((bit < 32 ? low : high) >>> (bit & 31)) & 1,
  );
}

/** Whether all of a run has raw transfer. @param {Run} run @returns {boolean} */
export function isRaw(run) {
  return run.blocks.every((block) => run.raw.has(block.at));
}

/**
 * Runs with all that has one light, and raw transfer or none, side by side.
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
 * Runs without the oldest blocks where all would take more rows than these; the newest run stays
 * whole.
 * @param {Run[]} runs
 * @param {number} most rows
 * @returns {Run[]}
 */
function youngest(runs, most) {
  let over = runs.reduce((sum, { blocks }) => sum + neededRows(blocks), 0) - most;
  const kept = runs.map((run, n) => {
    const before = neededRows(run.blocks);
    const blocks = [...run.blocks];
    while (n < runs.length - 1 && blocks.length && before - neededRows(blocks) < over)
      blocks.splice(0, Math.ceil(blocks.length / 8));
    over -= before - neededRows(blocks);
    return { ...run, blocks };
  });
  return kept.filter(({ blocks }) => blocks.length);
}

/** Rows that the records of some blocks take. @param {Block[]} blocks @returns {number} */
function neededRows(blocks) {
  return Math.ceil(blocks.reduce((sum, block) => sum + block.count, 0) / ROW);
}
