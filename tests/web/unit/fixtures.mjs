/** A scene, a clock and a page for modules that are tested without a browser. */

import assert from "node:assert/strict";

/** Asserts that two rows of numbers are one within so much. */
export function close(actual, expected, within = 1e-12) {
  assert.equal(actual.length, expected.length);
  actual.forEach((x, i) => assert.ok(Math.abs(x - expected[i]) <= within, `[${actual}] is not [${expected}]`));
}

/** A scene of 11 × 21 × 31 voxels, 10 × 10 × 10 world units between the outermost, whose light turns. */
export const SCENE = {
  id: "small", name: "Small", solid: "above", rotating: true, turns: true, target_error: 0.02,
  volume: { name: "small", size: [11, 21, 31], spacing: [1, 0.5, 1 / 3], affine: [[1, 0, 0, 0], [0, 0.5, 0, 0], [0, 0, 1 / 3, 0]], dtype: "uint8", value_range: [0, 255], holes: 0, unit: "", letters: "", axes: "", bounds: [[0, 0, 0], [10, 10, 10]], notes: [] },
  defaults: {
    isovalue: 70, azimuth: 30, elevation: 20, distance: 3, fov: 30, yaw: 0, pitch: 0, roll: 0, exposure: 1.234567,
    shading: "gi", width: 512, height: 512,
  },
  start: { azimuth: 30, elevation: 20, distance: 3, target: null },
  ranges: { isovalue: { min: 40, max: 240 }, azimuth: { min: -360, max: 360 }, distance: { min: 0.01, max: 1000 } },
  shadings: ["gi", "lambert", "phong"],
  presets: [], stops: [45, 60, 80, 200], stops_note: "", shines: [], cuts: true, lights: [{ type: "sky", name: "sky" }],
  albedo: [0.7, 0.7, 0.7], albedos: null, colours: null, surfaces: [], clear: 0, transmission: [0, 0, 0],
  material: "diffuse", materials: [],
  histogram: { counts: [0, 9, 99], edges: [0, 85, 170, 255] },
};

/** The same scene, where views may ask for any albedo from 0 to 0.9. */
export const PAINTED = { ...SCENE, albedos: { min: 0, max: 0.9 }, ranges: { ...SCENE.ranges, albedo: { min: 0, max: 0.9 } } };

/** The same scene, which shines as plastic. */
export const POLISHED = {
  ...SCENE, shines: ["plastic", "metal"], defaults: { ...SCENE.defaults, shine: "plastic", roughness: 0.3, strength: 1 },
  ranges: { ...SCENE.ranges, roughness: { min: 0.02, max: 1 }, strength: { min: 0, max: 1 } },
};

/** A view of SCENE, with other knobs where they are given. */
export function knobs(values = {}) {
  const { width, height, ...numbers } = SCENE.defaults;
  return { ...numbers, target: null, overlay: "none", compare: "", background: "page", projection: "perspective", rulers: "on", measures: [], notes: {}, slices: null, planes: "", opened: true, surfaces: "", hide: "", material: "", ...values };
}

/** A clock that stands still until it is told to pass; timers run in the order of their times. */
export class FakeClock {
  time = 0;
  timers = new Map();
  #count = 0;
  now = () => this.time;
  cancel = (timer) => this.timers.delete(timer);
  after = (milliseconds, run) => {
    this.timers.set(++this.#count, { at: this.time + milliseconds, run });
    return this.#count;
  };

  /** Milliseconds until each timer that is set, the earliest first. */
  get waits() {
    return [...this.timers.values()].map(({ at }) => at - this.time).sort((a, b) => a - b);
  }

  /** Let time pass, with all that is due in it. */
  async pass(milliseconds) {
    const end = this.time + milliseconds;
    for (;;) {
      const [due] = [...this.timers].filter(([, { at }]) => at <= end).sort(([, a], [, b]) => a.at - b.at);
      if (!due) break;
      this.timers.delete(due[0]);
      this.time = Math.max(this.time, due[1].at);
      due[1].run();
      await settled();
    }
    this.time = Math.max(this.time, end);
  }
}

/** Returns once all promises that can be kept are kept. */
export function settled() {
  return new Promise((resolve) => setImmediate(resolve));
}

/** What a frame says about itself, with other facts where they are given. */
export function facts(values = {}) {
  return {
    provisional: true, surface: 800, coverage: { final: 0.5, converging: 0.25, provisional: 0.25 }, error: 0.034,
    chunks: { needed: 240, final: 182 }, timeLeft: null, timing: {}, ...values,
  };
}
