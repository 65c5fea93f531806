/** Places of samples: within a pixel, so that edges are smooth, and on the discs of lobes, so that half-shadows are. */

/** Samples of a picture at rest, besides the one in the middle. */
export const SAMPLES = 16;

/** The golden angle, in radians: discs are filled as a sunflower is. Source: Vogel 1979. */
const GOLDEN = Math.PI * (3 - Math.sqrt(5));

/** Digits of n in a base behind the point, in reverse. Source: Halton 1964. @param {number} n @param {number} base @returns {number} */
function halton(n, base) {
  let sum = 0;
  for (let share = 1 / base; n > 0; n = Math.floor(n / base), share /= base) sum += (n % base) * share;
  return sum;
}

/** Where sample n of a pixel is, from its middle; the middle for 0. @param {number} n @returns {[number, number]} pixels */
export function jitterOf(n) {
  return n === 0 ? [0, 0] : [halton(n, 2) - 0.5, halton(n, 3) - 0.5];
}

/** Where the rays of sample n meet a disc, in radii; the middle for 0. @param {number} n @returns {[number, number]} */
export function discOf(n) {
  const radius = n === 0 ? 0 : Math.sqrt(halton(n - 1, 2) + 0.5 / SAMPLES);
  return [radius * Math.cos(n * GOLDEN), radius * Math.sin(n * GOLDEN)];
}
