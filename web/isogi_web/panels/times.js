/** The time of each stage of a frame, and the rate of drafts while the view moves. */

import { find, textElement } from "../dom.js";
import { millisecondsInWords } from "../view/format.js";

const SPAN_MS = 2000; // time over which drafts are counted

/** Names of stages. @type {Record<string, string>} */
const STAGES = {
  queue: "Waiting for a thread",
  demand: "Asking for light",
  bake: "Waiting for light",
  primary: "Camera’s rays",
  texels: "Finding texels",
  load: "Light from the store",
  read: "Looking texels up",
  light: "Turning the light",
  shade: "Shading",
  normals: "Normals",
  paths: "Paths",
  edges: "Smooth edges",
  encode: "Making the file",
};

/** A folded list of times. */
export class Times {
  #root;
  /** @type {number[]} */
  #drafts = [];
  /** @type {Record<string, number>} */
  #timing = {};

  /** @param {HTMLDetailsElement} root holds a `.value` and a `dl` */
  constructor(root) {
    this.#root = root;
    root.addEventListener("toggle", () => this.#list());
  }

  /**
   * Show the times of a frame.
   * @param {import("../net/schemas.js").Facts} facts
   * @param {boolean} draft true if the view is moving
   */
  show({ timing }, draft) {
    const now = performance.now();
    if (draft) this.#drafts = [...this.#drafts, now].filter((time) => now - time < SPAN_MS);
    this.#timing = timing;
    const all = millisecondsInWords(total(timing));
    find(this.#root, ".value").textContent =
      `${all}${draft ? `, ${rateOf(this.#drafts)} a second` : ""}`;
    this.#list();
  }

  /** Fill the list if it is unfolded. */
  #list() {
    if (!this.#root.open) return;
    const rows = timeRows(this.#timing, rateOf(this.#drafts));
    find(this.#root, "dl").replaceChildren(
      ...rows.flatMap(([name, text]) => [textElement("dt", name), textElement("dd", text)]),
    );
  }
}

/**
 * Return the rows of the list: each stage, their sum, and the rate of drafts.
 * @param {Record<string, number>} timing milliseconds of each stage
 * @param {number} rate drafts per second
 * @returns {[string, string|number][]}
 */
export function timeRows(timing, rate) {
  /** @type {(stage: [string, number]) => [string, string]} */
  const row = ([stage, ms]) => [STAGES[stage] ?? stage, millisecondsInWords(ms)];
  const all = millisecondsInWords(total(timing));
  return [
    ...Object.entries(timing).map(row),
    ["All", all],
    ["Drafts a second, last moved", rate || "–"],
  ];
}

/**
 * Return the rate of frames per second, rounded; 0 for fewer than two.
 * @param {number[]} times milliseconds, in order
 * @returns {number}
 */
export function rateOf(times) {
  const [first = 0, last = 0] = [times[0], times.at(-1)];
  return last > first ? Math.round((1000 * (times.length - 1)) / (last - first)) : 0;
}

/** Return the sum of all stages. @param {Record<string, number>} timing */
function total(timing) {
  return Object.values(timing).reduce((sum, ms) => sum + ms, 0);
}
