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
 * Share that may differ where a surface shines: reflections of what no view has lit are noise on
 * the card, which the mean over neighbours does not all take away. Right pictures differ by a third
 * of it (design/card.md).
 */
export const MOST_DIFFER_SHINY = 0.15;

/** Distance up to which neighbours are averaged where a surface shines, pixels along x and y. */
export const AROUND_SHINY = 2;

/**
 * Return the share of a surface's pixels that differ between a card's picture and the server's.
 *
 * Pixels at edges are left out, as card and server smooth edges by different samples, and so are
 * pixels whose mean reaches an edge; so are pixels that equal all of their neighbours, as those of
 * the ground do.
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
 * @param {number} [around] distance up to which neighbours are averaged before they are compared,
 *   for pictures with noise, pixels along x and y
 * @returns {number|null} 0 to 1; null if too few pixels can be compared
 */
export function shareThatDiffers(card, server, { width, height }, error, around = 0) {
  let compared = 0;
  let far = 0;
  let off = 0;
  const least = Math.max(around, 1);
  for (let y = least; y < height - least; y += STRIDE) {
    for (let x = least; x < width - least; x += STRIDE) {
      if (contrastAt(server, width, x, y) === 0 || hasEdge(server, width, x, y, least)) continue;
      compared += 1;
      // The card's rows come from below, the server's from the top.
      const one = meanAt(card, width, x, height - 1 - y, around);
      const other = meanAt(server, width, x, y, around);
      const isOff = (/** @type {number} */ most) =>
        [0, 1, 2].some((c) => Math.abs(one[c] - other[c]) > ROUNDED + most * other[c]);
      far += Number(isOff(TAIL * error));
      off += Number(isOff(error));
    }
  }
  if (compared < FEWEST) return null;
  return (off > compared / 2 ? off : far) / compared;
}

/**
 * Return the mean colour of the pixels up to a distance around one, along x and y.
 * @param {Uint8Array|Uint8ClampedArray} picture
 * @param {number} width
 * @param {number} x
 * @param {number} y
 * @param {number} around pixels
 * @returns {number[]} red, green and blue, 0 to 255
 */
function meanAt(picture, width, x, y, around) {
  const sums = [0, 0, 0];
  for (let v = y - around; v <= y + around; v++)
    for (let u = x - around; u <= x + around; u++)
      for (let c = 0; c < 3; c++) sums[c] += picture[4 * (v * width + u) + c];
  return sums.map((sum) => sum / (2 * around + 1) ** 2);
}

/**
 * Return true if there is an edge among the pixels up to a distance around one, along x and y.
 * @param {Uint8Array|Uint8ClampedArray} picture
 * @param {number} width
 * @param {number} x
 * @param {number} y
 * @param {number} around pixels, 1 at least
 * @returns {boolean}
 */
function hasEdge(picture, width, x, y, around) {
  // The contrast of a pixel reaches to its neighbours.
  const far = around - 1;
  for (let v = y - far; v <= y + far; v++)
    for (let u = x - far; u <= x + far; u++)
      if (contrastAt(picture, width, u, v) >= EDGE) return true;
  return false;
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
