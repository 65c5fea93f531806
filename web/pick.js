/** The point under the pointer: a double click brings it to the middle of the picture. */

import { readFrame, Trouble } from "./api.js";
import { rayThrough } from "./camera.js";

const PIXEL = { f: "npy", shading: "lambert", width: 1, height: 1 };
const PIXEL_BYTES = 36; // nine floats: three of light, hit, state, error, three of position
const [HIT, POSITION] = [12, 24]; // bytes from the pixel's first

/**
 * Listen to double clicks on the stage; where no surface is hit, nothing moves.
 * @param {HTMLElement} stage
 * @param {object} scene answer of `readScene`
 * @param {import("./view.js").ViewModel} view
 */
export function attachPick(stage, scene, view) {
  stage.addEventListener("dblclick", async (event) => {
    if (event.target.closest("#trouble")) return;
    const box = stage.getBoundingClientRect();
    const right = (event.clientX - box.left - box.width / 2) / box.height;
    const up = (box.top + box.height / 2 - event.clientY) / box.height;
    const target = await surfacePoint(scene, view.values, right, up);
    if (target) view.set({ target });
  });
}

/** World position of the surface at a place of the picture; null where there is none, or no answer. */
async function surfacePoint(scene, values, right, up) {
  const ray = Object.entries(rayThrough(scene, values, right, up)).map(([name, point]) => [name, point.join(",")]);
  const query = { ...PIXEL, isovalue: values.isovalue, ...Object.fromEntries(ray) };
  try {
    const bytes = await (await readFrame(scene.id, query)).blob.arrayBuffer();
    const pixel = new DataView(bytes, bytes.byteLength - PIXEL_BYTES);
    return pixel.getFloat32(HIT, true) > 0 ? [0, 4, 8].map((i) => pixel.getFloat32(POSITION + i, true)) : null;
  } catch (error) {
    if (error instanceof Trouble) return null; // the picture's own requests say what is wrong
    throw error;
  }
}
