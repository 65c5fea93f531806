/**
 * The shine of a scene on the card: its lobe, and the light from far away that it mirrors, at
 * several widths of blur.
 */

import { halton, SAMPLES } from "./picture.js";
import { run } from "./programs.js";
import { drawInto, makeTexture } from "./textures.js";

/** @typedef {import("./document.js").CardDocument} CardDocument */
/** @typedef {import("./programs.js").Program} Program */
/** @typedef {import("./textures.js").Texture} Texture */

/** @typedef {{kind: string, roughness: number, strength: number}} Lobe as views ask for it */

const ENERGY_STEPS = 128; // of the kernel, isogi_core/kernels/transport/microfacets.py
const NARROW = Math.PI / 256; // alpha of lobes as narrow as pixels of the sharpest surroundings
const STRATA = 2; // rays of a wide lobe along each side of the square that maps to it
const TAIL = 0.4; // share of facets, the steepest ones, that have no rays of their own
const WIDTH_OF_TAIL = 3; // width, in alpha, by which most of these mirror: STEEP in shine.glsl
const OVERLAP = 2; // solid angle of a ray over its share of the lobe, as rays are few and fixed
const OVERLAP_AT_REST = 4; // the same of many, which are not in order

/**
 * Return the bytes of the surroundings among the slabs of a scene.
 * @param {CardDocument} document
 * @param {ArrayBuffer[]} slabs in the order of `slabsOf`
 * @returns {Uint16Array} halves; empty if the scene does not shine
 */
export function surroundingsIn({ shine }, slabs) {
  return shine ? new Uint16Array(slabs[slabs.length - 1]) : new Uint16Array(0);
}

/**
 * The shine of a scene on a card; without textures if it has none. A scene that shines may be drawn
 * with any lobe.
 */
export class Shine {
  #gl;
  #shine;
  #roughness = NaN; // that of the lobe whose energy is known

  /**
   * @param {import("./device.js").Device} device
   * @param {CardDocument} document
   * @param {Uint16Array} halves see `surroundingsIn`
   */
  constructor({ gl }, { shine }, halves) {
    this.#gl = gl;
    this.#shine = shine;
    this.source = halves;
    /** @type {Texture[]} */
    this.textures = [];
    if (!shine) return;
    const energy = makeTexture(gl, "RGBA16F", [ENERGY_STEPS + 1, 1]);
    this.textures = [energy, makeLevels(gl, shine.surroundings, halves)];
  }

  /**
   * Return the uniforms of sample n of a picture. They are to be asked for before the picture
   * begins, as the energy of another lobe is drawn first.
   * @param {Program|null} program that draws the energy of lobes
   * @param {Lobe|undefined} lobe by default that of the document
   * @param {import("./light.js").TurnedLight} light
   * @param {number} n
   * @returns {Record<string, import("./programs.js").Value>}
   */
  at(program, lobe, { matrix }, n) {
    if (!this.#shine || !program) return {};
    const { albedo, plastic, surroundings } = this.#shine;
    const { kind, roughness, strength } = lobe ?? this.#shine;
    if (this.#roughness !== roughness) this.#measure(program, roughness);
    const alpha = roughness ** 2;
    // A narrow lobe needs one ray, and none if it counts nothing.
    const wide = alpha > NARROW ? STRATA : 1;
    const strata = strength > 0 ? wide : 0;
    // Steep facets of a rough lobe mirror much below the horizon: leave these to rays.
    const coarsest = Math.PI / (surroundings.rows >> (surroundings.levels - 1));
    return {
      alpha,
      strength,
      strata,
      metal: Number(kind === "metal"),
      head_on: kind === "metal" ? albedo : [plastic, plastic, plastic],
      energy: this.textures[0],
      surroundings: this.textures[1],
      brightness: surroundings.brightness,
      turned: matrix.flat(),
      reflecting: albedo,
      spot: n === 0 ? [0.5, 0.5] : [halton(n, 2), halton(n, 3)],
      first_ray: n * strata ** 2,
      together: (strata ** 2 * (n === 0 ? 1 : SAMPLES)) / (n === 0 ? OVERLAP : OVERLAP_AT_REST),
      tail: TAIL * Math.max(1 - ((WIDTH_OF_TAIL * alpha) / coarsest) ** 2, 0),
    };
  }

  /**
   * Draw the energy of a lobe.
   * @param {Program} program
   * @param {number} roughness
   */
  #measure(program, roughness) {
    const framebuffer = drawInto(this.#gl, this.textures[0]);
    this.#gl.viewport(0, 0, ENERGY_STEPS + 1, 1);
    run(this.#gl, program, { alpha: roughness ** 2, steps: ENERGY_STEPS });
    this.#gl.deleteFramebuffer(framebuffer);
    this.#roughness = roughness;
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
