/** The scene in words: its plan, what was left out and why, its volume and its lights. */

/**
 * Fill the two folded lists with what the server says about the scene.
 * @param {HTMLElement} root holds `#plan-facts`, `#plan-left-out` and `#volume-facts`
 * @param {object} scene answer of `readScene`
 */
export function showFacts(root, scene) {
  root.querySelector("#plan-facts").replaceChildren(...rows(planFacts(scene)));
  root.querySelector("#volume-facts").replaceChildren(...rows(volumeFacts(scene)));
  const leftOut = scene.plan.left_out.map(({ what, why }) => item(what, why));
  root.querySelector("#plan-left-out").replaceChildren(...(leftOut.length ? leftOut : [item("Nothing", "this scene needs it all")]));
}

function planFacts({ plan, target_error: target }) {
  return {
    Light: plan.representation,
    "SH order": plan.order,
    Channels: plan.channels,
    Bounces: plan.bounces,
    "Bytes per texel": plan.bytes_per_texel,
    "Final means": Number.isFinite(target) ? `noise below ${percent(target)}` : null,
  };
}

function volumeFacts({ volume, lights, albedo }) {
  return {
    Volume: volume.name,
    Size: `${volume.size.join(" × ")} voxels`,
    Spacing: volume.spacing.map((length) => Number(length.toPrecision(4))).join(" × "),
    Values: `${volume.value_range.map((value) => Number(value.toPrecision(6))).join(" to ")}, ${volume.dtype}`,
    "Not finite": volume.holes ? `${volume.holes} voxels, treated as empty` : null,
    Lights: lights.map(({ type, name }) => (name && name !== type ? `${name} (${type})` : type)).join(", "),
    Albedo: [...new Set([albedo].flat())].map((share) => Number(share.toFixed(3))).join(", "),
  };
}

function rows(facts) {
  return Object.entries(facts)
    .filter(([, value]) => value !== null && value !== undefined && value !== "")
    .flatMap(([name, value]) => [textNode("dt", name), textNode("dd", value)]);
}

function item(what, why) {
  const node = document.createElement("li");
  node.append(textNode("b", what), ` — ${why}`);
  return node;
}

function textNode(tag, text) {
  return Object.assign(document.createElement(tag), { textContent: text });
}

function percent(share) {
  return `${Number((100 * share).toPrecision(3))} %`;
}
