/**
 * A picture of linear light on a card: what the pixels' middles show, and the mean of samples that
 * make edges smooth.
 */

import { drawInto, makeTexture } from "./textures.js";

/** @typedef {import("./textures.js").Texture} Texture */
/** @typedef {readonly [number, number]} Size pixels along x and y */
/** @typedef {readonly [number, number]} Band rows from the first to before the second, from below */

/** Samples of a picture at rest, besides the one in the middle. */
export const SAMPLES = 16;

/** The golden angle, in radians: discs are filled as a sunflower is. Source: Vogel 1979. */
const GOLDEN = Math.PI * (3 - Math.sqrt(5));

/**
 * Digits of n in a base behind the point, in reverse. Source: Halton 1964.
 * @param {number} n
 * @param {number} base
 * @returns {number}
 */
function halton(n, base) {
  let sum = 0;
  for (let share = 1 / base; n > 0; n = Math.floor(n / base), share /= base)
    sum += (n % base) * share;
  return sum;
}

/**
 * Where sample n of a pixel is, from its middle; the middle for 0.
 * @param {number} n
 * @returns {[number, number]} pixels
 */
export function jitterOf(n) {
  return n === 0 ? [0, 0] : [halton(n, 2) - 0.5, halton(n, 3) - 0.5];
}

/**
 * Where the rays of sample n meet a disc, in radii; the middle for 0.
 * @param {number} n
 * @returns {[number, number]}
 */
export function discOf(n) {
  const radius = n === 0 ? 0 : Math.sqrt(halton(n - 1, 2) + 0.5 / SAMPLES);
  return [radius * Math.cos(n * GOLDEN), radius * Math.sin(n * GOLDEN)];
}

/** A picture that is drawn sample by sample, in textures that are as large as it or larger. */
export class Picture {
  /** @param {WebGL2RenderingContext} gl @param {Size} size */
  constructor(gl, size) {
    this.gl = gl;
    this.room = size;
    this.first = makeTexture(gl, "RGBA16F", size, { smooth: true });
    this.mean = makeTexture(gl, "RGBA16F", size, { smooth: true });
    this.targets = [drawInto(gl, this.first), drawInto(gl, this.mean)];
    this.samples = 0;
  }

  /** Whether a picture of this size has room in it. @param {Size} size @returns {boolean} */
  holds(size) {
    return size[0] <= this.room[0] && size[1] <= this.room[1];
  }

  /** What it shows. @returns {Texture} */
  get texture() {
    return this.samples > 1 ? this.mean : this.first;
  }

  /**
   * Have what is drawn next become sample n: the first one replaces the picture, and the others
   * join its mean.
   * @param {number} n
   * @param {Size} size
   * @param {Band} band of it that is drawn next
   */
  begin(n, size, [from, to]) {
    const { gl, targets } = this;
    const [width, height] = size;
    if (n === 1 && from === 0) {
      gl.bindFramebuffer(gl.READ_FRAMEBUFFER, targets[0]);
      gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, targets[1]);
      gl.blitFramebuffer(0, 0, width, height, 0, 0, width, height, gl.COLOR_BUFFER_BIT, gl.NEAREST);
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, targets[Math.min(n, 1)]);
    gl.viewport(0, 0, width, height);
    if (n > 0) gl.enable(gl.BLEND);
    gl.blendFunc(gl.CONSTANT_ALPHA, gl.ONE_MINUS_CONSTANT_ALPHA);
    gl.blendColor(0, 0, 0, 1 / (n + 1));
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(0, from, width, to - from);
  }

  /**
   * A band of sample n is drawn; the last one ends it.
   * @param {number} n
   * @param {boolean} isLast
   */
  end(n, isLast) {
    this.gl.disable(this.gl.BLEND);
    this.gl.disable(this.gl.SCISSOR_TEST);
    if (isLast) this.samples = n + 1;
  }

  /** Give the card's memory back. */
  release() {
    for (const texture of [this.first, this.mean]) this.gl.deleteTexture(texture.id);
    for (const target of this.targets) this.gl.deleteFramebuffer(target);
  }
}
