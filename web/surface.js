/** The surface: how much light it reflects (albedo, a number) and of which colour (tint), where the scene's light allows any. */

/** What is said of a surface where nothing else is. */
const WHITE = "#ffffff";

/**
 * Where the surface of a scene starts; no knobs where its albedo is fixed.
 * @param {object} scene answer of `readScene`
 * @returns {{albedo?: number, tint?: string}}
 */
export function surfaceOf({ albedo, albedos }) {
  if (!albedos) return {};
  const most = Math.max(...albedo);
  return { albedo: most, tint: most > 0 ? hexOf(albedo.map((share) => share / most)) : WHITE };
}

/**
 * Whether a text is a colour as a colour field has it.
 * @param {unknown} text
 * @returns {boolean}
 */
export function isTint(text) {
  return /^#[0-9a-f]{6}$/i.test(text);
}

/**
 * The parameter of a frame request that says what the surface is; none where it is the scene's own.
 * @param {object} scene answer of `readScene`
 * @param {{albedo?: number, tint?: string}} values knobs of the view
 * @returns {{albedo?: number|string}}
 */
export function albedoQuery(scene, { albedo, tint }) {
  const own = surfaceOf(scene);
  if (albedo === undefined || (albedo === own.albedo && tint === own.tint)) return {};
  const { min, max } = scene.albedos;
  const shares = linear(tint).map((share) => Number(Math.min(max, Math.max(min, share * albedo)).toPrecision(4)));
  return { albedo: tint === WHITE ? shares[0] : shares.join(",") };
}

/**
 * Tie the colour field to the view, both ways; it is hidden where the scene's albedo is fixed.
 * @param {HTMLInputElement} input
 * @param {import("./view.js").ViewModel} view
 * @returns {(values: object) => void} shows the view's colour
 */
export function attachTint(input, view) {
  const { tint } = view.values;
  input.parentElement.hidden = tint === undefined;
  if (tint === undefined) return () => {};
  input.addEventListener("input", () => view.set({ tint: input.value }));
  return (values) => { input.value = values.tint; };
}

/** Linear shares of a colour in sRGB (IEC 61966-2-1). */
function linear(hex) {
  const shares = [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255);
  return shares.map((share) => (share <= 0.04045 ? share / 12.92 : ((share + 0.055) / 1.055) ** 2.4));
}

function hexOf(shares) {
  const curved = shares.map((share) => (share <= 0.0031308 ? 12.92 * share : 1.055 * share ** (1 / 2.4) - 0.055));
  return `#${curved.map((share) => Math.round(255 * share).toString(16).padStart(2, "0")).join("")}`;
}
