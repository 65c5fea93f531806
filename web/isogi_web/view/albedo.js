/**
 * The surface's albedo (a number) and its tint (a colour), for scenes that let views choose any.
 */

/** @typedef {import("../net/schemas.js").Scene} Scene */

/** The tint of a grey surface. */
export const WHITE = "#ffffff";

/**
 * Return albedo and tint at the start of a scene; neither if its albedo is fixed.
 * @param {Pick<Scene, "albedo"|"albedos">} scene
 * @returns {{albedo?: number, tint?: string}}
 */
export function startAlbedo({ albedo, albedos }) {
  if (!albedos) return {};
  // The tint is the albedo scaled to a largest component of 1.
  const most = Math.max(...albedo);
  return { albedo: most, tint: most > 0 ? hexOf(albedo.map((share) => share / most)) : WHITE };
}

/**
 * Return true if a text is a colour as a colour field writes it.
 * @param {unknown} text
 * @returns {text is string}
 */
export function isTint(text) {
  return typeof text === "string" && /^#[0-9a-f]{6}$/i.test(text);
}

/**
 * Return the albedo parameter of a frame request; none if the view has the scene's albedo.
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
 * Return the linear components of a colour in sRGB (IEC 61966-2-1), 0 to 1.
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
 * Return the colour of linear components: the inverse of `linear`.
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
