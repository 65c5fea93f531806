/**
 * A picture of linear light on a card: sample 0 at the middles of pixels, and the mean with samples
 * that smooth edges.
 */

import { drawInto, makeTexture } from "./textures.js";

/** @typedef {import("./textures.js").Texture} Texture */
/** @typedef {readonly [number, number]} Size pixels along x and y */
/** @typedef {readonly [number, number]} Band rows [from, to), counted from below */

/** Samples of a picture at rest after sample 0, the one at the middles of pixels. */
export const SAMPLES = 16;

/** The golden angle, in radians: discs are filled as a sunflower is. Source: Vogel 1979. */
const GOLDEN = Math.PI * (3 - Math.sqrt(5));

/**
 * Return the radical inverse of n: its digits in a base, mirrored behind the point. Source: Halton
 * 1964.
 * @param {number} n
 * @param {number} base
 * @returns {number}
 */
export function halton(n, base) {
  let sum = 0;
  for (let share = 1 / base; n > 0; n = Math.floor(n / base), share /= base)
    sum += (n % base) * share;
  return sum;
}

/**
 * Return the offset of sample n from the middle of a pixel; sample 0 has none.
 * @param {number} n
 * @returns {[number, number]} pixels, -0.5 to 0.5
 */
export function jitterOf(n) {
  return n === 0 ? [0, 0] : [halton(n, 2) - 0.5, halton(n, 3) - 0.5];
}

/**
 * Return the point of a lobe's disc that shadow rays of sample n go to, in radii; (0, 0) for sample
 * 0.
 * @param {number} n
 * @returns {[number, number]}
 */
export function discOf(n) {
  // Radii by the square root spread points evenly over the area. Half a sample is added so that no
  // point repeats the middle.
  const radius = n === 0 ? 0 : Math.sqrt(halton(n - 1, 2) + 0.5 / SAMPLES);
  return [radius * Math.cos(n * GOLDEN), radius * Math.sin(n * GOLDEN)];
}

/** A picture that is drawn sample by sample, in textures of its size or larger. */
export class Picture {
  /** @param {WebGL2RenderingContext} gl @param {Size} size */
  constructor(gl, size) {
    this.gl = gl;
    this.capacity = size;
    this.first = makeTexture(gl, "RGBA16F", size, { smooth: true });
    this.mean = makeTexture(gl, "RGBA16F", size, { smooth: true });
    this.targets = [drawInto(gl, this.first), drawInto(gl, this.mean)];
    this.samples = 0;
  }

  /**
   * Return true if a picture of this size fits the textures.
   * @param {Size} size
   * @returns {boolean}
   */
  holds(size) {
    return size[0] <= this.capacity[0] && size[1] <= this.capacity[1];
  }

  /** Return the texture with the mean of all complete samples. @returns {Texture} */
  get texture() {
    return this.samples > 1 ? this.mean : this.first;
  }

  /**
   * Direct the next drawing into sample n: sample 0 replaces the picture, others are blended into
   * its mean.
   * @param {number} n
   * @param {Size} size pixels of the picture
   * @param {Band} band rows that are drawn next
   */
  begin(n, size, [from, to]) {
    const { gl, targets } = this;
    const [width, height] = size;
    // The mean begins as a copy of sample 0. That sample is kept, as edges are found in it.
    if (n === 1 && from === 0) {
      gl.bindFramebuffer(gl.READ_FRAMEBUFFER, targets[0]);
      gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, targets[1]);
      gl.blitFramebuffer(0, 0, width, height, 0, 0, width, height, gl.COLOR_BUFFER_BIT, gl.NEAREST);
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, targets[Math.min(n, 1)]);
    gl.viewport(0, 0, width, height);
    // Blending by 1 / (n + 1) keeps a running mean.
    if (n > 0) gl.enable(gl.BLEND);
    gl.blendFunc(gl.CONSTANT_ALPHA, gl.ONE_MINUS_CONSTANT_ALPHA);
    gl.blendColor(0, 0, 0, 1 / (n + 1));
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(0, from, width, to - from);
  }

  /**
   * End a band of sample n.
   * @param {number} n
   * @param {boolean} isLast true if it completes the sample
   */
  end(n, isLast) {
    this.gl.disable(this.gl.BLEND);
    this.gl.disable(this.gl.SCISSOR_TEST);
    if (isLast) this.samples = n + 1;
  }

  /** Free the card's memory. */
  release() {
    for (const texture of [this.first, this.mean]) this.gl.deleteTexture(texture.id);
    for (const target of this.targets) this.gl.deleteFramebuffer(target);
  }
}
