/**
 * The visitor's graphics card: a WebGL 2 context with all that drawing needs, or the reason why it
 * cannot draw.
 */

const SOFTWARE = /swiftshader|llvmpipe|softpipe|basic render|software/i;

/**
 * Bytes of textures that a page takes of a card without asking: phones kill pages that take much
 * more.
 */
export const BUDGET = 384 * 2 ** 20;

/** Why this browser's card does not draw a scene: a sentence for the visitor. */
export class Refusal extends Error {}

/**
 * @typedef {object} Device what a card offers
 * @property {WebGL2RenderingContext} gl
 * @property {string} name of the card, as its driver gives it
 * @property {boolean} software whether the browser draws by its processor
 * @property {number} most3d texels along a side of 3D textures at most
 * @property {number} most2d texels along a side of 2D textures at most
 * @property {number} layers of array textures at most
 */

/**
 * Open the card behind a canvas.
 * @param {HTMLCanvasElement|OffscreenCanvas} canvas of nobody else
 * @param {{software?: boolean}} [allowed] whether a processor may stand in for a card: tests, and
 *   those who compare
 * @returns {Device}
 * @throws {Refusal} where there is no card that can draw
 */
export function openDevice(canvas, { software = false } = {}) {
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
  const slow = SOFTWARE.test(name);
  if (slow && !software)
    throw new Refusal(
      `This browser draws WebGL by its processor (${name}): the server is faster, and draws.`,
    );
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
  return { gl, name, software: slow, most3d, most2d, layers };
}

/** @param {WebGL2RenderingContext} gl @returns {string} */
function rendererOf(gl) {
  const told = gl.getExtension("WEBGL_debug_renderer_info");
  return String(gl.getParameter(told ? told.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
}
