/**
 * The amount that a card draws at a time: fewer pixels of a moving picture while the card is slow,
 * and bands of a few milliseconds of a picture at rest. Drivers reset a card that is busy with one
 * draw for long, and until a draw ends nothing on the screen moves.
 */

const TARGET_MS = 20; // time that a moving picture should take
const SLOW_MS = 1000 / 30; // time that is accepted rather than a share below LEAST
const LEAST = 0.6; // share of the width that cards keep if they draw 30 pictures a second at it
const FEWEST = 0.2; // share of the width on any card
const BEGIN = 0.25; // share of the width of the first picture, before any time is known
const GROWTH = 2; // growth of the share from picture to picture, at most
const WORTH = 1.1; // growth of the share by which a new size is worth a change
const CALM = 60; // pictures after a slow one before the share grows again
const BAND_MS = 8; // time that a band of a picture at rest should take
const MOST_BANDS = 64; // bands of a picture
const UNEVEN = 4; // time of the slowest row of pixels over that of the mean row, at most
const LOOK_MS = 2; // time between two looks at a fence

/**
 * Bounds of the time that a card took: it was busy after `low` milliseconds, and done after `high`.
 * @typedef {{low: number, high: number}} Reading
 *
 * @typedef {object} Clock
 * @property {() => number} now current time, milliseconds
 * @property {(milliseconds: number, run: () => void) => unknown} after calls `run` after some time
 */

/** The browser's clock. @type {Clock} */
const CLOCK = {
  now: () => performance.now(),
  after: (milliseconds, run) => setTimeout(run, milliseconds),
};

/**
 * Return the time within a reading's bounds that is nearest to a wanted time.
 *
 * A page that was busy itself looks at the fence late, so that `high` alone says nothing against
 * the card.
 *
 * @param {number} wanted milliseconds
 * @param {Reading} reading
 * @returns {number} milliseconds
 */
export function nearest(wanted, { low, high }) {
  return Math.min(Math.max(wanted, low), high);
}

/**
 * A fence behind all commands that a card was given. It is looked at every LOOK_MS while the card
 * is busy, so that idle time never counts.
 */
export class Fence {
  #gl;
  #clock;
  #learn;
  #began;
  #low = 0;
  #over = false;
  #sync;

  /**
   * @param {WebGL2RenderingContext} gl
   * @param {(reading: Reading|null) => void} learn is called once the card is done, or with null if
   *   the card was lost
   * @param {Clock} [clock]
   */
  constructor(gl, learn, clock = CLOCK) {
    this.#gl = gl;
    this.#clock = clock;
    this.#learn = learn;
    this.#sync = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    this.#began = clock.now();
    const look = () => this.holds && clock.after(LOOK_MS, look);
    clock.after(LOOK_MS, look);
  }

  /** Look at the fence, and return true if the card is still busy. @returns {boolean} */
  get holds() {
    if (this.#over) return false;
    const gl = this.#gl;
    const state = this.#sync
      ? gl.clientWaitSync(this.#sync, gl.SYNC_FLUSH_COMMANDS_BIT, 0)
      : gl.WAIT_FAILED;
    const time = this.#clock.now() - this.#began;
    if (state === gl.TIMEOUT_EXPIRED) {
      this.#low = time;
      return true;
    }
    this.#over = true;
    gl.deleteSync(this.#sync);
    this.#learn(state === gl.WAIT_FAILED ? null : { low: this.#low, high: time });
    return false;
  }

  /** Stop looking, as the card was lost. */
  drop() {
    this.#over = true;
  }
}

/**
 * Return the share of the width for the picture after one that was too slow.
 * @param {number} share of the picture that was too slow
 * @param {number} ms time that it took, more than TARGET_MS
 * @returns {number}
 */
export function smallerShare(share, ms) {
  // Time is proportional to the number of pixels, the square of the share. A card that draws LEAST
  // of the width 30 times a second keeps that share, as fewer pixels would look worse than fewer
  // pictures.
  const atLeast = ms * (LEAST / share) ** 2;
  const bearable =
    atLeast <= SLOW_MS
      ? Math.max(share * Math.sqrt(TARGET_MS / ms), Math.min(LEAST, share))
      : share * Math.sqrt(SLOW_MS / ms);
  return Math.max(bearable, FEWEST);
}

/**
 * Return the share of the width for the picture after one that was quick enough.
 *
 * It grows at once to a size that is sure to reach the target. If only the lower bound of the time
 * allows growth, it grows by one step; if that was too much, `smallerShare` takes it back.
 *
 * @param {number} share of the picture that was quick enough
 * @param {Reading} reading
 * @returns {number}
 */
export function largerShare(share, { low, high }) {
  const sure = share * Math.sqrt(TARGET_MS / high);
  if (sure >= WORTH * share) return Math.min(sure, GROWTH * share, 1);
  return low * WORTH ** 2 <= TARGET_MS ? Math.min(WORTH * share, 1) : share;
}

/** Chooses how many pixels a card draws at a time, by a fence behind each draw. */
export class Pace {
  share = BEGIN; // of the width
  #calm = 0; // pictures until the share may grow again
  #slow = 0; // pictures in a row that were too slow
  /** @type {Fence|null} */
  #fence = null;
  /** Milliseconds per pixel of the slowest band: of sample 0, and of later samples. */
  #dearest = [0, 0];
  #dearestNow = 0; // of the current sample

  /** @param {WebGL2RenderingContext} gl @param {Clock} [clock] */
  constructor(gl, clock = CLOCK) {
    this.gl = gl;
    this.clock = clock;
  }

  /**
   * Begin with a restored card: its share begins small, and known times per pixel still hold.
   * @param {WebGL2RenderingContext} gl
   */
  restart(gl) {
    this.gl = gl;
    this.#fence?.drop();
    this.#fence = null;
    this.share = Math.min(this.share, BEGIN);
  }

  /**
   * Return true if the card is still drawing: another picture would only wait.
   * @returns {boolean}
   */
  get busy() {
    return this.#fence?.holds ?? false;
  }

  /**
   * Time a moving picture, whose commands were just given to the card.
   * @param {number} pixels of the picture
   */
  timePicture(pixels) {
    this.#dearestNow = 0;
    this.#watch((reading) => {
      // Until bands of a picture at rest are measured, assume that the slowest takes UNEVEN times
      // the mean.
      const mean = nearest(TARGET_MS, reading) / pixels;
      this.#dearest[0] = Math.max(this.#dearest[0] || UNEVEN * mean, mean);
      this.#learn(reading);
    });
  }

  /**
   * Time a band of a picture at rest, whose commands were just given to the card.
   * @param {number} pixels of the band
   * @param {number} n number of the sample
   * @param {boolean} isLast true if the band completes the sample
   */
  timeBand(pixels, n, isLast) {
    this.#watch((reading) => {
      this.#dearestNow = Math.max(this.#dearestNow, nearest(BAND_MS, reading) / pixels);
      if (!isLast) return;
      this.#dearest[Math.min(n, 1)] = this.#dearestNow;
      this.#dearestNow = 0;
    });
  }

  /**
   * Return the number of rows of the next band of sample n.
   *
   * The rows that are left are parted into equal bands, as a narrow last one would look slow per
   * pixel. Sample 1 uses the time of sample 0 until its bands are measured, as it takes no longer.
   *
   * @param {readonly number[]} size of the picture, pixels
   * @param {number} left rows that are still to be drawn
   * @param {number} n
   * @returns {number}
   */
  rowsOf([width, height], left, n) {
    const known = (n > 0 && this.#dearest[1]) || this.#dearest[0];
    const dearest = Math.max(known, this.#dearestNow) || Infinity; // unknown: begin small
    const most = Math.max(BAND_MS / (dearest * width), height / MOST_BANDS);
    return Math.ceil(left / Math.ceil(left / most - 0.01));
  }

  /**
   * Call `learn` once the card is done, unless it is lost.
   * @param {(reading: Reading) => void} learn
   */
  #watch(learn) {
    this.#fence = new Fence(this.gl, (reading) => reading && learn(reading), this.clock);
  }

  /**
   * Choose the share of the next moving picture.
   * @param {Reading} reading of a picture that moves
   */
  #learn(reading) {
    if (reading.low > TARGET_MS) {
      this.#slow += 1;
      // A single slow picture may be caused by another program: wait for a second one.
      if (this.#slow < 2 && reading.low < 2 * TARGET_MS) return;
      this.share = smallerShare(this.share, reading.low);
      this.#calm = CALM;
    } else if (this.#calm > 0) this.#calm -= 1;
    else this.share = largerShare(this.share, reading);
    if (reading.low <= TARGET_MS) this.#slow = 0;
  }
}
