/**
 * Textures of a card: allocated once at a fixed size, as WebGL 2 has it, and filled part by part.
 */

/** @typedef {"R8UI"|"RGB8UI"|"R16UI"|"R32F"|"R32UI"|"RG32UI"|"RGBA32UI"|"RGB16F"|"RGBA16F"|"RGBA32F"} Format */
/**
 * @typedef {{id: WebGLTexture, target: number, format: Format, size: readonly number[]}} Texture
 */

/**
 * Format and type of the data that fills each internal format.
 * @type {Record<Format, ["RED_INTEGER"|"RED"|"RG_INTEGER"|"RGB_INTEGER"|"RGBA_INTEGER"|"RGB"|"RGBA",
 *   "UNSIGNED_BYTE"|"UNSIGNED_SHORT"|"FLOAT"|"UNSIGNED_INT"|"HALF_FLOAT"]>}
 */
const DATA = {
  R8UI: ["RED_INTEGER", "UNSIGNED_BYTE"],
  RGB8UI: ["RGB_INTEGER", "UNSIGNED_BYTE"],
  R16UI: ["RED_INTEGER", "UNSIGNED_SHORT"],
  R32F: ["RED", "FLOAT"],
  R32UI: ["RED_INTEGER", "UNSIGNED_INT"],
  RG32UI: ["RG_INTEGER", "UNSIGNED_INT"],
  RGBA32UI: ["RGBA_INTEGER", "UNSIGNED_INT"],
  RGB16F: ["RGB", "HALF_FLOAT"],
  RGBA16F: ["RGBA", "HALF_FLOAT"],
  RGBA32F: ["RGBA", "FLOAT"],
};

/** Bytes of a texel of each format. @type {Record<Format, number>} */
const BYTES = {
  R8UI: 1,
  RGB8UI: 3,
  R16UI: 2,
  R32F: 4,
  R32UI: 4,
  RG32UI: 8,
  RGBA32UI: 16,
  RGB16F: 6,
  RGBA16F: 8,
  RGBA32F: 16,
};

/**
 * Allocate a texture: two-dimensional if `size` has two numbers, otherwise a volume or an array of
 * layers.
 * @param {WebGL2RenderingContext} gl
 * @param {Format} format
 * @param {readonly number[]} size texels along x, y, and z or layers
 * @param {{layered?: boolean, smooth?: boolean}} [options] `layered` makes an array of layers;
 *   `smooth` filters linearly
 * @returns {Texture}
 */
export function makeTexture(gl, format, size, { layered = false, smooth = false } = {}) {
  const spatial = layered ? gl.TEXTURE_2D_ARRAY : gl.TEXTURE_3D;
  const target = size.length === 2 ? gl.TEXTURE_2D : spatial;
  const id = gl.createTexture();
  gl.bindTexture(target, id);
  for (const side of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER])
    gl.texParameteri(target, side, smooth ? gl.LINEAR : gl.NEAREST);
  for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T, gl.TEXTURE_WRAP_R])
    gl.texParameteri(target, side, gl.CLAMP_TO_EDGE);
  const [x, y, z] = size;
  if (size.length === 2) gl.texStorage2D(target, 1, gl[format], x, y);
  else gl.texStorage3D(target, 1, gl[format], x, y, z);
  return { id, target, format, size };
}

/**
 * Fill a box of a texture, by default all of it.
 * @param {WebGL2RenderingContext} gl
 * @param {Texture} texture
 * @param {ArrayBufferView} data x fastest
 * @param {readonly number[]} [at] first texel of the box
 * @param {readonly number[]} [size] texels of the box along each axis
 */
export function fillTexture(gl, texture, data, at = [0, 0, 0], size = texture.size) {
  const [format, type] = DATA[texture.format].map((name) => gl[name]);
  gl.bindTexture(texture.target, texture.id);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  const [x, y, z = 0] = at;
  const [width, height, depth = 1] = size;
  if (texture.size.length === 2)
    gl.texSubImage2D(texture.target, 0, x, y, width, height, format, type, data);
  else gl.texSubImage3D(texture.target, 0, x, y, z, width, height, depth, format, type, data);
}

/**
 * Return the number of bytes that a texture takes.
 * @param {Format} format
 * @param {readonly number[]} size
 * @returns {number}
 */
export function bytesOf(format, size) {
  return size.reduce((product, n) => product * n, BYTES[format]);
}

/**
 * Make a framebuffer that draws into textures of one size, and bind it.
 * @param {WebGL2RenderingContext} gl
 * @param {Texture[]} textures
 * @returns {WebGLFramebuffer}
 */
export function drawInto(gl, ...textures) {
  const framebuffer = gl.createFramebuffer();
  const places = textures.map((_, i) => gl.COLOR_ATTACHMENT0 + i);
  gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
  textures.forEach(({ target, id }, i) =>
    gl.framebufferTexture2D(gl.FRAMEBUFFER, places[i], target, id, 0),
  );
  gl.drawBuffers(places);
  return framebuffer;
}
