/**
 * The panels of visible matter: planes that cut it away, the pinned surfaces, the material of the
 * surface, and the labels that are shown.
 */

import { find } from "../dom.js";
import {
  MOST_OBLIQUE,
  facingPlane,
  moved,
  movablePlanes,
  readPlanes,
  termOf,
  writePlanes,
} from "../view/planes.js";
import { cameraAxes } from "../view/rotation.js";
import {
  absorbedShares,
  isMaterial,
  readHidden,
  readMaterial,
  readSurfaces,
  tintOf,
  writeHidden,
  writeMaterial,
  writeSurfaces,
} from "../view/surfaces.js";

/** @typedef {import("../documents.js").Label} Label */
/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {import("../documents.js").Surface} Surface */
/** @typedef {import("../view/model.js").ViewModel} ViewModel */

/**
 * Tie sliders of planes to the view, both ways.
 * @param {HTMLElement} panel holds `#cut-sliders`, `#oblique`, `#opened`, `#cut-note`, `#add-plane`
 *   and `#uncut`
 * @param {Pick<Scene, "volume"|"cuts">} scene
 * @param {ViewModel} view
 */
export function attachCuts(panel, { volume, cuts }, view) {
  const opened = find(panel, "#opened", HTMLInputElement);
  const note = find(panel, "#cut-note");
  const [add, uncut] = ["#add-plane", "#uncut"].map((id) => find(panel, id, HTMLButtonElement));
  const [sides, oblique] = [find(panel, "#cut-sliders"), find(panel, "#oblique")];
  const label = /** @type {HTMLElement} */ (opened.parentElement);
  label.hidden = !cuts;
  opened.addEventListener("change", () => view.set({ opened: opened.checked }));
  uncut.addEventListener("click", () => view.set({ planes: "" }));
  const others = (/** @type {(terms: string[]) => string[]} */ change) => {
    const planes = readPlanes(view.values.planes, volume.bounds);
    view.set({ planes: writePlanes({ ...planes, others: change(planes.others) }, volume.bounds) });
  };
  // A new oblique plane faces the viewer.
  const facing = () => {
    const { planes, azimuth, elevation } = view.values;
    return termOf(
      facingPlane(readPlanes(planes, volume.bounds), cameraAxes(azimuth, elevation).out),
    );
  };
  add.addEventListener("click", () => others((terms) => [...terms, facing()]));
  /** @type {Row[]} */
  const rows = [];
  const mirror = () => {
    const { planes, opened: open } = view.values;
    const all = movablePlanes(volume, planes);
    // Keep one row per plane; rows of oblique planes have buttons as well.
    while (rows.length > all.length) rows.pop()?.node.remove();
    for (let k = rows.length; k < all.length; k++) {
      const row = planeRow(k, volume, view);
      if (k >= SIDES) {
        row.node.append(
          buttonsOf([
            plainButton("Face me", () => others((terms) => terms.with(k - SIDES, facing()))),
            plainButton("Remove", () => others((terms) => terms.toSpliced(k - SIDES, 1))),
          ]),
        );
      }
      (k < SIDES ? sides : oblique).append(row.node);
      rows.push(row);
    }
    all.forEach((plane, k) => rows[k].show(plane));
    opened.checked = open;
    uncut.disabled = !planes;
    add.disabled = all.length >= SIDES + MOST_OBLIQUE;
    note.textContent = cutInWords(open, all.length > SIDES);
  };
  mirror();
  view.subscribe(mirror);
  if (view.values.planes) panel.toggleAttribute("open", true);
}

const SIDES = 6; // sides of a box, which come first in `movablePlanes`

/**
 * Describe the light at a cut.
 * @param {boolean} opened true if light comes in
 * @param {boolean} oblique true if there are oblique planes
 */
function cutInWords(opened, oblique) {
  if (!opened) return "The light remains that of the uncut object, and cut faces show values.";
  return oblique
    ? "Light comes in through the sides of the box. Oblique planes only hide the matter in front of them, and show values: cut voxels would leave steps there."
    : "What is left is lit again.";
}

/** Make a row of buttons. @param {HTMLElement[]} buttons */
function buttonsOf(buttons) {
  const row = Object.assign(document.createElement("div"), { className: "buttons" });
  row.append(...buttons);
  return row;
}

/** Make a button. @param {string} text @param {() => void} action */
function plainButton(text, action) {
  const button = Object.assign(document.createElement("button"), {
    type: "button",
    textContent: text,
  });
  button.addEventListener("click", action);
  return button;
}

/**
 * @typedef {{node: HTMLElement, show: (plane: import("../view/planes.js").Movable) => void}} Row
 */

/**
 * Make the slider of a plane, with its value.
 * @param {number} k number of the plane
 * @param {Scene["volume"]} volume
 * @param {ViewModel} view
 * @returns {Row}
 */
function planeRow(k, volume, view) {
  const [label, output, input] = [
    document.createElement("label"),
    document.createElement("output"),
    document.createElement("input"),
  ];
  const node = Object.assign(document.createElement("div"), { className: "knob" });
  const {
    name,
    range: [min, max],
  } = movablePlanes(volume, view.values.planes)[k];
  const id = `cut-${name.replace(" ", "-")}`;
  Object.assign(input, { type: "range", id, name: id, min, max, step: "any" });
  // Make the row, and move the plane with the slider.
  input.addEventListener("input", () =>
    view.set({ planes: moved(movablePlanes(volume, view.values.planes)[k], input.valueAsNumber) }),
  );
  label.htmlFor = output.htmlFor.value = id;
  label.textContent = name;
  node.append(label, output, input);
  /** @param {import("../view/planes.js").Movable} plane */
  const show = ({ value, range: [low, high] }) => {
    Object.assign(input, { min: String(low), max: String(high), value: String(value) });
    output.value = `${Number(value.toPrecision(4))} ${volume.unit}`.trim().replace("-", "−");
    input.setAttribute("aria-valuetext", output.value);
  };
  return { node, show };
}

/**
 * Tie a switch and a slider for each pinned surface to the view, both ways; hide the panel if there
 * are none.
 * @param {HTMLElement} panel holds `#surface-rows`
 * @param {{surfaces?: Surface[]}} scene
 * @param {ViewModel} view
 */
export function attachSurfaces(panel, { surfaces = [] }, view) {
  panel.hidden = !surfaces.length;
  const shown = () => readSurfaces(view.values.surfaces, surfaces);
  const rows = surfaces.map((surface, k) =>
    surfaceRow(surface, k, (patch) => {
      const next = shown().map((each, at) => (at === k ? { ...each, ...patch } : each));
      view.set({ surfaces: writeSurfaces(next, surfaces) });
    }),
  );
  find(panel, "#surface-rows").replaceChildren(...rows.map(({ node }) => node));
  const mirror = () => shown().forEach((each, k) => rows[k].show(each));
  mirror();
  view.subscribe(mirror);
  if (view.values.surfaces) panel.toggleAttribute("open", true);
}

/**
 * Make the switch and the slider of a pinned surface.
 * @param {Surface} surface
 * @param {number} k number of the surface
 * @param {(patch: Partial<import("../view/surfaces.js").Shown>) => void} set is called once the
 *   slider is released, as light is baked for each value
 */
function surfaceRow({ name, isovalue }, k, set) {
  const [node, label, check] = [
    document.createElement("div"),
    document.createElement("label"),
    document.createElement("input"),
  ];
  // Name the surface, and make its switch and its slider.
  const called = name || `Surface at ${isovalue}`;
  Object.assign(check, { type: "checkbox", id: `surface-${k}`, name: `surface-${k}` });
  Object.assign(label, { className: "check" }).append(check, ` ${called}`);
  const limits = { id: `clear-${k}`, min: 0, max: 1, step: 0.05 };
  const knob = bakedSlider(
    "Lets pass",
    limits,
    (value) => `${Math.round(100 * value)} %`,
    (clear) => set({ clear }),
  );
  knob.title.setAttribute("aria-label", `${called} lets pass`);
  check.addEventListener("change", () => set({ shown: check.checked }));
  node.append(label, knob.node);
  /** @param {import("../view/surfaces.js").Shown} now */
  const show = ({ shown, clear }) => {
    check.checked = shown;
    knob.slider.disabled = !shown;
    knob.show(clear);
  };
  return { node, show };
}

/**
 * Make a slider whose values each need a bake, or another scene. It shows its value while it moves,
 * and sets it once it is released, also by a key that was held.
 * @param {string} name
 * @param {{id: string, min: number, max: number, step: number|"any"}} limits
 * @param {(value: number) => string} words
 * @param {(value: number) => void} set
 */
function bakedSlider(name, limits, words, set) {
  const [node, title, output, slider] = [
    document.createElement("div"),
    document.createElement("label"),
    document.createElement("output"),
    document.createElement("input"),
  ];
  Object.assign(slider, { type: "range", name: limits.id, ...limits });
  Object.assign(title, { htmlFor: limits.id, textContent: name });
  output.htmlFor.value = limits.id;
  let held = false; // true while a key is down
  let changed = false; // true if the value is still to be set
  const tell = () => {
    output.value = words(slider.valueAsNumber);
    slider.setAttribute("aria-valuetext", output.value);
  };
  // A held key fires many changes: wait until it is released.
  const release = () => {
    if (changed && !held) set(slider.valueAsNumber);
    changed &&= held;
  };
  const hold = (/** @type {boolean} */ down) => () => {
    held = down;
    release();
  };
  slider.addEventListener("input", tell);
  slider.addEventListener("change", () => {
    changed = true;
    release();
  });
  slider.addEventListener("keydown", hold(true));
  for (const end of ["keyup", "blur"]) slider.addEventListener(end, hold(false));
  Object.assign(node, { className: "knob" }).append(title, output, slider);
  const show = (/** @type {number} */ value) => {
    slider.valueAsNumber = value;
    tell();
  };
  return { node, title, slider, show };
}

/** Names of a material's numbers. @type {Record<string, string>} */
const NUMBER_NAMES = {
  index: "Refractive index",
  absorption: "Absorption",
  mean_free_path: "Mean free path",
};
const CLEAREST = 5; // optical depth over the volume's radius at which glass is black
const [SHORTEST, LONGEST] = [0.001, 1]; // mean free paths, in radii of the volume

/**
 * Tie a choice of the material, and sliders of its numbers, to the view, both ways; hide the panel
 * if the scene allows only its own material.
 * @param {HTMLElement} panel holds a `.value`, a `select`, `#material-numbers` and a `.note`
 * @param {Pick<Scene, "material"|"materials"|"volume">} scene
 * @param {ViewModel} view
 */
export function attachMaterial(panel, scene, view) {
  const [value, numbers, note] = [".value", "#material-numbers", ".note"].map((each) =>
    find(panel, each),
  );
  const select = find(panel, "select", HTMLSelectElement);
  const { materials } = scene;
  const offered = materials.filter(({ kind }) => isMaterial(kind, materials));
  panel.hidden = offered.length < 2;
  if (panel.hidden) return;
  const now = () => readMaterial(view.values.material, scene);
  const set = (/** @type {import("../view/surfaces.js").Made} */ made) =>
    view.set({ material: writeMaterial(made, scene) });
  select.replaceChildren(...offered.map(({ kind }) => new Option(capital(kind), kind)));
  select.addEventListener("change", () => set(readMaterial(select.value, scene)));
  note.textContent = materials
    .flatMap(({ kind, refused }) => (refused ? [`${capital(kind)}: ${refused}`] : []))
    .join(" ");
  note.hidden = !note.textContent;
  /** @type {Record<string, (values: number[]) => void>} */
  let shown = {};
  let listed = "";
  const mirror = () => {
    const made = now();
    // Another material has other numbers: make its sliders.
    if (made.kind !== listed) {
      listed = made.kind;
      const rows = Object.keys(made.numbers).map((name) => ({
        name,
        ...numberRow(name, scene, made.numbers[name], (given) => {
          const { kind, numbers: others } = now();
          set({ kind, numbers: { ...others, [name]: given } });
        }),
      }));
      numbers.replaceChildren(...rows.flatMap(({ nodes }) => nodes));
      shown = Object.fromEntries(rows.map(({ name, show }) => [name, show]));
    }
    Object.entries(made.numbers).forEach(([name, given]) => shown[name](given));
    select.value = made.kind;
    value.textContent = capital(made.kind);
  };
  mirror();
  view.subscribe(mirror);
  if (view.values.material) panel.toggleAttribute("open", true);
}

/**
 * Make the slider of a material's number. Of three numbers, one per colour, it moves the largest,
 * and the others in proportion; a field for the tint changes the proportion.
 * @param {string} name
 * @param {Pick<Scene, "volume">} scene
 * @param {number[]} first the numbers at first
 * @param {(given: number[]) => void} set
 */
function numberRow(name, { volume }, first, set) {
  // Mean free paths span powers of ten: their slider is logarithmic.
  const { min, max, log } = numberRange(name, volume.bounds, Math.max(...first));
  const [inward, outward] = log
    ? [Math.log10, (/** @type {number} */ x) => 10 ** x]
    : [Number, Number];
  /** @type {Parameters<typeof bakedSlider>[1]} */
  const limits = { id: `material-${name}`, min: inward(min), max: inward(max), step: "any" };
  const round = (/** @type {number} */ x) => Number(x.toPrecision(3));
  // Proportions of the three colours, which the tint sets.
  let shares = [1];
  const per =
    volume.unit && { absorption: ` / ${volume.unit}`, mean_free_path: ` ${volume.unit}` }[name];
  const row = bakedSlider(
    NUMBER_NAMES[name] ?? name,
    limits,
    (x) => `${round(outward(x))}${per ?? ""}`,
    (x) => {
      set(shares.map((share) => round(share * outward(x))));
    },
  );
  const tint =
    name === "absorption"
      ? tintRow(row.slider.id, (hex) => {
          shares = absorbedShares(hex);
          set(shares.map((share) => round(share * outward(row.slider.valueAsNumber))));
        })
      : undefined;
  const show = (/** @type {number[]} */ given) => {
    const most = Math.max(...given);
    if (most > 0) shares = given.map((each) => each / most); // zeros keep the last tint
    row.show(inward(most));
    if (tint) tint.field.value = tintOf(shares);
  };
  return { nodes: tint ? [row.node, tint.node] : [row.node], show };
}

/**
 * Make a field for the colour of white light behind an absorbing material.
 * @param {string} slider id of the slider above
 * @param {(hex: string) => void} set
 */
function tintRow(slider, set) {
  const [node, label, field] = [
    document.createElement("div"),
    document.createElement("label"),
    document.createElement("input"),
  ];
  const id = `${slider}-tint`;
  Object.assign(label, { htmlFor: id, textContent: "Tint" });
  Object.assign(field, { type: "color", id, name: id });
  field.addEventListener("change", () => set(field.value));
  Object.assign(node, { className: "choice" }).append(label, field);
  return { node, field };
}

/**
 * Return the range of the slider of a material's number: values that make a visible difference in a
 * volume of this size.
 * @param {string} name
 * @param {Scene["volume"]["bounds"]} bounds
 * @param {number} usual the scene's value, which the range includes
 * @returns {{min: number, max: number, log: boolean}}
 */
export function numberRange(name, [low, high], usual) {
  const radius = Math.hypot(...low.map((each, k) => high[k] - each)) / 2;
  if (name === "index") return { min: 1, max: Math.max(2.5, usual), log: false };
  if (name === "absorption") return { min: 0, max: Math.max(CLEAREST / radius, usual), log: false };
  return { min: Math.min(SHORTEST * radius, usual), max: Math.max(LONGEST * radius, usual), log: true };
}

/** Write a word with a capital. @param {string} word */
function capital(word) {
  return word[0].toUpperCase() + word.slice(1);
}

/**
 * Tie a switch for each label to the view, both ways; there are none if the scene is no
 * segmentation.
 * @param {HTMLElement} legend holds `.labels` and `#labels-all`
 * @param {Pick<Scene, "colours">} scene
 * @param {ViewModel} view
 */
export function attachLabels(legend, { colours }, view) {
  const labels = colours?.labels ?? [];
  const all = find(legend, "#labels-all", HTMLButtonElement);
  const now = () => readHidden(view.values.hide, labels);
  /** @type {(hidden: number[]) => void} */
  const hide = (hidden) => view.set({ hide: writeHidden(hidden, labels) });
  // A switch hides its label, or shows it again; the last label that is shown cannot be hidden.
  const rows = labels.map((label) =>
    labelRow(label, (shown) => {
      const others = now().filter((value) => value !== label.value);
      hide(shown ? others : [...others, label.value]);
    }),
  );
  find(legend, ".labels").replaceChildren(...rows.map(({ node }) => node));
  all.addEventListener("click", () => hide([]));
  const mirror = () => {
    const hidden = now();
    const alone = labels.length - hidden.length === 1;
    labels.forEach(({ value }, k) => rows[k].show(!hidden.includes(value), alone));
    all.hidden = !hidden.length;
  };
  mirror();
  view.subscribe(mirror);
}

/**
 * Make the switch, swatch and name of a label.
 * @param {Label} label
 * @param {(shown: boolean) => void} set
 */
function labelRow({ name, colour }, set) {
  const [node, label, check] = [
    document.createElement("li"),
    document.createElement("label"),
    document.createElement("input"),
  ];
  check.type = "checkbox";
  check.addEventListener("change", () => set(check.checked));
  label.style.setProperty("--swatch", colour);
  label.append(check, name);
  node.append(label);
  /** @type {(shown: boolean, alone: boolean) => void} */
  const show = (shown, alone) => {
    check.checked = shown;
    check.disabled = shown && alone; // at least one label is shown
    label.title = check.disabled ? "Show another one before you hide this" : "";
  };
  return { node, show };
}
