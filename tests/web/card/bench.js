/** What tests do with a card in a page: run single functions of shaders, and read pictures back as floats. */

import { openDevice } from "/web/card/device.js";
import { compile, joined, readShader, run } from "/web/card/programs.js";
import { drawInto, fillTexture, makeTexture } from "/web/card/textures.js";

/** Bytes of an array as text: as a list of numbers it takes a second on its way. */
export function packed(array) {
  const bytes = new Uint8Array(array.buffer, array.byteOffset, array.byteLength), parts = [];
  for (let i = 0; i < bytes.length; i += 0x8000) parts.push(String.fromCharCode(...bytes.subarray(i, i + 0x8000)));
  return btoa(parts.join(""));
}

/** The array that a text of bytes stands for. */
export function unpacked(text, Kind) {
  return new Kind(Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer);
}

/** A file of the tests' server, as bytes. */
export async function bytes(name) {
  return (await fetch(`/data/${name}`)).arrayBuffer();
}

/** The device of the tests' canvas. */
export function device(size = 64) {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [size, size];
  return openDevice(canvas);
}

/** What a framebuffer shows, rows from the top, (height, width, 4) float32. */
export function readFloats(gl, target, width, height) {
  const found = new Float32Array(4 * width * height), flipped = new Float32Array(found.length);
  gl.bindFramebuffer(gl.FRAMEBUFFER, target);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.FLOAT, found);
  for (let y = 0; y < height; y++) flipped.set(found.subarray(4 * width * y, 4 * width * (y + 1)), 4 * width * (height - 1 - y));
  return flipped;
}

/**
 * Four numbers for each item by GLSL's `body`, of which `given(k)` is the item's k-th four numbers.
 * @param device as of `device`
 * @param body of a function that returns a vec4
 * @param inputs base64 of float32 (items, fours, 4)
 */
export async function evaluate({ gl }, { includes, defines, body, inputs, fours, uniforms = {} }) {
  const numbers = unpacked(inputs, Float32Array), items = numbers.length / 4 / fours;
  const texture = makeTexture(gl, "RGBA32F", [fours, items]), found = makeTexture(gl, "RGBA32F", [1, items]);
  fillTexture(gl, texture, numbers);
  const text = `${includes.map((name) => `#include "${name}"`).join("\n")}
    uniform highp sampler2D inputs; out vec4 found;
    vec4 given(int k) { return texelFetch(inputs, ivec2(k, int(gl_FragCoord.y)), 0); }
    vec4 body() { ${body} }
    void main() { found = body(); }`;
  const program = await compile(gl, await joined("test", async (name) => (name === "test" ? text : readShader(name))), defines);
  const target = drawInto(gl, found);
  gl.viewport(0, 0, 1, items);
  run(gl, program, { inputs: texture, ...uniforms });
  const out = new Float32Array(4 * items);
  gl.readPixels(0, 0, 1, items, gl.RGBA, gl.FLOAT, out);
  const trouble = gl.getError();
  if (trouble) throw new Error(`WebGL says ${trouble}`);
  return packed(out);
}

/** A Card with a scene whose document and slabs are files of the tests' server, and whose light is, too. */
export async function loaded({ document: name, slabs, answers = [] }, [width, height]) {
  const { Card } = await import("/web/card/card.js");
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [width, height];
  const card = Card.open(canvas, window.spoiled);
  const given = await (await fetch(`/data/${name}`)).json();
  await card.load(given, await Promise.all(slabs.map(bytes)));
  for (const { file, turn } of answers) card.take(await bytes(file), turn);
  return card;
}

/** The linear light of a view, in full size: that of its first sample, or of all of them. */
export async function pictureOf(card, view, { rest = false } = {}) {
  const size = [card.canvas.width, card.canvas.height];
  while (card.pace.busy || !card.drawing.isReady(view)) await new Promise((done) => setTimeout(done, 5));
  card.pace.share = 1;
  card.draw(view);
  while (rest && card.refine()) await new Promise((done) => setTimeout(done, 5));
  return packed(readFloats(card.device.gl, card.drawing.picture.targets[rest ? 1 : 0], ...size));
}
