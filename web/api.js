/** The HTTP API, as far as the page needs it. Addresses are relative, so that a path prefix in front works. */

/** Something the server said, or that it said nothing. `retry` tells whether asking again can help. */
export class Trouble extends Error {
  /**
   * @param {string} title what is wrong, in a few words
   * @param {string} detail one sentence for a person
   * @param {{status?: number, retry?: boolean, after?: number}} [facts] `after` in seconds
   */
  constructor(title, detail, { status = 0, retry = false, after = 0 } = {}) {
    super(detail);
    Object.assign(this, { title, detail, status, retry, after });
  }
}

/**
 * @typedef {object} Facts what a frame says about itself
 * @property {boolean} provisional
 * @property {{final: number, converging: number, provisional: number}} coverage shares of the surface pixels
 * @property {number} error estimated relative RMSE; NaN where the server gives none
 * @property {{needed: number, final: number}} chunks
 * @property {{low: number, likely: number, high: number}|null} timeLeft seconds until all is final; null if unknown
 */

const GONE = "The page keeps asking and continues by itself when the server is back.";

/**
 * List the scenes.
 * @param {AbortSignal} [signal]
 * @returns {Promise<{id: string, name: string}[]>}
 */
export async function listScenes(signal) {
  return (await (await ask("v1/scenes", { signal })).json()).scenes;
}

/**
 * Everything about one scene: volume, histogram, defaults, ranges, plan.
 * @param {string} id
 * @param {AbortSignal} [signal]
 */
export async function readScene(id, signal) {
  return (await ask(scenePath(id), { signal })).json();
}

/**
 * Ask for one frame. With `etag`, an unchanged frame comes back with `blob: null`.
 * @param {string} scene
 * @param {Record<string, string|number>} query parameters of the contract's frame request
 * @param {{etag?: string|null, signal?: AbortSignal}} options
 * @returns {Promise<{blob: Blob|null, etag: string|null, facts: Facts|null}>}
 */
export async function readFrame(scene, query, { etag, signal } = {}) {
  const headers = etag ? { "If-None-Match": etag } : {};
  const answer = await ask(`${scenePath(scene)}/frame?${new URLSearchParams(query)}`, { headers, signal });
  const unchanged = answer.status === 304;
  return {
    blob: unchanged ? null : await bodyOf(answer),
    etag: answer.headers.get("ETag") ?? (unchanged ? etag : null),
    facts: answer.headers.has("Isogi-Provisional") ? factsOf(answer.headers) : null,
  };
}

/**
 * Read a header of the form `final=0.81, converging=0.12` into numbers.
 * @param {string|null} text
 * @returns {Record<string, number>}
 */
export function parseShares(text) {
  const pairs = (text ?? "").split(",").map((pair) => pair.trim().split("="));
  return Object.fromEntries(pairs.filter(([, number]) => number).map(([name, number]) => [name, Number(number)]));
}

function factsOf(headers) {
  return {
    provisional: headers.get("Isogi-Provisional") === "?1",
    coverage: { final: 0, converging: 0, provisional: 0, ...parseShares(headers.get("Isogi-Coverage")) },
    error: Number.parseFloat(headers.get("Isogi-Error")),
    chunks: { needed: 0, final: 0, ...parseShares(headers.get("Isogi-Chunks")) },
    timeLeft: headers.has("Isogi-Time-Left") ? parseShares(headers.get("Isogi-Time-Left")) : null,
  };
}

function scenePath(id) {
  return `v1/scenes/${encodeURIComponent(id)}`;
}

async function ask(path, options) {
  let answer;
  try {
    answer = await fetch(new URL(path, document.baseURI), options);
  } catch (error) {
    throw asTrouble(error);
  }
  if (answer.ok || answer.status === 304) return answer;
  throw await refusal(answer);
}

async function bodyOf(answer) {
  try {
    return await answer.blob();
  } catch (error) {
    throw asTrouble(error);
  }
}

function asTrouble(error) {
  if (error.name === "AbortError") return error;
  return new Trouble("The server does not answer", GONE, { retry: true });
}

async function refusal(answer) {
  const problem = await answer.json().catch(() => ({}));
  const retry = answer.status >= 500 || answer.status === 429;
  const title = retry ? "The server cannot draw this now" : "This view cannot be drawn";
  const detail = typeof problem.detail === "string" ? problem.detail : `It answered with status ${answer.status}.`;
  return new Trouble(title, detail, {
    status: answer.status, retry, after: Number(answer.headers.get("Retry-After")) || 0,
  });
}
