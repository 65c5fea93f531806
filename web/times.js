/** What a frame took, stage by stage, and how many came a second while the view moved. */

const SPAN_MS = 2000; // of which drafts are counted
const STAGES = {
  queue: "Waiting for a thread", demand: "Asking for light", bake: "Waiting for light", primary: "Camera’s rays",
  texels: "Finding texels", load: "Light from the store", read: "Looking texels up", light: "Turning the light",
  shade: "Shading", normals: "Normals", paths: "Paths", encode: "Making the file",
};

/** A folded list of times. */
export class Times {
  #root;
  #drafts = [];
  #timing = {};

  /** @param {HTMLDetailsElement} root holds a `.value` and a `dl` */
  constructor(root) {
    this.#root = root;
    root.addEventListener("toggle", () => this.#list());
  }

  /**
   * Show the times of a frame.
   * @param {import("./api.js").Facts} facts
   * @param {boolean} draft whether the view is moving
   */
  show({ timing }, draft) {
    const now = performance.now();
    if (draft) this.#drafts = [...this.#drafts, now].filter((time) => now - time < SPAN_MS);
    this.#timing = timing;
    this.#root.querySelector(".value").textContent = `${inMilliseconds(total(timing))}${draft ? `, ${this.#rate} a second` : ""}`;
    this.#list();
  }

  /** Drafts a second, of the last of them. */
  get #rate() {
    const [first, last] = [this.#drafts[0], this.#drafts.at(-1)];
    return last > first ? Math.round((1000 * (this.#drafts.length - 1)) / (last - first)) : 0;
  }

  #list() {
    if (!this.#root.open) return;
    const stages = Object.entries(this.#timing).map(([stage, ms]) => [STAGES[stage] ?? stage, inMilliseconds(ms)]);
    const rows = [...stages, ["All", inMilliseconds(total(this.#timing))], ["Drafts a second, last moved", this.#rate || "–"]];
    this.#root.querySelector("dl").replaceChildren(...rows.flatMap(([name, text]) => [node("dt", name), node("dd", text)]));
  }
}

function total(timing) {
  return Object.values(timing).reduce((sum, ms) => sum + ms, 0);
}

function inMilliseconds(ms) {
  return `${ms < 10 ? ms.toFixed(1) : Math.round(ms)} ms`;
}

function node(tag, text) {
  return Object.assign(document.createElement(tag), { textContent: text });
}
