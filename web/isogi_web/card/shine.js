/**
 * The shine of a scene on the card: its lobe, and the light from far away that it mirrors, at
 * several widths of blur.
 */

import { halton, SAMPLES } from "./picture.js";
import { fillTexture, makeTexture } from "./textures.js";

/** @typedef {import("./document.js").CardDocument} CardDocument */
/** @typedef {import("./document.js").Vec3} Vec3 */
/** @typedef {import("./textures.js").Texture} Texture */

const STRATA = 2; // rays of a wide lobe along each side of the square that maps to it

/**
 * Return the bytes of the surroundings among the slabs of a scene.
 * @param {CardDocument} document
 * @param {ArrayBuffer[]} slabs in the order of `slabsOf`
 * @returns {Uint16Array} halves; empty if the scene does not shine
 */
export function surroundingsIn({ shine }, slabs) {
  return new Uint16Array(shine ? slabs[slabs.length - 1] : 0);
}

/** The shine of a scene on a card; without textures if it has none. */
export class Shine {
  #shine;
  #strata = 1;

  /**
   * @param {import("./device.js").Device} device
   * @param {CardDocument} document
   * @param {Uint16Array} halves see `surroundingsIn`
   */
  constructor({ gl }, { shine }, halves) {
    this.#shine = shine;
    this.source = halves;
    /** @type {Texture[]} */
    this.textures = [];
    if (!shine) return;
    // A lobe that the surroundings do not resolve needs one ray.
    if (shine.alpha > Math.PI / shine.surroundings.rows) this.#strata = STRATA;
    const energy = makeTexture(gl, "RGBA32F", [shine.energy.length, 1]);
    fillTexture(gl, energy, new Float32Array(shine.energy.flatMap(([a, b]) => [a, b, 0, 0])));
    this.textures = [energy, makeLevels(gl, shine.surroundings, halves)];
  }

  /**
   * Return the uniforms of sample n of a picture.
   * @param {import("./light.js").TurnedLight} light
   * @param {number} n
   * @returns {Record<string, import("./programs.js").Value>}
   */
  at({ matrix }, n) {
    if (!this.#shine) return {};
    const { alpha, facing, strength, metal, surroundings } = this.#shine;
    const rays = this.#strata ** 2;
    return {
      alpha,
      facing,
      strength,
      metal: Number(metal),
      energy: this.textures[0],
      surroundings: this.textures[1],
      brightness: surroundings.brightness,
      turned: matrix.flat(),
      strata: this.#strata,
      spot: n === 0 ? [0.5, 0.5] : [halton(n, 2), halton(n, 3)],
      together: n === 0 ? rays : rays * SAMPLES,
    };
  }
}

/**
 * Make the texture of the surroundings, whose first and last columns are neighbours.
 * @param {WebGL2RenderingContext} gl
 * @param {NonNullable<CardDocument["shine"]>["surroundings"]} surroundings
 * @param {Uint16Array} halves of all levels
 * @returns {Texture}
 */
function makeLevels(gl, { rows, levels }, halves) {
  const target = gl.TEXTURE_2D;
  const id = gl.createTexture();
  gl.bindTexture(target, id);
  gl.texParameteri(target, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
  gl.texParameteri(target, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
  gl.texParameteri(target, gl.TEXTURE_WRAP_S, gl.REPEAT);
  gl.texParameteri(target, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
  gl.texStorage2D(target, levels, gl.RGB16F, 2 * rows, rows);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  for (let level = 0, from = 0; level < levels; level++) {
    const high = rows >> level;
    const some = halves.subarray(from, from + 6 * high * high);
    gl.texSubImage2D(target, level, 0, 0, 2 * high, high, gl.RGB, gl.HALF_FLOAT, some);
    from += some.length;
  }
  return { id, target, format: "RGB16F", size: [2 * rows, rows] };
}
