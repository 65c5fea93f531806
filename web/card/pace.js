/** How many pixels a card draws of a picture that moves: fewer while it is slow, by itself. */

const TARGET_MS = 20; // of a picture
const SLOW_MS = 1000 / 30; // of a picture that may have fewer pixels than LEAST of the width allows
const LEAST = 0.6; // share of the width, on a card that reaches 30 pictures a second there
const FEWEST = 0.2; // share of the width on any card
const GROWTH = 1.25; // of the width from picture to picture, at most
const WORTH = 1.1; // growth that is worth another size
const CALM = 60; // pictures after one that was too slow, before they grow again

/**
 * The share of the width that the next picture is to have.
 * @param {number} share of the last one
 * @param {number} ms that it took
 * @returns {number}
 */
export function nextShare(share, ms) {
  const wanted = share * Math.sqrt(TARGET_MS / ms);
  if (wanted >= share) return wanted < WORTH * share ? share : Math.min(wanted, GROWTH * share, 1);
  const atLeast = ms * (LEAST / share) ** 2;
  const bearable =
    atLeast <= SLOW_MS ? Math.max(wanted, Math.min(LEAST, share)) : share * Math.sqrt(SLOW_MS / ms);
  return Math.max(bearable, FEWEST);
}

/** The pace of a card. */
export class Pace {
  /** @param {WebGL2RenderingContext} gl @param {() => number} [now] milliseconds */
  constructor(gl, now = () => performance.now()) {
    this.gl = gl;
    this.now = now;
    this.share = 1;
    this.calm = 0;
    /** @type {{fence: WebGLSync, began: number, learns: boolean}|null} */
    this.pending = null;
  }

  /**
   * Whether the card still draws what it was asked for last; a picture more would only wait.
   * @returns {boolean}
   */
  get busy() {
    const { gl, pending } = this;
    if (!pending) return false;
    const state = gl.clientWaitSync(pending.fence, gl.SYNC_FLUSH_COMMANDS_BIT, 0);
    if (state === gl.TIMEOUT_EXPIRED) return true;
    gl.deleteSync(pending.fence);
    this.pending = null;
    if (pending.learns) this.#learn(this.now() - pending.began);
    return false;
  }

  /**
   * Wait for the picture that was just asked for.
   * @param {boolean} [learns] whether its time says how large the next may be
   */
  time(learns = true) {
    const fence = this.gl.fenceSync(this.gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    if (fence) this.pending = { fence, began: this.now(), learns };
    this.gl.flush();
  }

  /** @param {number} ms */
  #learn(ms) {
    const share = nextShare(this.share, Math.max(ms, 1));
    this.calm = share < this.share ? CALM : Math.max(this.calm - 1, 0);
    if (share < this.share || this.calm === 0) this.share = share;
  }
}
