/** Waiting for the final picture of one view, however long that takes and through losses of the server. */

import { readFrame } from "./api.js";

const WAIT_MS = 3000; // how long one request may wait for light
const PAUSE_MS = 500; // between two requests where the server has nothing to wait for, or does not answer
const VAIN = 4; // answers in a row without anything new, and without a wait, after which no light is coming

/**
 * Pictures of a view, each better than the one before; the last is final, unless no more light is coming.
 * @param {string} scene
 * @param {Record<string, string|number>} query parameters of the frame request
 * @param {AbortSignal} signal
 * @param {(trouble: import("./api.js").Trouble) => void} onTrouble hears that the server is away, or busy
 * @returns {AsyncGenerator<{blob: Blob, facts: import("./api.js").Facts}>}
 */
export async function* untilFinal(scene, query, signal, onTrouble) {
  let [etag, facts, vain, wait] = [null, null, 0, 0];
  while (facts?.provisional !== false && vain < VAIN) {
    const began = performance.now();
    try {
      const frame = await readFrame(scene, { ...query, wait_ms: wait }, { etag, signal });
      ({ etag, facts } = { etag: frame.etag, facts: frame.facts ?? facts });
      if (frame.blob) yield { blob: frame.blob, facts };
      vain = frame.blob || performance.now() - began > wait / 2 ? 0 : vain + 1;
      wait = WAIT_MS;
      if (vain) await pause(PAUSE_MS, signal);
    } catch (error) {
      if (!error.retry) throw error;
      onTrouble(error);
      await pause(1000 * error.after || PAUSE_MS, signal);
    }
  }
}

function pause(milliseconds, signal) {
  return new Promise((resolve, reject) => {
    const timer = setTimeout(resolve, milliseconds);
    signal.addEventListener("abort", () => {
      clearTimeout(timer);
      reject(signal.reason);
    }, { once: true });
  });
}
