/** The volume on the card: all of its voxels, and the active-cell map of each isovalue shown. */

import { brickShape, findRanges, markCells } from "./cells.js";
import { Refusal } from "./device.js";
import { countOf, joinMaps } from "./surfaces.js";
import { fillTexture, makeTexture } from "./textures.js";

/** @typedef {import("./cells.js").Voxels} Voxels */
/** @typedef {import("./document.js").CardDocument} CardDocument */
/** @typedef {import("./textures.js").Texture} Texture */

const FORMATS = /** @type {const} */ ({ uint8: "R8UI", uint16: "R16UI", float32: "R32F" });
const ARRAYS = { uint8: Uint8Array, uint16: Uint16Array, float32: Float32Array };
const MAP_ROW = 2048; // marked bricks in a row of `cells`: ROW in volume.glsl

/**
 * Join the slabs of a volume along z.
 * @param {CardDocument} document
 * @param {ArrayBuffer[]} slabs bytes of each slab, in the order of the document; more may follow
 * @returns {Voxels} x fastest, then y
 */
export function joinSlabs({ grid: { size }, volume }, slabs) {
  const codes = new ARRAYS[volume.type](size[0] * size[1] * size[2]);
  volume.slabs.forEach(({ first }, i) =>
    codes.set(new ARRAYS[volume.type](slabs[i]), first * size[0] * size[1]),
  );
  return codes;
}

/** The voxels of a scene on a card, with the active-cell maps of the isovalues that are shown. */
export class Volume {
  /**
   * @param {import("./device.js").Device} device
   * @param {CardDocument} document
   * @param {Voxels} codes x fastest, then y
   * @throws {Refusal} if the volume is larger than the card's textures
   */
  constructor({ gl, most3d }, document, codes) {
    const { grid, volume } = document;
    if (Math.max(...grid.size) > most3d) {
      throw new Refusal(
        `The volume has ${Math.max(...grid.size)} voxels along a side, and the graphics card takes ${most3d}: the server draws.`,
      );
    }
    this.gl = gl;
    this.grid = grid;
    this.source = codes;
    this.texture = makeTexture(gl, FORMATS[volume.type], grid.size);
    fillTexture(gl, this.texture, codes);
    // The map treats voxels without a value as NaN; the texture keeps their code, as shaders
    // compare it with HOLE.
    this.codes =
      volume.hole === null ? codes : codes.map((code) => (code === volume.hole ? NaN : code));
    this.ranges = findRanges(this.codes, grid.size);
    const [x, y, z] = brickShape(grid.size);
    this.tops = makeTexture(gl, "R32UI", [x, y, countOf(document) * z]);
    this.cells = makeTexture(gl, "RG32UI", [MAP_ROW, 1]);
    /**
     * The map of each surface, with its isovalue.
     * @type {{isovalue: number, map: import("./surfaces.js").CellMap}[]}
     */
    this.maps = [];
  }

  /** Return all textures of the volume, to delete them. @returns {Texture[]} */
  get textures() {
    return [this.texture, this.tops, this.cells];
  }

  /**
   * Return the uniforms of the volume at the isovalue of each surface, and make the active-cell maps
   * of those that have changed.
   * @param {...number} isovalues as codes
   * @returns {Record<string, import("./programs.js").Value>}
   */
  at(...isovalues) {
    if (isovalues.some((isovalue, k) => isovalue !== this.maps[k]?.isovalue)) this.#map(isovalues);
    const { size, spacing } = this.grid;
    const [isovalue] = isovalues;
    return { voxels: this.texture, size, spacing, isovalue, tops: this.tops, cells: this.cells };
  }

  /** Make the active-cell maps of isovalues, and upload them. @param {number[]} isovalues as codes */
  #map(isovalues) {
    const { gl } = this;
    this.maps = isovalues.map((isovalue, k) =>
      isovalue === this.maps[k]?.isovalue
        ? this.maps[k]
        : { isovalue, map: markCells(this.codes, this.grid.size, this.ranges, isovalue) },
    );
    const map = joinMaps(this.maps.map((each) => each.map));
    const rows = Math.max(Math.ceil(map.marked / MAP_ROW), 1);
    const words = new Uint32Array(2 * MAP_ROW * rows);
    words.set(map.cells);
    // Grow by half more than is needed, so that sliding the isovalue seldom allocates.
    if (this.cells.size[1] < rows) {
      gl.deleteTexture(this.cells.id);
      this.cells = makeTexture(gl, "RG32UI", [MAP_ROW, rows + (rows >> 1)]);
    }
    fillTexture(gl, this.tops, map.tops);
    fillTexture(gl, this.cells, words, [0, 0], [MAP_ROW, rows]);
  }
}
