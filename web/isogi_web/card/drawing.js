/**
 * A scene on a card: its volume, texels and programs, and the pictures drawn with them. All of it
 * is lost with the WebGL context.
 */

import { facesOf } from "./document.js";
import { turnLight } from "./light.js";
import { Picture, discOf, jitterOf } from "./picture.js";
import { compile, joined, run } from "./programs.js";
import { depthsOf, raysOf, shoulderLight, windowOf } from "./rays.js";
import { codesOf, definesOf, uniformsOf } from "./surfaces.js";
import { isRaw } from "./texels.js";
import { drawInto, fillTexture, makeTexture } from "./textures.js";

/** @typedef {import("./document.js").CardDocument} CardDocument */
/** @typedef {import("./programs.js").Program} Program */
/** @typedef {import("./textures.js").Texture} Texture */
/** @typedef {import("./picture.js").Size} Size */

/**
 * @typedef {object} View
 * @property {number} isovalue in the file's units
 * @property {import("./rays.js").Camera} camera in the world
 * @property {import("./light.js").Quaternion} light rotation of the light in the world
 * @property {number} exposure
 * @property {import("./document.js").Vec3} [albedo] as a multiple of the document's albedo; the
 *   picture then predicts the light under this albedo, to first order
 * @property {import("./document.js").Vec3} ground linear light behind the surface
 * @property {readonly import("./rays.js").Plane[]} [window] planes that hide matter from the eye,
 *   in the world; 12 at most
 * @property {boolean} [marked] true if pixels whose texels have no light are hatched
 * @property {import("./shine.js").Lobe} [shine] lobe of a surface that shines, by default that of
 *   the document
 * @property {string} [shading] a local model that is drawn in place of the light of texels, which
 *   is `gi`
 */

/**
 * Distance between the neighbours that the filter averages, in texels, pass by pass. The number of
 * passes must be even: the last pass writes the textures that the first one read.
 */
const FILTER_DISTANCES = [1, 2];

/** Numbers of the kinds of colours by data, as `COLOURS` in colours.glsl has them. */
const COLOURS = { values: 1, labels: 2 };

/**
 * Name a rotation of the light; rotations that differ by less than rounding have one name.
 * @param {import("./light.js").Quaternion} light
 * @returns {string}
 */
export const keyOf = (light) => light.map((x) => x.toFixed(9)).join(" ");

/**
 * Compile the programs that draw a scene, and return them once the driver is done. Programs of
 * local models are compiled by `makeLocal`, as few visitors ask for them.
 * @param {WebGL2RenderingContext} gl
 * @param {CardDocument} document
 * @param {(name: string) => Promise<string>} read returns the text of a shader's file
 * @returns {Promise<{lit: Program, fold: Program, filter: Program, show: Program, energy:
 *   Program|null, makeLocal: (shading: string) => Promise<Program>}>} `energy` is that of lobes, if
 *   the scene shines
 * @throws {Error} if the card refuses a shader
 */
export async function programsOf(gl, document, read) {
  const { grid, volume, colours, plan, light } = document;
  // Constants of a scene are compiled into its programs, so that shaders skip what the scene lacks.
  const sampler = volume.type === "float32" ? "highp sampler3D" : "highp usampler3D";
  const common = {
    VOXELS: sampler,
    SMOOTH: Number(grid.smooth),
    RATIOS: Number(plan.ratios),
    LOBES: light.lobes.length,
    COLOURS: colours ? COLOURS[colours.kind] : 0,
  };
  const numbers = {
    NUMBERS: plan.channels * plan.columns,
    COLUMNS: plan.columns,
    TERMS: light.terms.length,
    STRAIGHT: plan.straight,
    WHOLE: Number(plan.whole),
  };
  const several = definesOf(document);
  const [view, fold, filter, show, energy] = await Promise.all(
    ["view", "fold", "filter", "show", "energy"].map((name) => joined(`${name}.frag.glsl`, read)),
  );
  const compiled = [
    compile(gl, view, {
      ...common,
      ...several,
      SHADING: 1,
      SHINE: Number(Boolean(document.shine)),
    }),
    compile(gl, fold, { ...common, ...numbers }),
    compile(gl, filter, common),
    compile(gl, show, several),
  ];
  const [[lit, folding, filtering, showing], measuring] = await Promise.all([
    Promise.all(compiled),
    document.shine ? compile(gl, energy) : null,
  ]);
  return {
    lit,
    fold: folding,
    filter: filtering,
    show: showing,
    energy: measuring,
    makeLocal: (shading) =>
      compile(gl, view, {
        ...common,
        ...several,
        SHADING: 0,
        LOBES: 0,
        SHINE: 0,
        SHADOW: Number(shading.endsWith("_shadow")),
        FOG: Number(shading.endsWith("_fog")),
        HIGHLIGHT: Number(shading.startsWith("phong")),
      }),
  };
}

/** Draws views of a scene, sample by sample, and folds the light of its texels. */
export class Drawing {
  /**
   * @param {import("./device.js").Device} device
   * @param {CardDocument} document
   * @param {object} parts
   * @param {import("./volume.js").Volume} parts.volume
   * @param {import("./colours.js").Colours} parts.colours
   * @param {import("./shine.js").Shine} parts.shine
   * @param {import("./texels.js").Texels} parts.texels
   * @param {Awaited<ReturnType<typeof programsOf>>} parts.programs
   */
  constructor({ gl }, document, { volume, colours, shine, texels, programs }) {
    this.gl = gl;
    this.document = document;
    this.volume = volume;
    this.colours = colours;
    this.shine = shine;
    this.texels = texels;
    this.programs = programs;
    this.turned = makeTexture(gl, "RGBA32F", [document.plan.channels * document.plan.columns, 1]);
    /** @type {Picture|null} */
    this.picture = null;
    /** @type {{key: string, light: import("./light.js").TurnedLight}|null} */
    this.light = null;
    this.folded = "";
    /**
     * Programs of local models by their shading; null while one is compiled.
     * @type {Map<string, Program|null>}
     */
    this.local = new Map();
    /** Shadings whose programs the card does not compile. @type {Set<string>} */
    this.refused = new Set();
  }

  /**
   * Return true if a view can be drawn; otherwise begin to compile its program.
   * @param {View} view
   * @returns {boolean}
   */
  isReady({ shading = "gi" }) {
    if (shading === "gi" || this.local.get(shading)) return true;
    if (this.local.has(shading)) return false;
    this.local.set(shading, null);
    this.programs.makeLocal(shading).then(
      (program) => this.local.set(shading, program),
      (error) => {
        console.warn(`The graphics card compiles no shading ${shading}:`, error);
        this.refused.add(shading);
      },
    );
    return false;
  }

  /** Request that the texels are folded again before the next picture, as some are new. */
  refold() {
    this.folded = "";
  }

  /** Free the card's memory. */
  release() {
    const { gl, volume, colours, shine, texels, programs } = this;
    this.picture?.release();
    const parts = [volume, colours, shine, texels];
    const textures = parts.flatMap((part) => part.textures);
    for (const { id } of [this.turned, ...textures]) gl.deleteTexture(id);
    const { lit, fold, filter, show, energy } = programs;
    for (const program of [lit, fold, filter, show, energy, ...this.local.values()])
      if (program) gl.deleteProgram(program.id);
  }

  /**
   * Draw sample n of a view into the picture: sample 0 replaces the picture, others join its mean.
   * A sample may come in bands of rows, from below.
   * @param {View} view
   * @param {Size} size pixels
   * @param {number} n number of the sample
   * @param {import("./picture.js").Band} [band] rows to draw, all by default
   */
  sample(view, size, n, band = [0, size[1]]) {
    const { document } = this;
    const light = this.#turn(view.light);
    const local = this.local.get(view.shading ?? "gi");
    // Local models read no texels: their light stays as it is.
    const records = local ? this.texels.records : this.#fold(light, keyOf(view.light));
    const shine = local ? {} : this.shine.at(this.programs.energy, view.shine, light, n);
    const picture = this.#pictureOf(size);
    picture.begin(n, size, band);
    run(this.gl, local ?? this.programs.lit, {
      ...this.volume.at(...codesOf(document, view.isovalue)),
      ...uniformsOf(document, view.isovalue, { tops: this.volume.tops, bricks: this.texels.bricks }),
      ...this.colours.uniforms,
      ...raysOf(document.grid, view.camera, size[0], size[1]),
      ...lightOf(document, light),
      ...(local && modelOf(document, light, view.camera)),
      ...latticeOf(document),
      albedo: view.albedo ?? [1, 1, 1],
      ...sightOf(document, view.window ?? []),
      ...shine,
      bricks: this.texels.bricks,
      coarse: Number(this.texels.coarse),
      records,
      ...filmOf(document, view.exposure),
      first: n === 0 ? picture.mean : picture.first, // WebGL forbids reading the draw target
      drawn: size,
      again: Number(n > 0),
      marked: Number(view.marked ?? false),
      jitter: jitterOf(n),
      place: discOf(n),
      resting: Number(n > 0),
    });
    picture.end(n, band[1] === size[1]);
  }

  /**
   * Show the picture on the canvas.
   * @param {View} view
   * @param {Size} size pixels of the picture that are drawn
   */
  show({ exposure, ground }, size) {
    const { gl, picture } = this;
    const screen = [gl.drawingBufferWidth, gl.drawingBufferHeight];
    if (!picture) return;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, screen[0], screen[1]);
    run(gl, this.programs.show, {
      picture: picture.texture,
      drawn: size,
      screen,
      ground,
      ...filmOf(this.document, exposure),
    });
  }

  /**
   * Return the light under a rotation; the last one is kept.
   * @param {import("./light.js").Quaternion} rotation
   */
  #turn(rotation) {
    const key = keyOf(rotation);
    if (this.light?.key !== key) this.light = { key, light: turnLight(this.document, rotation) };
    return this.light.light;
  }

  /**
   * Return the records of all texels under a light: those of the server if it folded all of them by
   * this light, otherwise records that are folded on the card.
   * @param {import("./light.js").TurnedLight} light
   * @param {string} key name of the light's rotation
   * @returns {Texture}
   */
  #fold(light, key) {
    const { texels } = this;
    if (texels.runs.every((each) => each.lightKey === key)) return texels.records;
    if (this.folded !== key) {
      this.#foldRuns(light);
      // Passes alternate between two pairs of textures; the last one writes the first pair again.
      if (texels.grainy)
        FILTER_DISTANCES.forEach((apart, pass) =>
          this.#filter(light, apart, texels.turned[pass % 2], texels.turned[1 - (pass % 2)]),
        );
    }
    this.folded = key;
    return texels.turned[0].records;
  }

  /**
   * Fold all runs with a light, into the first pair of textures.
   * @param {import("./light.js").TurnedLight} light
   */
  #foldRuns({ columns, quadric }) {
    const { gl, texels, document } = this;
    const { least, terms } = document.light;
    const { channels } = document.plan;
    const green = Math.min(channels - 1, 1);
    // Each row of the uniform texture belongs to one number of the transfer: a channel's numbers
    // add to that channel alone, or to all three if light is grey. Squares, for the noise, go with
    // green, which stands for luminance.
    const rowOf = (/** @type {number} */ c) =>
      columns.map(([r, g, b, square]) => [
        ...[r, g, b].map((x, i) => (channels === 1 || i === c ? x : 0)),
        c === green ? square : 0,
      ]);
    fillTexture(
      gl,
      this.turned,
      new Float32Array(Array.from({ length: channels }, (_, c) => rowOf(c)).flat(2)),
    );
    // Number of the green channel with which each term begins, for the estimate of noise.
    const firsts = terms.map(
      (_, k) =>
        green * columns.length + terms.slice(0, k).reduce((sum, { order }) => sum + order ** 2, 0),
    );
    const [{ records, noise }] = texels.turned;
    const framebuffer = drawInto(gl, records, noise);
    // Draw one rectangle per run, as runs differ in their light and in having raw transfer.
    for (const each of texels.runs) {
      gl.viewport(0, each.row, records.size[0], each.rows);
      const raw = texels.takesRaw && isRaw(each);
      run(gl, this.programs.fold, {
        records: texels.records,
        transfer: texels.transfer,
        turned: this.turned,
        firsts,
        raw: Number(raw),
        quadric,
        quadric_then: each.quadric,
        least,
      });
    }
    gl.deleteFramebuffer(framebuffer);
  }

  /**
   * Filter folded light: average texels with neighbours that are `apart` texels away.
   * @param {import("./light.js").TurnedLight} light
   * @param {number} apart distance, texels
   * @param {import("./texels.js").Folded} from textures to read
   * @param {import("./texels.js").Folded} to textures to write
   */
  #filter({ quadric }, apart, from, to) {
    const { gl, texels, document } = this;
    const framebuffer = drawInto(gl, to.records, to.noise);
    gl.viewport(0, 0, to.records.size[0], texels.rows);
    run(gl, this.programs.filter, {
      records: from.records,
      noises: from.noise,
      places: texels.places,
      bricks: texels.bricks,
      lattice: document.lattice.size,
      apart,
      quadric,
      least: document.light.least,
    });
    gl.deleteFramebuffer(framebuffer);
  }

  /**
   * Return a picture that is at least of this size; a larger one is kept.
   * @param {Size} size
   * @returns {Picture}
   */
  #pictureOf(size) {
    if (this.picture?.holds(size)) return this.picture;
    this.picture?.release();
    this.picture = new Picture(this.gl, size);
    return this.picture;
  }
}

/**
 * Return the uniforms of a local model.
 * @param {CardDocument} document
 * @param {import("./light.js").TurnedLight} light
 * @param {import("./rays.js").Camera} camera
 */
function modelOf({ grid, model }, light, camera) {
  const key = model.follows === "camera" ? shoulderLight(grid, camera) : light.key;
  const { sun, ambient, gloss, exponent } = model;
  return { key, sun, ambient, gloss, exponent, ...depthsOf(grid, camera) };
}

/**
 * Return the uniforms of the light.
 * @param {CardDocument} document
 * @param {import("./light.js").TurnedLight} light
 */
function lightOf({ light, plan, grid }, { quadric, towards, edges }) {
  const least = plan.ratios ? light.least : [0, 0, 0];
  const [east, north] = [0, 1].map((i) => edges.flatMap((edge) => edge[i]));
  return {
    quadric,
    least,
    unit: light.unit,
    towards: towards.flat(),
    east,
    north,
    shine: light.lobes.flatMap((lobe) => lobe.shine),
    offset: grid.offset,
  };
}

/**
 * Return the uniforms of a window.
 * @param {CardDocument} document
 * @param {readonly import("./rays.js").Plane[]} planes
 */
function sightOf(document, planes) {
  return {
    planes: planes.length,
    window: planes.length ? windowOf(document.grid, planes) : [0, 0, 0, 1],
    ...facesOf(document),
  };
}

/** Return the uniforms of the lattice. @param {CardDocument} document */
function latticeOf({ lattice }) {
  return { lattice: lattice.size, density: lattice.density };
}

/**
 * Return the uniforms of exposure and tone curve.
 * @param {CardDocument} document
 * @param {number} exposure
 */
function filmOf({ tone }, exposure) {
  return { curve: [tone.gain, tone.toe, tone.shoulder], exposure };
}
