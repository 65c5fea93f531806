/** The scene in words: its plan, what was left out, why and what that saves, its volume and its lights. */

/**
 * Fill the two folded lists with what the server says about the scene.
 * @param {HTMLElement} root holds `#plan-facts`, `#plan-notes`, `#plan-left-out` and `#volume-facts`
 * @param {object} scene answer of `readScene`
 */
export function showFacts(root, scene) {
  root.querySelector("#plan-facts").replaceChildren(...rows(planFacts(scene)));
  root.querySelector("#volume-facts").replaceChildren(...rows(volumeFacts(scene)));
  root.querySelector("#plan-notes").replaceChildren(...scene.plan.notes.map((note) => textNode("p", note)));
  const leftOut = scene.plan.left_out.map(omission);
  root.querySelector("#plan-left-out").replaceChildren(...(leftOut.length ? leftOut : [textNode("li", "Nothing: this scene needs it all.")]));
}

function planFacts({ plan, target_error: target }) {
  return {
    Light: plan.representation,
    ...Object.fromEntries(plan.layers.map((layer) => [capital(layer.kind), layerInWords(layer)])),
    Lobes: plan.lobes.map(lobeInWords).join("; "),
    "Bytes per texel": `${plan.bytes_per_texel}, instead of ${plan.full_bytes_per_texel}`,
    "Texels shown": `${grouped(plan.texels.shown)} of ${grouped(plan.texels.total)}`,
    Bounces: plan.bounces,
    "Samples, at most": grouped(plan.samples),
    "Final means": Number.isFinite(target) ? `noise below ${percent(target)}` : null,
    ...Object.fromEntries(Object.entries(plan.errors).map(([cause, error]) => [`Error of ${cause}`, percent(error)])),
  };
}

function layerInWords({ order, channels, precision, coarse, nodes }) {
  const numbers = order > 1 ? `SH order ${order}` : "one number";
  const kept = coarse === null ? `${precision} floats` : `half floats, bytes from band ${coarse} on`;
  const each = nodes.length ? ` for albedo ${nodes.map((node) => Number(node.toFixed(2))).join(", ")}` : ` in ${channels} channels`;
  return `${numbers}${channels > 1 || nodes.length ? each : ""}, ${kept}`;
}

function lobeInWords({ azimuth, elevation, angle }) {
  return `${Number(angle.toPrecision(2))}° across at azimuth ${azimuth.toFixed(0)}°, elevation ${elevation.toFixed(0)}°`;
}

function volumeFacts({ volume, lights, albedo, albedos }) {
  return {
    Volume: volume.name,
    Size: `${volume.size.join(" × ")} voxels`,
    Spacing: volume.spacing.map((length) => Number(length.toPrecision(4))).join(" × "),
    Values: `${volume.value_range.map((value) => Number(value.toPrecision(6))).join(" to ")}, ${volume.dtype}`,
    "Not finite": volume.holes ? `${volume.holes} voxels, treated as empty` : null,
    Lights: lights.map(({ type, name }) => (name && name !== type ? `${name} (${type})` : type)).join(", "),
    Albedo: [...new Set([albedo].flat())].map((share) => Number(share.toFixed(3))).join(", "),
    "Albedos to choose from": albedos && `${Number(albedos.min.toFixed(3))} to ${Number(albedos.max.toFixed(3))}`,
  };
}

function rows(facts) {
  return Object.entries(facts)
    .filter(([, value]) => value !== null && value !== undefined && value !== "")
    .flatMap(([name, value]) => [textNode("dt", name), textNode("dd", value)]);
}

function omission({ what, why, saves }) {
  const node = document.createElement("li");
  node.append(textNode("b", what), ` — ${why}`);
  if (saves.length) node.append(textNode("span", `saves ${saves.map(savingInWords).join(", ")}`));
  return node;
}

function savingInWords({ amount, unit, measured }) {
  const digits = amount >= 100 ? Math.round(amount) : Number(amount.toPrecision(3));
  return `${grouped(digits)} ${unit}${measured ? " (measured)" : ""}`;
}

function textNode(tag, text) {
  return Object.assign(document.createElement(tag), { textContent: text });
}

function percent(share) {
  return `${Number((100 * share).toPrecision(3))} %`;
}

function grouped(number) {
  return number.toLocaleString("en").replaceAll(",", "\u202f");
}

function capital(word) {
  return word[0].toUpperCase() + word.slice(1);
}
