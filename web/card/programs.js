/**
 * Programs of a card: shaders are files in `shaders/`, joined where they include each other,
 * compiled beside the page.
 */

/** @typedef {import("./textures.js").Texture} Texture */
/**
 * @typedef {number|readonly number[]|Float32Array|Int32Array|Uint32Array|Texture} Value of a
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
 * The text of a shader with what it includes, each file once, where it is first asked for.
 * @param {string} name
 * @param {(name: string) => Promise<string>} read a file's text
 * @param {Set<string>} [seen] files that are in the text already
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
 * Text of a shader's file beside this module: all of them come in one file.
 * @param {string} name
 * @returns {Promise<string>}
 */
export async function readShader(name) {
  shaders ??= readShaders();
  try {
    return (await shaders)[name];
  } catch (error) {
    shaders = null; // the next one to ask tries again
    throw error;
  }
}

/** @returns {Promise<Record<string, string>>} */
async function readShaders() {
  const answer = await fetch(new URL("shaders.json", import.meta.url));
  if (!answer.ok) throw new Error(`The shaders did not come: HTTP ${answer.status}.`);
  return answer.json();
}

/**
 * A program of a fragment shader that is drawn over all pixels, once its driver has compiled it.
 * @param {WebGL2RenderingContext} gl
 * @param {string} text of the shader, without its version
 * @param {Record<string, number|string>} [defines] names that stand for numbers or words in it
 * @returns {Promise<Program>}
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
 * @param {WebGL2RenderingContext} gl
 * @param {number} kind
 * @param {string} text
 * @returns {WebGLShader}
 */
function shaderOf(gl, kind, text) {
  const shader = gl.createShader(kind);
  if (!shader) throw new Error("The graphics card was lost.");
  gl.shaderSource(shader, text);
  gl.compileShader(shader);
  return shader;
}

/**
 * Wait until a driver that compiles beside the page has done so.
 * @param {WebGL2RenderingContext} gl
 * @param {WebGLProgram} id
 */
async function compiled(gl, id) {
  const beside = gl.getExtension("KHR_parallel_shader_compile");
  while (
    beside &&
    !gl.isContextLost() &&
    !gl.getProgramParameter(id, beside.COMPLETION_STATUS_KHR)
  ) {
    await new Promise((done) => setTimeout(done, 10));
  }
}

/** @param {WebGL2RenderingContext} gl @param {WebGLProgram} id @returns {Program["uniforms"]} */
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
 * Draw a program over all pixels of what is bound. Values that it does not read are passed over.
 * @param {WebGL2RenderingContext} gl
 * @param {Program} program
 * @param {Record<string, Value>} values of its uniforms
 */
export function run(gl, program, values) {
  gl.useProgram(program.id);
  let unit = 0;
  for (const [name, value] of Object.entries(values)) {
    const uniform = program.uniforms.get(name);
    if (!uniform) continue;
    if (typeof value === "object" && "target" in value) {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(value.target, value.id);
      gl.uniform1i(uniform.place, unit++);
    } else put(gl, uniform.place, uniform.kind, typeof value === "number" ? [value] : value);
  }
  gl.drawArrays(gl.TRIANGLES, 0, 3);
}

/**
 * @param {WebGL2RenderingContext} gl
 * @param {WebGLUniformLocation} place
 * @param {number} kind
 * @param {Iterable<number>} value
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
  else throw new Error(`A uniform of the kind ${kind} has no way to the card.`);
}
