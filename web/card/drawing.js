/**
 * A scene on a card: its volume, texels and programs, and the pictures that these make. All of it
 * goes with the context.
 */

import { codeOf, facesOf } from "./document.js";
import { turnLight } from "./light.js";
import { Picture, discOf, jitterOf } from "./picture.js";
import { compile, joined, run } from "./programs.js";
import { raysOf, windowOf } from "./rays.js";
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
 * @property {import("./light.js").Quaternion} light the light's turn in the world
 * @property {number} exposure
 * @property {import("./document.js").Vec3} [albedo] as a multiple of the document's: what is shown
 *   is then predicted
 * @property {import("./document.js").Vec3} ground linear light behind the surface
 * @property {readonly import("./rays.js").Plane[]} [window] what planes take away for the eye, in
 *   the world; 12 at most
 * @property {boolean} [marked] whether what lacks light of its texels is hatched
 * @property {boolean} [lambert] whether the local model is drawn in place of the light of texels
 */

/**
 * Distances between the neighbours that light which converges is filtered by, pass by pass; an even
 * number of passes.
 */
const FILTER_DISTANCES = [1, 2];

/** Names the turn of a light. @param {import("./light.js").Quaternion} light @returns {string} */
export const keyOf = (light) => light.map((x) => x.toFixed(9)).join(" ");

/**
 * The programs that draw a scene, once the driver has compiled them; that of the local model once
 * it is asked for.
 * @param {WebGL2RenderingContext} gl
 * @param {CardDocument} document
 * @param {(name: string) => Promise<string>} read text of a shader's file
 * @returns {Promise<{lit: Program, fold: Program, filter: Program, show: Program, makeLocal: () =>
 *   Promise<Program>}>}
 */
export async function programsOf(gl, { grid, volume, plan, light }, read) {
  const sampler = volume.type === "float32" ? "highp sampler3D" : "highp usampler3D";
  const common = {
    VOXELS: sampler,
    SMOOTH: Number(grid.smooth),
    RATIOS: Number(plan.ratios),
    LOBES: light.lobes.length,
  };
  const numbers = {
    NUMBERS: plan.channels * plan.columns,
    COLUMNS: plan.columns,
    TERMS: light.terms.length,
    STRAIGHT: plan.straight,
    WHOLE: Number(plan.whole),
  };
  const [view, fold, filter, show] = await Promise.all(
    ["view", "fold", "filter", "show"].map((name) => joined(`${name}.frag.glsl`, read)),
  );
  const compiled = [
    compile(gl, view, { ...common, SHADING: 1 }),
    compile(gl, fold, { ...common, ...numbers }),
    compile(gl, filter, common),
    compile(gl, show),
  ];
  const [lit, folding, filtering, showing] = await Promise.all(compiled);
  return {
    lit,
    fold: folding,
    filter: filtering,
    show: showing,
    makeLocal: () => compile(gl, view, { ...common, SHADING: 0, LOBES: 0 }),
  };
}

/** What is drawn of a scene. */
export class Drawing {
  /**
   * @param {import("./device.js").Device} device
   * @param {CardDocument} document
   * @param {import("./volume.js").Volume} volume
   * @param {import("./texels.js").Texels} texels
   * @param {Awaited<ReturnType<typeof programsOf>>} programs
   */
  constructor({ gl }, document, volume, texels, programs) {
    this.gl = gl;
    this.document = document;
    this.volume = volume;
    this.texels = texels;
    this.programs = programs;
    this.turned = makeTexture(gl, "RGBA32F", [document.plan.channels * document.plan.columns, 1]);
    /** @type {Picture|null} */
    this.picture = null;
    /** @type {{key: string, light: import("./light.js").TurnedLight}|null} */
    this.light = null;
    this.folded = "";
    /** @type {Program|null} */
    this.local = null;
    this.compiling = false;
  }

  /**
   * Whether a view can be drawn; else its program is compiled meanwhile.
   * @param {View} view
   * @returns {boolean}
   */
  isReady({ lambert }) {
    if (!lambert || this.local) return true;
    if (!this.compiling)
      this.programs.makeLocal().then((program) => {
        this.local = program;
      });
    this.compiling = true;
    return false;
  }

  /** Have the texels folded once more before the next picture: some are new. */
  refold() {
    this.folded = "";
  }

  /** Give the card's memory back: another scene is drawn. */
  release() {
    const { gl, volume, texels, programs } = this;
    this.picture?.release();
    for (const { id } of [this.turned, ...volume.textures, ...texels.textures])
      gl.deleteTexture(id);
    for (const program of [programs.lit, programs.fold, programs.filter, programs.show, this.local])
      if (program) gl.deleteProgram(program.id);
  }

  /**
   * Draw sample n of a view into the picture: the first one replaces it, and the others join its
   * mean. It may come in bands, from below to the top.
   * @param {View} view
   * @param {Size} size pixels
   * @param {number} n
   * @param {import("./picture.js").Band} [band] of it
   */
  sample(view, size, n, band = [0, size[1]]) {
    const { document } = this;
    const light = this.#turn(view.light);
    const records = this.#fold(light, keyOf(view.light));
    const picture = this.#pictureOf(size);
    picture.begin(n, size, band);
    run(this.gl, (view.lambert && this.local) || this.programs.lit, {
      ...this.volume.at(codeOf(document, view.isovalue)),
      ...raysOf(document.grid, view.camera, size[0], size[1]),
      ...lightOf(document, light),
      ...latticeOf(document),
      albedo: view.albedo ?? [1, 1, 1],
      ...sightOf(document, view.window ?? []),
      bricks: this.texels.bricks,
      records,
      ...filmOf(document, view.exposure),
      first: n === 0 ? picture.mean : picture.first, // no card reads what it draws into
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
   * @param {Size} size pixels that are drawn of it
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

  /** The light as it is turned now. @param {import("./light.js").Quaternion} rotation */
  #turn(rotation) {
    const key = keyOf(rotation);
    if (this.light?.key !== key) this.light = { key, light: turnLight(this.document, rotation) };
    return this.light.light;
  }

  /**
   * The records under a light: as the server folded them where it was all by that, else folded
   * here.
   * @param {import("./light.js").TurnedLight} light
   * @param {string} key
   * @returns {Texture}
   */
  #fold(light, key) {
    const { texels } = this;
    if (texels.runs.every((each) => each.lightKey === key)) return texels.records;
    if (this.folded !== key) {
      this.#foldRuns(light);
      if (texels.grainy)
        FILTER_DISTANCES.forEach((apart, pass) =>
          this.#filter(light, apart, texels.turned[pass % 2], texels.turned[1 - (pass % 2)]),
        );
    }
    this.folded = key;
    return texels.turned[0].records;
  }

  /** @param {import("./light.js").TurnedLight} light */
  #foldRuns({ columns, quadric }) {
    const { gl, texels, document } = this;
    const { least, terms } = document.light;
    const { channels } = document.plan;
    const green = Math.min(channels - 1, 1);
    const met = (/** @type {number} */ c) =>
      columns.map(([r, g, b, square]) => [
        ...[r, g, b].map((x, i) => (channels === 1 || i === c ? x : 0)),
        c === green ? square : 0,
      ]);
    fillTexture(
      gl,
      this.turned,
      new Float32Array(Array.from({ length: channels }, (_, c) => met(c)).flat(2)),
    );
    const firsts = terms.map(
      (_, k) =>
        green * columns.length + terms.slice(0, k).reduce((sum, { order }) => sum + order ** 2, 0),
    );
    const [{ records, noise }] = texels.turned;
    const framebuffer = drawInto(gl, records, noise);
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
   * Filter folded light by neighbours that are so many texels `apart`.
   * @param {import("./light.js").TurnedLight} light
   * @param {number} apart
   * @param {import("./texels.js").Folded} from
   * @param {import("./texels.js").Folded} to
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

  /** The picture, as large as this at least. @param {Size} size @returns {Picture} */
  #pictureOf(size) {
    if (this.picture?.holds(size)) return this.picture;
    this.picture?.release();
    this.picture = new Picture(this.gl, size);
    return this.picture;
  }
}

/**
 * Uniforms of the light.
 * @param {CardDocument} document
 * @param {import("./light.js").TurnedLight} light
 */
function lightOf({ light, lambert, plan, grid }, { quadric, towards, edges }) {
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
    ...lambert,
  };
}

/**
 * Uniforms of a window.
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

/** Uniforms of the lattice. @param {CardDocument} document */
function latticeOf({ lattice }) {
  return { lattice: lattice.size, density: lattice.density };
}

/** Uniforms of the film. @param {CardDocument} document @param {number} exposure */
function filmOf({ tone }, exposure) {
  return { curve: [tone.gain, tone.toe, tone.shoulder], exposure };
}
