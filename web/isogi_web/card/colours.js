/** Colours by data on the card: codes of values or labels, and the albedo of each code. */

import { Refusal } from "./device.js";
import { fillTexture, makeTexture } from "./textures.js";

/** @typedef {import("./document.js").CardDocument} CardDocument */
/** @typedef {import("./textures.js").Texture} Texture */

const FORMATS = /** @type {const} */ ({ values: "R8UI", labels: "RGB8UI" });
const CODES = 256; // rows of the table of albedos

/**
 * Join the slabs of colours along z.
 * @param {CardDocument} document
 * @param {ArrayBuffer[]} slabs bytes of each slab, in the order of `slabsOf`
 * @returns {Uint8Array} codes, x fastest, then y; empty if the scene has no colours by data
 */
export function joinColours({ volume, colours }, slabs) {
  if (!colours) return new Uint8Array(0);
  const places = new Uint8Array(colours.bytes);
  const layer = colours.bytes / colours.size[2];
  colours.slabs.forEach(({ first }, i) =>
    places.set(new Uint8Array(slabs[volume.slabs.length + i]), first * layer),
  );
  return places;
}

/** The colours of a scene on a card; without textures if it has none. */
export class Colours {
  /**
   * @param {import("./device.js").Device} device
   * @param {CardDocument} document
   * @param {Uint8Array} places see `joinColours`
   * @throws {Refusal} if there are more places than the card's textures take
   */
  constructor({ gl, most3d }, { colours }, places) {
    this.source = places;
    /** @type {Texture[]} */
    this.textures = [];
    /** @type {Record<string, import("./programs.js").Value>} */
    this.uniforms = {};
    if (!colours) return;
    if (Math.max(...colours.size) > most3d) {
      throw new Refusal(
        `The colours have ${Math.max(...colours.size)} places along a side, and the graphics card takes ${most3d}: the server draws.`,
      );
    }
    const codes = makeTexture(gl, FORMATS[colours.kind], colours.size);
    fillTexture(gl, codes, places);
    // Codes beyond the document's table have the albedo of code 0.
    const albedos = makeTexture(gl, "RGBA32F", [CODES, 1]);
    const rows = Array.from({ length: CODES }, (_, i) => colours.table[i] ?? colours.table[0]);
    fillTexture(gl, albedos, new Float32Array(rows.flatMap((row) => [...row, 0])));
    this.textures = [codes, albedos];
    this.uniforms = {
      codes,
      albedos,
      places: colours.size,
      step_between: colours.step,
      brightest: colours.brightest.map((share) => Math.max(share, 1e-30)),
    };
  }
}
