/**
 * Whether a card draws what the server does: no driver is trusted, and the server's picture of a
 * view at rest is there anyway.
 */

const EDGE = 12; // levels of 255 between neighbours, from which on a pixel is at an edge
const ROUNDED = 8; // levels that pixels may differ by, besides what is left of their error
const TAIL = 5; // what 99 % of pixels stay below, over the error of the picture
const STRIDE = 2; // pixels between two that are compared, along x and y
const FEWEST = 500; // pixels that say something

/** Share of the pixels that may differ. */
export const MOST_DIFFER = 0.01;

/**
 * The share of a surface's pixels that differ between a card's picture and the server's. Those at
 * edges are left out, as both smooth them by other samples, and those that are just like all
 * around, as the ground is.
 *
 * The server follows light of its own for some pixels, where texels' light is off, and a card does
 * not. That changes them by the error of texels' light, which TAIL times the error of the picture
 * bounds for 99 % of pixels: only what differs by more than this is counted. Where most pixels
 * differ by more than the error itself, though, which a third do if errors are normal, all of these
 * count: a driver is wrong everywhere.
 * @param {Uint8Array|Uint8ClampedArray} card RGBA, rows from below
 * @param {Uint8Array|Uint8ClampedArray} server RGBA, rows from the top
 * @param {{width: number, height: number}} size
 * @param {number} error relative error of the card's picture
 * @returns {number|null} null where too few pixels are left
 */
export function shareThatDiffers(card, server, { width, height }, error) {
  let compared = 0;
  let far = 0;
  let off = 0;
  for (let y = 1; y < height - 1; y += STRIDE) {
    for (let x = 1; x < width - 1; x += STRIDE) {
      const contrast = contrastAt(server, width, x, y);
      if (contrast === 0 || contrast >= EDGE) continue;
      compared += 1;
      const one = 4 * ((height - 1 - y) * width + x);
      const other = 4 * (y * width + x);
      const isOff = (/** @type {number} */ most) =>
        [0, 1, 2].some(
          (c) => Math.abs(card[one + c] - server[other + c]) > ROUNDED + most * server[other + c],
        );
      far += Number(isOff(TAIL * error));
      off += Number(isOff(error));
    }
  }
  if (compared < FEWEST) return null;
  return (off > compared / 2 ? off : far) / compared;
}

/**
 * How much a pixel differs from the eight around it, in levels.
 * @param {Uint8Array|Uint8ClampedArray} picture
 * @param {number} width
 * @param {number} x
 * @param {number} y
 * @returns {number}
 */
function contrastAt(picture, width, x, y) {
  const own = 4 * (y * width + x);
  let most = 0;
  for (let k = 0; k < 9; k++) {
    const beside = own + 4 * ((Math.floor(k / 3) - 1) * width + (k % 3) - 1);
    for (let c = 0; c < 3; c++)
      most = Math.max(most, Math.abs(picture[own + c] - picture[beside + c]));
  }
  return most;
}

/**
 * The pixels of a picture of the server; null where it has another size.
 * @param {HTMLImageElement|null} image
 * @param {{width: number, height: number}} size
 * @returns {Uint8ClampedArray|null} RGBA, rows from the top
 */
export function pixelsOf(image, { width, height }) {
  if (!image || image.naturalWidth !== width || image.naturalHeight !== height) return null;
  const paint = new OffscreenCanvas(width, height).getContext("2d");
  paint?.drawImage(image, 0, 0);
  return paint?.getImageData(0, 0, width, height).data ?? null;
}
