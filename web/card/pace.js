/**
 * How much a card draws at once: fewer pixels of a picture that moves while it is slow, and of one
 * at rest a band of some milliseconds after the other. Drivers take a card back that is busy for
 * long with one draw, and until then nothing on the screen moves.
 */

const TARGET_MS = 20; // of a picture
const SLOW_MS = 1000 / 30; // of a picture that may have fewer pixels than LEAST of the width allows
const LEAST = 0.6; // share of the width, on a card that reaches 30 pictures a second there
const FEWEST = 0.2; // share of the width on any card
const BEGIN = 0.25; // share of the width that a card begins with that nobody knows
const GROWTH = 2; // of the width from picture to picture, at most
const WORTH = 1.1; // growth that is worth another size
const CALM = 60; // pictures after one that was too slow, before they grow again
const BAND_MS = 8; // of a band of a picture at rest
const MOST_BANDS = 64; // of a picture
const UNEVEN = 4; // what a row of pixels takes at most, over the mean of a picture's rows
const LOOK_MS = 2; // between two looks

/**
 * When a card was done: after `low` milliseconds it was not yet, and after `high` it was.
 * @typedef {{low: number, high: number}} Reading
 *
 * @typedef {object} Clock
 * @property {() => number} now milliseconds
 * @property {(milliseconds: number, run: () => void) => unknown} after calls `run` later
 */

/** The browser's clock. @type {Clock} */
const CLOCK = {
  now: () => performance.now(),
  after: (milliseconds, run) => setTimeout(run, milliseconds),
};

/**
 * The time of a reading that is nearest to a wanted one: a page that was busy itself looks late,
 * and says nothing against it.
 * @param {number} wanted milliseconds
 * @param {Reading} reading
 * @returns {number}
 */
export function nearest(wanted, { low, high }) {
  return Math.min(Math.max(wanted, low), high);
}

/**
 * A fence behind all that a card was asked for. It is looked at while the card is busy, so that the
 * time in which nothing is asked for never counts.
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
   * @param {(reading: Reading|null) => void} learn is called once the card is done; with null where
   *   it was lost
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

  /** Whether the card is still busy: it is looked at now. @returns {boolean} */
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

  /** Look no more: the card was lost. */
  drop() {
    this.#over = true;
  }
}

/**
 * The share of the width that a picture is to have after one that was too slow.
 * @param {number} share of that
 * @param {number} ms that it took, more than the target
 * @returns {number}
 */
export function smallerShare(share, ms) {
  const atLeast = ms * (LEAST / share) ** 2;
  const bearable =
    atLeast <= SLOW_MS
      ? Math.max(share * Math.sqrt(TARGET_MS / ms), Math.min(LEAST, share))
      : share * Math.sqrt(SLOW_MS / ms);
  return Math.max(bearable, FEWEST);
}

/**
 * The share of the width that a picture may have after one that was quick enough: as large as is
 * sure to be, else one size up where that may be; if it is not, it becomes smaller again.
 * @param {number} share of that
 * @param {Reading} reading
 * @returns {number}
 */
export function largerShare(share, { low, high }) {
  const sure = share * Math.sqrt(TARGET_MS / high);
  if (sure >= WORTH * share) return Math.min(sure, GROWTH * share, 1);
  return low * WORTH ** 2 <= TARGET_MS ? Math.min(WORTH * share, 1) : share;
}

/** The pace of a card, by a fence behind each draw. */
export class Pace {
  share = BEGIN; // of the width
  #calm = 0;
  #slow = 0; // pictures in a row that were too slow
  /** @type {Fence|null} */
  #fence = null;
  /** Milliseconds a pixel of the dearest band: of first samples, and of those that join them. */
  #dearest = [0, 0];
  #dearestNow = 0; // of the sample at hand

  /** @param {WebGL2RenderingContext} gl @param {Clock} [clock] */
  constructor(gl, clock = CLOCK) {
    this.gl = gl;
    this.clock = clock;
  }

  /**
   * The pace of a card that was lost, and is there again: it begins small, and what was learnt of
   * it holds.
   * @param {WebGL2RenderingContext} gl
   */
  restart(gl) {
    this.gl = gl;
    this.#fence?.drop();
    this.#fence = null;
    this.share = Math.min(this.share, BEGIN);
  }

  /**
   * Whether the card still draws what it was asked for last; a picture more would only wait.
   * @returns {boolean}
   */
  get busy() {
    return this.#fence?.holds ?? false;
  }

  /**
   * A picture that moves was just asked for.
   * @param {number} pixels of it
   */
  timePicture(pixels) {
    this.#dearestNow = 0;
    this.#watch((reading) => {
      const mean = nearest(TARGET_MS, reading) / pixels;
      this.#dearest[0] = Math.max(this.#dearest[0] || UNEVEN * mean, mean);
      this.#learn(reading);
    });
  }

  /**
   * A band of a sample of a picture at rest was just asked for.
   * @param {number} pixels of the band
   * @param {number} n the sample
   * @param {boolean} isLast whether it ends the sample
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
   * Rows of the next band of sample n, one of as many that are alike: a narrow one would look dear.
   * A sample that joins others takes no longer than the first.
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

  /** @param {(reading: Reading) => void} learn */
  #watch(learn) {
    this.#fence = new Fence(this.gl, (reading) => reading && learn(reading), this.clock);
  }

  /** @param {Reading} reading of a picture that moves */
  #learn(reading) {
    if (reading.low > TARGET_MS) {
      this.#slow += 1;
      if (this.#slow < 2 && reading.low < 2 * TARGET_MS) return; // one alone may be another's fault
      this.share = smallerShare(this.share, reading.low);
      this.#calm = CALM;
    } else if (this.#calm > 0) this.#calm -= 1;
    else this.share = largerShare(this.share, reading);
    if (reading.low <= TARGET_MS) this.#slow = 0;
  }
}
