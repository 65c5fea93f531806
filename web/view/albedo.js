/**
 * How much light the surface reflects (albedo, a number) and of which colour (tint), where views
 * may ask for any.
 */

/** @typedef {import("../net/schemas.js").Scene} Scene */

/** The tint of a grey surface. */
export const WHITE = "#ffffff";

/**
 * Albedo and tint where a scene starts; none where its albedo is fixed.
 * @param {Pick<Scene, "albedo"|"albedos">} scene
 * @returns {{albedo?: number, tint?: string}}
 */
export function startAlbedo({ albedo, albedos }) {
  if (!albedos) return {};
  const most = Math.max(...albedo);
  return { albedo: most, tint: most > 0 ? hexOf(albedo.map((share) => share / most)) : WHITE };
}

/**
 * Whether a text is a colour as a colour field has it.
 * @param {unknown} text
 * @returns {text is string}
 */
export function isTint(text) {
  return typeof text === "string" && /^#[0-9a-f]{6}$/i.test(text);
}

/**
 * The albedo parameter of a frame request; none where the view has the scene's own.
 * @param {Pick<Scene, "albedo"|"albedos">} scene
 * @param {{albedo?: number, tint?: string}} values knobs of the view
 * @returns {{albedo?: number|string}}
 */
export function albedoQuery(scene, { albedo, tint = WHITE }) {
  const start = startAlbedo(scene);
  if (!scene.albedos || albedo === undefined || (albedo === start.albedo && tint === start.tint))
    return {};
  const { min, max } = scene.albedos;
  const shares = linear(tint).map((share) =>
    Number(Math.min(max, Math.max(min, share * albedo)).toPrecision(4)),
  );
  return { albedo: tint === WHITE ? shares[0] : shares.join(",") };
}

/**
 * Linear shares of a colour in sRGB (IEC 61966-2-1).
 * @param {string} hex
 * @returns {number[]}
 */
export function linear(hex) {
  const shares = [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255);
  return shares.map((share) =>
    share <= 0.04045 ? share / 12.92 : ((share + 0.055) / 1.055) ** 2.4,
  );
}

/**
 * The inverse of `linear`.
 * @param {number[]} shares
 * @returns {string}
 */
export function hexOf(shares) {
  const curved = shares.map((share) =>
    share <= 0.0031308 ? 12.92 * share : 1.055 * share ** (1 / 2.4) - 0.055,
  );
  return `#${curved
    .map((share) =>
      Math.round(255 * share)
        .toString(16)
        .padStart(2, "0"),
    )
    .join("")}`;
}
