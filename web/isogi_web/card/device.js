/**
 * The visitor's graphics card: a WebGL 2 context with all that drawing needs, or the reason why it
 * cannot draw.
 */

import { Fence, nearest } from "./pace.js";
import { compile, joined, run } from "./programs.js";
import { drawInto, fillTexture, makeTexture } from "./textures.js";

/** Bytes of raw transfer that a card holds at most: phones kill pages that take much more. */
export const BUDGET = 384 * 2 ** 20;

/**
 * Size of the trial picture, pixels: a quarter of 1280 × 800 along each axis. The slowest useful
 * card begins with as few.
 */
const TRIAL_SIZE = /** @type {const} */ ([320, 200]);
const TRIAL_EDGE = 32; // voxels along a side of its volume: EDGE in trial.frag.glsl
const TRIALS = 4; // pictures at most; drivers still compile during the first

/**
 * Milliseconds that the trial picture may take. On a card that needs 20, a picture of a surface
 * with lobes, a quarter of the screen wide, takes about as long, and its primary rays half of that.
 * Cards of ten years ago need 5, and processors more than 100.
 */
export const TRIAL_MS = 20;

/** The reason why this browser's card does not draw a scene: a sentence for the visitor. */
export class Refusal extends Error {}

/**
 * @typedef {object} Device a card's context, and its limits
 * @property {WebGL2RenderingContext} gl
 * @property {string} name of the card, as its driver gives it
 * @property {number} most3d texels along a side of 3D textures at most
 * @property {number} most2d texels along a side of 2D textures at most
 * @property {number} layers layers of array textures at most
 */

/**
 * Open the card of a canvas.
 * @param {HTMLCanvasElement|OffscreenCanvas} canvas that nothing else draws on
 * @returns {Device}
 * @throws {Refusal} if there is no card that can draw
 */
export function openDevice(canvas) {
  const wished = {
    alpha: false,
    antialias: false,
    depth: false,
    stencil: false,
    powerPreference: "high-performance",
  };
  const gl = /** @type {WebGL2RenderingContext|null} */ (canvas.getContext("webgl2", wished));
  if (!gl) throw new Refusal("This browser has no WebGL 2: the server draws.");
  const name = rendererOf(gl);
  // Light of texels is folded into textures of floats; WebGL 2 alone does not promise to draw into
  // them.
  if (
    !gl.getExtension("EXT_color_buffer_float") &&
    !gl.getExtension("EXT_color_buffer_half_float")
  ) {
    throw new Refusal(
      `The graphics card (${name}) cannot draw into textures of floats: the server draws.`,
    );
  }
  const [most3d, most2d, layers] = [
    gl.MAX_3D_TEXTURE_SIZE,
    gl.MAX_TEXTURE_SIZE,
    gl.MAX_ARRAY_TEXTURE_LAYERS,
  ].map((limit) => gl.getParameter(limit));
  return { gl, name, most3d, most2d, layers };
}

/**
 * Return the card's name as its driver reports it.
 * @param {WebGL2RenderingContext} gl
 * @returns {string}
 */
function rendererOf(gl) {
  const info = gl.getExtension("WEBGL_debug_renderer_info");
  return String(gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
}

/**
 * Time the trial picture, and return the shortest of a few times.
 * @param {WebGL2RenderingContext} gl
 * @param {(name: string) => Promise<string>} read text of a shader's file
 * @returns {Promise<number>} milliseconds
 * @throws {Error} if the card is lost meanwhile
 */
export async function timeTrial(gl, read) {
  const program = await compile(gl, await joined("trial.frag.glsl", read));
  const voxels = makeTexture(gl, "R8UI", [TRIAL_EDGE, TRIAL_EDGE, TRIAL_EDGE]);
  // Fill the volume with a multiplicative hash of the index, so that reads are as scattered as
  // those of rays.
  const codes = Uint8Array.from({ length: TRIAL_EDGE ** 3 }, (_, i) => (i * 2654435761) >>> 24);
  fillTexture(gl, voxels, codes);
  const picture = makeTexture(gl, "RGBA16F", TRIAL_SIZE);
  const target = drawInto(gl, picture);
  let least = Infinity;
  // Stop as soon as one picture is quick enough: the first ones include compilation.
  for (let i = 0; i < TRIALS && least > TRIAL_MS; i++) {
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    gl.viewport(0, 0, ...TRIAL_SIZE);
    run(gl, program, { voxels });
    const reading = await new Promise((done) => new Fence(gl, done));
    if (!reading) throw new Error("The graphics card was lost.");
    // A reading is an interval: take its time in favour of the card.
    least = Math.min(least, nearest(TRIAL_MS, reading));
  }
  gl.deleteFramebuffer(target);
  for (const { id } of [voxels, picture]) gl.deleteTexture(id);
  gl.deleteProgram(program.id);
  return least;
}
