/**
 * Compares pictures of a card with those of the server: no driver is trusted, and the server's
 * picture of a view at rest is available for comparison anyway.
 */

const EDGE = 12; // difference of neighbours, in levels of 255, that makes an edge
const ROUNDED = 8; // levels by which equal pixels may differ through rounding
const TAIL = 5; // error that 99 % of pixels stay below, over the error of the picture
const STRIDE = 2; // distance between pixels that are compared, along x and y
const FEWEST = 500; // pixels that a comparison needs

/** Share of the pixels that may differ. */
export const MOST_DIFFER = 0.01;

/**
 * Return the share of a surface's pixels that differ between a card's picture and the server's.
 *
 * Pixels at edges are left out, as card and server smooth edges by different samples; so are pixels
 * that equal all of their neighbours, as those of the ground do.
 *
 * The server traces light for single pixels whose texels are inaccurate, and a card does not. This
 * changes pixels by the error of texels' light, which is below TAIL times the picture's error for
 * 99 % of pixels: only larger differences are counted. But if most pixels differ by more than the
 * error itself, all of these are counted, as the driver is wrong everywhere: of normally
 * distributed errors, only a third exceeds their deviation.
 *
 * @param {Uint8Array|Uint8ClampedArray} card RGBA, rows from below
 * @param {Uint8Array|Uint8ClampedArray} server RGBA, rows from the top
 * @param {{width: number, height: number}} size
 * @param {number} error relative error of the card's picture
 * @returns {number|null} 0 to 1; null if too few pixels can be compared
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
      // The card's rows come from below, the server's from the top.
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
 * Return the largest difference of a pixel from its eight neighbours, in levels.
 * @param {Uint8Array|Uint8ClampedArray} picture
 * @param {number} width
 * @param {number} x
 * @param {number} y
 * @returns {number}
 */
function contrastAt(picture, width, x, y) {
  const here = 4 * (y * width + x);
  let most = 0;
  for (let k = 0; k < 9; k++) {
    const neighbour = here + 4 * ((Math.floor(k / 3) - 1) * width + (k % 3) - 1);
    for (let c = 0; c < 3; c++)
      most = Math.max(most, Math.abs(picture[here + c] - picture[neighbour + c]));
  }
  return most;
}

/**
 * Return the pixels of a picture of the server; null if it has another size.
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
