/**
 * The scene in words: its plan, the parts that were left out with reason and saving, its volume and
 * its lights.
 */

import { find, textElement } from "../dom.js";
import { exactValue } from "../view/format.js";
import { stopsInWords } from "./histogram.js";

/** @typedef {import("../net/schemas.js").Scene} Scene */
/**
 * @typedef {Record<string, string|number|null>} Rows names and values of a list; null and "" are
 *   left out
 */

/**
 * Fill the two folded lists with the scene's document.
 * @param {HTMLElement} root holds `#plan-facts`, `#plan-notes`, `#plan-left-out` and
 *   `#volume-facts`
 * @param {Scene} scene
 */
export function showScene(root, scene) {
  find(root, "#plan-facts").replaceChildren(...list(planRows(scene)));
  find(root, "#volume-facts").replaceChildren(...list(volumeRows(scene)));
  find(root, "#plan-notes").replaceChildren(
    ...scene.plan.notes.map((note) => textElement("p", note)),
  );
  const leftOut = scene.plan.left_out.map(omission);
  if (!leftOut.length) leftOut.push(textElement("li", "Nothing: this scene needs it all."));
  find(root, "#plan-left-out").replaceChildren(...leftOut);
}

/**
 * Return the plan of a scene in words.
 * @param {Pick<Scene, "plan"|"target_error">} scene
 * @returns {Rows}
 */
export function planRows({ plan, target_error: target }) {
  return {
    Light: plan.representation,
    ...Object.fromEntries(plan.layers.map((layer) => [capital(layer.kind), layerInWords(layer)])),
    Lobes: lobesInWords(plan.lobes),
    "Bytes per texel": `${plan.bytes_per_texel}, instead of ${plan.full_bytes_per_texel}`,
    "Texels shown": `${grouped(plan.texels.shown)} of ${grouped(plan.texels.total)}`,
    Bounces: plan.bounces,
    "Samples, at most": grouped(plan.samples),
    "Final means": Number.isFinite(target) ? `error below ${percent(target)}` : null,
    ...Object.fromEntries(
      Object.entries(plan.errors).map(([cause, error]) => [`Error of ${cause}`, percent(error)]),
    ),
  };
}

/**
 * Return volume, lights and surface of a scene in words.
 * @param {Pick<Scene, "volume"|"lights"|"albedo"|"albedos"|"transmission"> & Partial<Pick<Scene,
 *   "colours"|"surfaces"|"stops"|"stops_note">>} scene
 * @returns {Rows}
 */
export function volumeRows({
  volume,
  lights,
  albedo,
  albedos,
  transmission,
  colours,
  surfaces = [],
  stops = [],
  stops_note: note = "",
}) {
  return {
    Volume: volume.name,
    Size: `${volume.size.join(" × ")} voxels`,
    Spacing:
      `${volume.spacing.map((length) => Number(length.toPrecision(4))).join(" × ")} ${volume.unit}`.trim(),
    "Voxel axes point to": [...volume.axes].join(", "),
    "Read as": volume.read_as ?? "",
    Notes: volume.notes.join(" "),
    Values: `${volume.value_range.map((value) => exactValue(value, volume.value_range)).join(" to ")}, ${volume.dtype}`,
    "Stops of the isovalue": stops.length ? stopsInWords(note) : null,
    "Not finite": volume.holes ? `${volume.holes} voxels, treated as empty` : null,
    Lights: lights
      .map(({ type, name }) => (name && name !== type ? `${name} (${type})` : type))
      .join(", "),
    Albedo: colours ? null : sharesInWords(albedo),
    Transmission: transmission.some(Boolean) ? sharesInWords(transmission) : null,
    Colours: colours && !colours.labels.length ? `${colours.map} of ${colours.name}` : null,
    Labels: colours?.labels.length
      ? `${colours.colours.length} of ${colours.labels.length} shown`
      : null,
    "Other surfaces": surfaces.map((each) => surfaceInWords(each, volume)).join("; "),
    "Albedos to choose from":
      albedos && `${Number(albedos.min.toFixed(3))} to ${Number(albedos.max.toFixed(3))}`,
  };
}

/**
 * Write a colour; three equal components as one number.
 * @param {import("../net/schemas.js").Vec3} colour
 */
function sharesInWords(colour) {
  return [...new Set(colour)].map((share) => Number(share.toFixed(3))).join(", ");
}

/**
 * Describe a pinned surface.
 * @param {import("../documents.js").Surface} surface
 * @param {Scene["volume"]} volume
 */
function surfaceInWords({ isovalue, name, clear, transmission }, { value_range: range }) {
  const passing = clear ? `, ${percent(clear)} clear` : "";
  const through = transmission.some(Boolean) ? `, transmission ${sharesInWords(transmission)}` : "";
  return `${name ? `${name} at ` : ""}${exactValue(isovalue, range)}${passing}${through}`;
}

/**
 * Describe the numbers of a layer per texel, such as "SH order 5 in 3 channels, float16 floats".
 * @param {import("../documents.js").Layer} layer
 * @returns {string}
 */
export function layerInWords({ order, channels, precision, coarse, nodes }) {
  const numbers = order > 1 ? `SH order ${order}` : "one number";
  const kept =
    coarse === null ? `${precision} floats` : `half floats, bytes from band ${coarse} on`;
  const albedos = nodes.map((node) => Number(node.toFixed(2))).join(", ");
  let each = channels > 1 ? ` in ${channels} channels` : "";
  if (albedos) each = ` for albedo ${albedos}`;
  return `${numbers}${each}, ${kept}`;
}

/**
 * Write an amount that was saved, such as "12 000 texels (measured)".
 * @param {import("../documents.js").Omission["saves"][number]} saving
 * @returns {string}
 */
export function savingInWords({ amount, unit, measured }) {
  const digits = amount >= 100 ? Math.round(amount) : Number(amount.toPrecision(3));
  return `${grouped(digits)} ${unit}${measured ? " (measured)" : ""}`;
}

const FEW_LOBES = 4; // lobes that are listed

/** Describe the lobes of the light. @param {import("../documents.js").Lobe[]} lobes */
function lobesInWords(lobes) {
  const further = lobes.length > FEW_LOBES ? [`and ${lobes.length - FEW_LOBES} more`] : [];
  return [...lobes.slice(0, FEW_LOBES).map(lobeInWords), ...further].join("; ");
}

/** Describe one lobe. @param {import("../documents.js").Lobe} lobe */
function lobeInWords({ azimuth, elevation, angle }) {
  return `${Number(angle.toPrecision(2))}° across at azimuth ${azimuth.toFixed(0)}°, elevation ${elevation.toFixed(0)}°`;
}

/** Make the elements of a list. @param {Rows} rows */
function list(rows) {
  return Object.entries(rows).flatMap(([name, value]) =>
    value === null || value === "" ? [] : [textElement("dt", name), textElement("dd", value)],
  );
}

/**
 * Make the element of a part that was left out.
 * @param {import("../documents.js").Omission} omission
 */
function omission({ what, why, saves }) {
  const node = document.createElement("li");
  node.append(textElement("b", what), ` — ${why}`);
  if (saves.length)
    node.append(textElement("span", `saves ${saves.map(savingInWords).join(", ")}`));
  return node;
}

/** Write a share in percent. @param {number} share */
function percent(share) {
  return `${Number((100 * share).toPrecision(3))} %`;
}

/** Write a number with groups of three digits. @param {number} number */
function grouped(number) {
  return number.toLocaleString("en").replaceAll(",", "\u202f");
}

/** Write a word with a capital. @param {string} word */
function capital(word) {
  return word[0].toUpperCase() + word.slice(1);
}
