/**
 * Programs of a card: shaders are files in `shaders/` that include each other; drivers compile them
 * without blocking the page if they can.
 */

/** @typedef {import("./textures.js").Texture} Texture */
/**
 * @typedef {number|readonly number[]|Float32Array|Int32Array|Uint32Array|Texture} Value value of a
 *   uniform
 */
/**
 * @typedef {{id: WebGLProgram, uniforms: Map<string, {place: WebGLUniformLocation, kind: number}>}}
 *   Program
 */

const HEAD = "#version 300 es\nprecision highp float;\nprecision highp int;\n";
const INCLUDE = /^#include "([^"]+)"$/gm;

/** A triangle that covers all pixels, without a vertex buffer. */
const SCREEN = `${HEAD}void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }`;

/**
 * Return the text of a shader with the files that it includes, each one once, at its first
 * inclusion.
 * @param {string} name
 * @param {(name: string) => Promise<string>} read returns the text of a file
 * @param {Set<string>} [seen] files that the text already has
 * @returns {Promise<string>}
 */
export async function joined(name, read, seen = new Set()) {
  if (seen.has(name)) return "";
  seen.add(name);
  const text = await read(name);
  const parts = [];
  let end = 0;
  for (const found of text.matchAll(INCLUDE)) {
    parts.push(text.slice(end, found.index), await joined(found[1], read, seen));
    end = found.index + found[0].length;
  }
  return [...parts, text.slice(end)].join("");
}

/** @type {Promise<Record<string, string>>|null} */
let shaders = null;

/**
 * Return the text of a shader's file, by one request for all shaders.
 * @param {string} name
 * @returns {Promise<string>}
 * @throws {Error} if the shaders cannot be read
 */
export async function readShader(name) {
  shaders ??= readShaders();
  try {
    return (await shaders)[name];
  } catch (error) {
    shaders = null; // the next call tries again
    throw error;
  }
}

/**
 * Read the text of all shaders, by the names of their files.
 * @returns {Promise<Record<string, string>>}
 */
async function readShaders() {
  const answer = await fetch(new URL("shaders.json", import.meta.url));
  if (!answer.ok) throw new Error(`The shaders did not come: HTTP ${answer.status}.`);
  return answer.json();
}

/**
 * Make a program that runs a fragment shader on all pixels, and return it once its driver has
 * compiled it.
 * @param {WebGL2RenderingContext} gl
 * @param {string} text of the fragment shader, without a version line
 * @param {Record<string, number|string>} [defines] names that the shader uses, with the numbers or
 *   words that replace them
 * @returns {Promise<Program>}
 * @throws {Error} if the card refuses the shader
 */
export async function compile(gl, text, defines = {}) {
  const lines = Object.entries(defines).map(([name, value]) => `#define ${name} ${value}\n`);
  const shaders = [
    shaderOf(gl, gl.VERTEX_SHADER, SCREEN),
    shaderOf(gl, gl.FRAGMENT_SHADER, HEAD + lines.join("") + text),
  ];
  const id = gl.createProgram();
  shaders.forEach((shader) => gl.attachShader(id, shader));
  gl.linkProgram(id);
  await compiled(gl, id);
  // A lost context reports failure for everything: that is not the shader's fault.
  if (!gl.getProgramParameter(id, gl.LINK_STATUS) && !gl.isContextLost()) {
    const logs = [
      ...shaders.map((shader) => gl.getShaderInfoLog(shader)),
      gl.getProgramInfoLog(id),
    ];
    throw new Error(`The graphics card refuses a shader: ${logs.join(" ").trim()}`);
  }
  shaders.forEach((shader) => gl.deleteShader(shader));
  return { id, uniforms: uniformsOf(gl, id) };
}

/**
 * Compile one shader.
 * @param {WebGL2RenderingContext} gl
 * @param {number} kind VERTEX_SHADER or FRAGMENT_SHADER
 * @param {string} text
 * @returns {WebGLShader}
 * @throws {Error} if the card was lost
 */
function shaderOf(gl, kind, text) {
  const shader = gl.createShader(kind);
  if (!shader) throw new Error("The graphics card was lost.");
  gl.shaderSource(shader, text);
  gl.compileShader(shader);
  return shader;
}

/**
 * Wait until the driver has compiled a program, if it compiles in parallel to the page. Other
 * drivers block at the next query.
 * @param {WebGL2RenderingContext} gl
 * @param {WebGLProgram} id
 */
async function compiled(gl, id) {
  const parallel = gl.getExtension("KHR_parallel_shader_compile");
  while (
    parallel &&
    !gl.isContextLost() &&
    !gl.getProgramParameter(id, parallel.COMPLETION_STATUS_KHR)
  ) {
    await new Promise((done) => setTimeout(done, 10));
  }
}

/**
 * Return the place and type of each uniform that a program reads, by name.
 * @param {WebGL2RenderingContext} gl
 * @param {WebGLProgram} id
 * @returns {Program["uniforms"]}
 */
function uniformsOf(gl, id) {
  const found = new Map();
  for (let i = 0; i < (gl.getProgramParameter(id, gl.ACTIVE_UNIFORMS) ?? 0); i++) {
    const uniform = gl.getActiveUniform(id, i);
    const place = uniform && gl.getUniformLocation(id, uniform.name);
    if (uniform && place) found.set(uniform.name.replace("[0]", ""), { place, kind: uniform.type });
  }
  return found;
}

/**
 * Run a program on all pixels of the bound framebuffer. Values that the program does not read are
 * ignored.
 * @param {WebGL2RenderingContext} gl
 * @param {Program} program
 * @param {Record<string, Value>} values of its uniforms, by name
 */
export function run(gl, program, values) {
  gl.useProgram(program.id);
  let unit = 0;
  for (const [name, value] of Object.entries(values)) {
    const uniform = program.uniforms.get(name);
    if (!uniform) continue;
    // Textures take the next free unit each.
    if (typeof value === "object" && "target" in value) {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(value.target, value.id);
      gl.uniform1i(uniform.place, unit++);
    } else put(gl, uniform.place, uniform.kind, typeof value === "number" ? [value] : value);
  }
  gl.drawArrays(gl.TRIANGLES, 0, 3);
}

/**
 * Set a uniform by its type.
 * @param {WebGL2RenderingContext} gl
 * @param {WebGLUniformLocation} place
 * @param {number} kind
 * @param {Iterable<number>} value
 * @throws {Error} if the type is not one of these
 */
function put(gl, place, kind, value) {
  const numbers = [...value];
  if (kind === gl.FLOAT) gl.uniform1fv(place, numbers);
  else if (kind === gl.FLOAT_VEC2) gl.uniform2fv(place, numbers);
  else if (kind === gl.FLOAT_VEC3) gl.uniform3fv(place, numbers);
  else if (kind === gl.FLOAT_VEC4) gl.uniform4fv(place, numbers);
  else if (kind === gl.INT || kind === gl.BOOL) gl.uniform1iv(place, numbers);
  else if (kind === gl.INT_VEC2) gl.uniform2iv(place, numbers);
  else if (kind === gl.INT_VEC3) gl.uniform3iv(place, numbers);
  else throw new Error(`Uniforms of type ${kind} are not supported: add them to \`put\`.`);
}
