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
 * @property {Record<string, number>} timing milliseconds of each stage of its making
 */

const GONE = "The page keeps asking and continues by itself when the server is back.";

/**
 * List the scenes, and what may be uploaded: null where nothing may.
 * @param {AbortSignal} [signal]
 * @returns {Promise<{scenes: {id: string, name: string, volume: string|null}[], uploads: object|null}>}
 */
export async function listScenes(signal) {
  return (await ask("v1/scenes", { signal })).json();
}

/**
 * Upload a volume. `fetch` does not tell how far it is.
 * @param {Blob} file
 * @param {string} name
 * @param {(share: number) => void} progress
 * @returns {Promise<{id: string}>}
 */
export function sendVolume(file, name, progress) {
  const request = new XMLHttpRequest();
  request.open("POST", new URL(`v1/volumes?${new URLSearchParams({ name })}`, document.baseURI));
  request.responseType = "json";
  request.upload.addEventListener("progress", ({ loaded, total }) => progress(loaded / total));
  return new Promise((resolve, reject) => {
    request.addEventListener("error", () => reject(lost()));
    request.addEventListener("load", () => {
      const { status, response } = request;
      if (status < 300) resolve(response);
      else reject(troubleOf({ ...response, status }));
    });
    request.send(file);
  });
}

/**
 * Delete an uploaded volume.
 * @param {string} href its address
 */
export async function deleteVolume(href) {
  await ask(href.replace(/^\//, ""), { method: "DELETE" });
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
  const answer = await ask(frameAddress(scene, query), { headers, signal });
  const unchanged = answer.status === 304;
  return {
    blob: unchanged ? null : await bodyOf(answer),
    etag: answer.headers.get("ETag") ?? (unchanged ? etag : null),
    facts: answer.headers.has("Isogi-Provisional") ? factsOf(answer.headers) : null,
  };
}

/**
 * A picture of the light around a scene: latitude and longitude, tone-mapped, not turned.
 * @param {string} scene
 * @param {number} width pixels
 * @returns {Promise<Blob>}
 */
export async function readSky(scene, width) {
  return bodyOf(await ask(`${scenePath(scene)}/sky?${new URLSearchParams({ width })}`));
}

/**
 * The whole address of a frame, as others may ask for it.
 * @param {string} scene
 * @param {Record<string, string|number>} query
 * @returns {URL}
 */
export function frameAddress(scene, query) {
  return new URL(`${scenePath(scene)}/frame?${new URLSearchParams(query)}`, document.baseURI);
}

/** Whether the server wants a token of those who have not this browser's cookie. @returns {Promise<boolean>} */
export async function wantsToken() {
  return (await ask("v1/scenes")).headers.get("Cache-Control")?.includes("private") ?? false; // as behind a token only
}

/**
 * Open the stream of one scene. Throws where the browser has no sockets.
 * @param {string} scene
 * @returns {WebSocket}
 */
export function openStream(scene) {
  const address = new URL(`${scenePath(scene)}/stream`, document.baseURI);
  address.protocol = address.protocol.replace("http", "ws");
  return new WebSocket(address);
}

/**
 * A picture that came over a stream, and the facts that were told before it.
 * @param {{media_type: string, timing: object, facts: object}} told
 * @param {Blob} data
 * @returns {{blob: Blob, facts: Facts}}
 */
export function pictureOf({ media_type: type, timing, facts: { time_left: timeLeft, ...facts } }, data) {
  return { blob: new Blob([data], { type }), facts: { ...facts, timeLeft, timing } };
}

/** The trouble that there is no answer at all. @returns {Trouble} */
export function lost() {
  return new Trouble("The server does not answer", GONE, { retry: true });
}

/**
 * The trouble that the server tells of in a problem document.
 * @param {{status?: number, detail?: string}} problem
 * @param {number} [after] seconds after which to ask again
 * @returns {Trouble}
 */
export function troubleOf({ status = 0, detail }, after = 0) {
  const retry = status >= 500 || status === 429;
  const title = retry ? "The server cannot draw this now" : "This view cannot be drawn";
  return new Trouble(title, typeof detail === "string" ? detail : `It answered with status ${status}.`, { status, retry, after });
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
    timing: parseTiming(headers.get("Server-Timing")),
  };
}

function parseTiming(text) {
  const stages = (text ?? "").split(",").map((stage) => stage.trim().split(";dur="));
  const named = stages.filter(([name, ms]) => ms && name !== "total");
  return Object.fromEntries(named.map(([name, ms]) => [name, Number(ms)]));
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
  return lost();
}

async function refusal(answer) {
  const problem = await answer.json().catch(() => ({}));
  return troubleOf({ ...problem, status: answer.status }, Number(answer.headers.get("Retry-After")) || 0);
}
