/**
 * Readings from the picture: clicks show a point, or measure between points; the list of measures;
 * and the size of the surface.
 */

import { find, textElement } from "../dom.js";
import { retryDelay } from "../net/trouble.js";
import {
  MOST,
  NOTE_LETTERS,
  knownInWords,
  measureInWords,
  writeMeasure,
} from "../view/measures.js";

/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {import("../documents.js").Size} Size */
/** @typedef {import("../view/model.js").Knobs} Knobs */
/** @typedef {import("../view/marks.js").Marks} Marks */
/** @typedef {import("../view/marks.js").FindSurface} FindSurface */
/** @typedef {import("../view/measures.js").Measure} Measure */
/** @typedef {import("../view/model.js").ViewModel} ViewModel */
/** @typedef {import("../view/rotation.js").Vec3} Vec3 */
/** @typedef {import("./point.js").PointCard} PointCard */

const FULL = `A link holds ${MOST} measures: remove one first.`;
const EMPTY = "There is no surface in the middle of the picture.";
const MISSED = "There is no surface: click another place.";
/** Hints of a measure, by the number of its points. */
const ASKED = [
  "Click the first point.",
  "Click the second point.",
  "Click a third point for an angle, or stop.",
];

/** Handles clicks on the picture. */
export class Reading {
  #card;
  #marks;
  #view;
  #pick;
  #say;
  #hint;
  /** @type {Vec3[]|null} */
  #measured = null; // points of the measure that is being made; null if clicks show points

  /**
   * @param {HTMLElement} hint says where to click, and holds a button that stops measuring
   * @param {PointCard} card
   * @param {Marks} marks
   * @param {ViewModel} view
   * @param {FindSurface} pick
   * @param {(words: string) => void} say
   */
  constructor(hint, card, marks, view, pick, say) {
    this.#hint = hint;
    this.#card = card;
    this.#marks = marks;
    this.#view = view;
    this.#pick = pick;
    this.#say = say;
    find(hint, "button").addEventListener("click", () => this.stop());
    card.onChange = () => this.#show();
    view.watch(
      ({ isovalue }) => isovalue,
      () => card.close(),
    );
    view.watch(
      ({ measures }) => measures,
      () => this.#show(),
    );
    this.#show();
  }

  /**
   * Show the point at a place of the picture, or add it to the measure.
   * @param {number} right distance to the right of the middle, heights of the picture
   * @param {number} up distance above the middle, heights of the picture
   */
  async click(right, up) {
    if (!this.#measured) {
      await this.#card.open(right, up); // closes the card if there is no surface
      return;
    }
    const point = await this.#pick(this.#view.values, right, up);
    if (!point) this.#say(MISSED);
    else if (this.#measured) this.#add(this.#measured, point);
  }

  /**
   * Do the same as a click in the middle of the picture, for the keyboard; say so if there is no
   * surface.
   */
  async middle() {
    if (this.#measured) await this.click(0, 0);
    else if (!(await this.#card.open(0, 0))) this.#say(EMPTY);
  }

  /** Begin to measure, from the point that is shown if there is one; or stop measuring. */
  measure() {
    if (this.#measured) return this.stop();
    if (this.#view.values.measures.length >= MOST) return this.#say(FULL);
    this.#measured = this.#card.point ? [this.#card.point] : [];
    this.#card.close();
  }

  /** Stop measuring, and hide the card. Measures are kept. */
  stop() {
    this.#measured = null;
    this.#card.close();
  }

  /**
   * Add a point to the measure.
   * @param {Vec3[]} measured points so far
   * @param {Vec3} point
   */
  #add(measured, point) {
    const points = [...measured, point];
    // A third point turns the last distance into an angle.
    const others = this.#view.values.measures.slice(0, measured.length > 1 ? -1 : undefined);
    this.#measured = points.length < ASKED.length ? points : null;
    if (points.length > 1) this.#view.set({ measures: [...others, points] });
    this.#show();
  }

  /** Show hint, marks and measures. */
  #show() {
    const { measures } = this.#view.values;
    const started = this.#measured?.slice(0, 1) ?? [];
    // The measure that was being made was removed from the list.
    if (this.#measured && this.#measured.length > 1 && !measures.length) this.#measured = null;
    this.#hint.hidden = !this.#measured;
    find(this.#hint, "span").textContent = this.#measured ? ASKED[this.#measured.length] : "";
    this.#marks.show(
      [...(this.#card.point ? [this.#card.point] : []), ...started, ...measures.flat()],
      measures,
    );
  }
}

/**
 * Keep the list of measures up to date with the view.
 * @param {HTMLElement} panel holds a list; it is hidden while the list is empty
 * @param {Pick<Scene, "volume">} scene
 * @param {ViewModel} view
 */
export function attachMeasures(panel, { volume }, view) {
  const draw = () => {
    const { measures } = view.values;
    // Write the whole list, as it is short.
    panel.hidden = !measures.length;
    find(panel, "ol").replaceChildren(
      ...measures.map((points, n) => {
        const words = measureInWords(volume, points);
        const button = Object.assign(textElement("button", "×"), {
          type: "button",
          ariaLabel: `Remove ${words}`,
        });
        button.addEventListener("click", () =>
          view.set({ measures: measures.filter((_, i) => i !== n) }),
        );
        const item = textElement("li", `${points.length > 2 ? "Angle" : "Distance"} ${words}`);
        item.append(noteField(view, writeMeasure(points), words), button);
        return item;
      }),
    );
    fill();
  };
  const fill = () => {
    const { measures, notes } = view.values;
    panel.querySelectorAll("input").forEach((input, n) => {
      input.value = notes[writeMeasure(measures[n])] ?? "";
    });
  };
  view.watch(({ measures }) => measures, draw);
  view.watch(({ notes }) => notes, fill);
  draw();
}

/**
 * Make the field of the text beside a measure.
 * @param {ViewModel} view
 * @param {string} name of the measure, as `writeMeasure` returns it
 * @param {string} words that the measure shows
 */
function noteField(view, name, words) {
  const field = document.createElement("input");
  Object.assign(field, { maxLength: NOTE_LETTERS, placeholder: "Name it" });
  field.setAttribute("aria-label", `Name of ${words}`);
  field.addEventListener("change", () =>
    view.set({ notes: { ...view.values.notes, [name]: field.value } }),
  );
  return field;
}

const REST_MS = 400; // time without a change after which a surface is measured

/** Pauses before a server that is away, or busy, is asked again. */
const AGAIN_MS = [500, 1000, 2000, 4000];
const WHOLE =
  "Of the whole surface, faces of a cut too. ± is what the size of the voxels leaves open.";
const OPEN = "The solid reaches a side of the volume, and is taken to end there.";

/**
 * Keep the size of the surface up to date with the view while the panel is unfolded; the size of
 * another surface is never shown.
 * @param {HTMLDetailsElement} panel holds a `dl` and a `.note`
 * @param {Pick<Scene, "volume">} scene
 * @param {ViewModel} view
 * @param {(values: Knobs, signal: AbortSignal) => Promise<Size>} ask requests the size
 */
export function attachSize(panel, { volume }, view, ask) {
  const [list, note] = [find(panel, "dl"), find(panel, ".note")];
  let timer = 0;
  let controller = new AbortController();
  const show = (/** @type {[string, string][]} */ rows, /** @type {string} */ words) => {
    list.replaceChildren(
      ...rows.flatMap(([name, text]) => [textElement("dt", name), textElement("dd", text)]),
    );
    note.textContent = words;
  };
  const measure = async (/** @type {AbortSignal} */ signal) => {
    for (let failures = 0; ; failures += 1) {
      const found = await ask(view.values, signal).catch((/** @type {Error} */ error) => error);
      if (signal.aborted) return;
      if (!(found instanceof Error))
        return show(sizeRows(volume, found), found.is_open ? `${WHOLE} ${OPEN}` : WHOLE);
      show([], found.message);
      const delay = retryDelay(found, failures, AGAIN_MS);
      if (delay === null) return;
      await new Promise((done) => {
        setTimeout(done, delay);
      });
      if (signal.aborted) return;
    }
  };
  // Cancel the request for the former surface, and measure once the view rests.
  const follow = () => {
    controller.abort();
    controller = new AbortController();
    clearTimeout(timer);
    show([], "Measuring…");
    if (panel.open) timer = setTimeout(measure, REST_MS, controller.signal);
  };
  panel.addEventListener("toggle", follow);
  view.watch(
    ({ isovalue, planes, opened, time, hide }) => [isovalue, planes, opened, time, hide],
    follow,
  );
}

/**
 * Return area and volume of a surface in words.
 * @param {Pick<Scene["volume"], "spacing">} volume
 * @param {Size} size
 * @returns {[string, string][]}
 */
export function sizeRows(
  { spacing },
  { unit, area, area_error: areaError, volume, volume_error: volumeError },
) {
  const length = unit || (spacing.every((step) => step === 1) ? "voxel" : "unit");
  if (area === 0) return [["Area", "no surface"]];
  return [
    ["Area", knownInWords(area, areaError, `${length}²`)],
    ["Volume", knownInWords(volume, volumeError, `${length}³`)],
  ];
}
