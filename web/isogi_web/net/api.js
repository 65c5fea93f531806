/**
 * The requests of the HTTP API that the page makes. Addresses are relative, so that the page works
 * behind a path prefix.
 */

import { valuesOfGreys } from "./bytes.js";
import { PROJECTIONS, rayThrough } from "../view/camera.js";
import { frameQuery } from "./request.js";
import { readFacts } from "./schemas.js";
import { Trouble, lost, retryDelay, troubleOf } from "./trouble.js";

/** @typedef {import("./schemas.js").Frame} Frame */
/** @typedef {import("./schemas.js").FrameQuery} FrameQuery */
/** @typedef {import("./schemas.js").Scene} Scene */
/** @typedef {import("../documents.js").SceneList} SceneList */
/** @typedef {import("./schemas.js").SurfacePoint} SurfacePoint */
/** @typedef {import("../view/model.js").Knobs} Knobs */
/** @typedef {import("../view/rotation.js").Vec3} Vec3 */

const ONE_PIXEL = { f: "npy", shading: "lambert", width: 1, height: 1 };

/** Parameters of a view that the shape of its surface depends on. */
const OF_SIZE = ["isovalue", "cut", "time", "smooth", "hide"];

/** Parameters of a view that its visible surfaces depend on. */
const OF_SURFACE = [...OF_SIZE, "window", "surfaces"];

const PIXEL_BYTES = 36; // nine floats: three of light, hit, state, error, three of position
const [HIT, POSITION] = [12, 24]; // places in a pixel, bytes

/**
 * List the scenes, and the limits of uploads.
 * @returns {Promise<SceneList>}
 * @throws {Trouble} if the server does not answer, or reports a problem; so do all requests of this
 *   module
 */
export async function listScenes() {
  return (await ask("v1/scenes")).json();
}

/**
 * @typedef {object} Readiness
 * @property {boolean} ready true if the server draws pictures
 * @property {{done: number, total: number, seconds?: number}} [compiling] numbers of kernels, and
 *   the time left
 */

/**
 * Ask whether the server is ready to draw pictures.
 * @returns {Promise<Readiness|null>} null if it does not answer
 */
export async function readReadiness() {
  try {
    return await (await fetch(new URL("readyz", document.baseURI))).json();
  } catch {
    return null;
  }
}

/**
 * Upload a volume, or a light probe, with an `XMLHttpRequest`: `fetch` reports no progress.
 * @param {"volumes"|"environments"} kind
 * @param {Blob} file
 * @param {string} name
 * @param {(share: number) => void} progress is called with the share that was sent, 0 to 1
 * @returns {Promise<{id: string}>}
 */
export function sendFile(kind, file, name, progress) {
  const request = new XMLHttpRequest();
  request.open("POST", new URL(`v1/${kind}?${new URLSearchParams({ name })}`, document.baseURI));
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
 * Delete an upload.
 * @param {string} href address of the upload
 * @returns {Promise<void>}
 */
export async function deleteUpload(href) {
  await ask(href.replace(/^\//, ""), { method: "DELETE" });
}

/**
 * Read the document of a scene, and the camera that shows its surface as a whole.
 * @param {string} id
 * @param {{width: number, height: number}} size of the picture
 * @param {Partial<Pick<Knobs, "isovalue"|"projection">>} [knobs] knobs of the view; the scene's
 *   defaults replace those that are missing or out of range
 * @returns {Promise<Scene>}
 */
export async function readScene(id, { width, height }, { isovalue, projection } = {}) {
  const asked = new URLSearchParams({ width: String(width), height: String(height) });
  const fit = async () => {
    if (PROJECTIONS.some((each) => each === projection))
      asked.set("projection", String(projection));
    return (await ask(`${scenePath(id)}/fit?${asked}`)).json();
  };
  // Make both requests at once if the camera does not depend on the scene's ranges: the server may
  // be far away.
  const coming = ask(scenePath(id));
  const early = isovalue === undefined ? fit() : null;
  early?.catch(() => {}); // trouble with the scene itself is reported instead
  const scene = await (await coming).json();
  const { min, max } = scene.ranges?.isovalue ?? {};
  if (isovalue !== undefined && isovalue >= min && isovalue <= max)
    asked.set("isovalue", String(isovalue));
  return { ...scene, start: { ...scene.view, ...(await (early ?? fit())) } };
}

/**
 * Check that the server has a scene.
 * @param {string} id
 * @returns {Promise<void>}
 * @throws {Trouble} if it has not, or does not answer
 */
export async function probeScene(id) {
  try {
    await ask(scenePath(id));
  } catch (error) {
    if (!(error instanceof Trouble && error.status === 404)) throw error;
    const detail = `The server was restarted, and has no scene “${id}”.`;
    throw new Trouble("The server has another scene", detail, { status: 404, retry: true });
  }
}

/**
 * Read the parts of a scene's document that depend on its light or its material.
 * @param {string} id
 * @param {Partial<Pick<Knobs, "environment"|"material">>} knobs of the view; "" stands for the
 *   scene's light or material
 * @returns {Promise<Pick<Scene, "lights"|"plan"|"defaults"|"rotating"|"turns"|"turn_step">>}
 */
export async function readLight(id, { environment, material }) {
  const query = new URLSearchParams({
    ...(environment && { environment }),
    ...(material && { material }),
  });
  const { lights, plan, defaults, rotating, turns, turn_step } = await (
    await ask(`${scenePath(id)}?${query}`)
  ).json();
  return { lights, plan, defaults, rotating, turns, turn_step };
}

/**
 * Request one frame. With `etag`, an unchanged frame has `blob: null`.
 * @param {string} scene
 * @param {FrameQuery} query
 * @param {{etag?: string|null, signal?: AbortSignal}} options
 * @returns {Promise<Frame>}
 */
export async function readFrame(scene, query, { etag, signal } = {}) {
  /** @type {Record<string, string>} */
  const headers = etag ? { "If-None-Match": etag } : {};
  const answer = await ask(frameAddress(scene, query), { headers, signal });
  const unchanged = answer.status === 304;
  return {
    blob: unchanged ? null : await bodyOf(answer),
    etag: answer.headers.get("ETag") ?? (unchanged && etag ? etag : null),
    facts: readFacts(answer.headers),
  };
}

/**
 * Return the world position of the surface at a place of the picture; null if there is no surface,
 * or no answer.
 * @param {Scene} scene
 * @param {Knobs} values knobs of the view
 * @param {number} right distance to the right of the middle, heights of the picture
 * @param {number} up distance above the middle, heights of the picture
 * @returns {Promise<Vec3|null>}
 */
export async function readSurfacePoint(scene, values, right, up) {
  const ray = Object.entries(rayThrough(scene, values, right, up)).map(([name, point]) => [
    name,
    point.join(","),
  ]);
  const view = Object.entries(frameQuery(scene, values, ONE_PIXEL)).filter(([name]) =>
    OF_SURFACE.includes(name),
  );
  const query = { ...ONE_PIXEL, ...Object.fromEntries([...view, ...ray]) };
  return persistently(async () => {
    const { blob } = await readFrame(scene.id, query);
    return blob && surfacePoint(await blob.arrayBuffer());
  });
}

/** Waits before the request of a click is repeated while the server is busy, milliseconds. */
const AGAIN_MS = [300, 1000, 3000];

/**
 * Repeat a request while the server is busy. Return null if it stays busy: the picture's requests
 * report the trouble.
 * @template T
 * @param {() => Promise<T>} read
 * @returns {Promise<T|null>}
 */
async function persistently(read) {
  for (let failures = 0; ; failures += 1) {
    try {
      return await read();
    } catch (error) {
      if (!(error instanceof Trouble)) throw error;
      const delay = failures < AGAIN_MS.length ? retryDelay(error, failures, AGAIN_MS) : null;
      if (delay === null) return null;
      await new Promise((done) => {
        setTimeout(done, delay);
      });
    }
  }
}

/**
 * Describe the surface at one pixel of a view; null if there is no surface, or no answer.
 * @param {string} scene
 * @param {FrameQuery} query parameters of the view, and the place: see `pointQuery`
 * @returns {Promise<SurfacePoint|null>}
 */
export async function readPoint(scene, query) {
  return persistently(async () => {
    const { hit, ...point } = await (await ask(sceneAddress(scene, "point", query))).json();
    return hit ? point : null;
  });
}

/**
 * Return the area and volume of a view's surface.
 * @param {Scene} scene
 * @param {Knobs} values knobs of the view
 * @param {AbortSignal} signal
 * @returns {Promise<import("../documents.js").Size>}
 */
export async function readSize(scene, values, signal) {
  const query = Object.entries(frameQuery(scene, values, ONE_PIXEL)).filter(([name]) =>
    OF_SIZE.includes(name),
  );
  return (await ask(sceneAddress(scene.id, "size", Object.fromEntries(query)), { signal })).json();
}

/**
 * Return the world position in the last pixel of an `npy` frame; null if it shows no surface.
 * @param {ArrayBuffer} frame
 * @returns {Vec3|null}
 */
export function surfacePoint(frame) {
  const pixel = new DataView(frame, frame.byteLength - PIXEL_BYTES);
  const position = (/** @type {number} */ i) => pixel.getFloat32(POSITION + 4 * i, true);
  return pixel.getFloat32(HIT, true) > 0 ? [position(0), position(1), position(2)] : null;
}

/**
 * Return a picture of the light around a scene: latitude and longitude, tone-mapped, not rotated.
 * @param {string} scene
 * @param {number} width pixels
 * @param {string} environment "" for the scene's light
 * @returns {Promise<Blob>}
 */
export async function readSky(scene, width, environment) {
  const query = { width: String(width), ...(environment && { environment }) };
  return bodyOf(await ask(`${scenePath(scene)}/sky?${new URLSearchParams(query)}`));
}

/**
 * Return the complete address of a frame, for other programs.
 * @param {string} scene
 * @param {FrameQuery} query
 * @returns {URL}
 */
export function frameAddress(scene, query) {
  return sceneAddress(scene, "frame", query);
}

/**
 * Return the values on a slice through a scene's volume as an `npy` file; null if the server does
 * not answer.
 *
 * If the server does not give out values, they are read from a picture of the slice, in 256 steps
 * of grey.
 *
 * @param {Scene} scene
 * @param {"x"|"y"|"z"} axis axis that the slice is perpendicular to
 * @param {number} at voxel index on that axis
 * @param {string} voxels parameters that select voxels, see `voxelsOf`
 * @returns {Promise<ArrayBuffer|null>}
 */
export async function readSlice(scene, axis, at, voxels) {
  const query = { axis, at, ...Object.fromEntries(new URLSearchParams(voxels)) };
  const read = (/** @type {FrameQuery} */ more) =>
    ask(sceneAddress(scene.id, "slice", { ...query, ...more }));
  return persistently(async () => {
    try {
      return await (await read({ f: "npy" })).arrayBuffer();
    } catch (error) {
      if (!(error instanceof Trouble) || error.status !== 403) throw error;
    }
    // The histogram spans all values: its ends are black and white.
    const { edges } = scene.histogram;
    const [low, high] = [edges[0], edges[edges.length - 1]];
    const picture = await createImageBitmap(await bodyOf(await read({ f: "png", low, high })));
    const canvas = new OffscreenCanvas(picture.width, picture.height);
    const context = /** @type {OffscreenCanvasRenderingContext2D} */ (canvas.getContext("2d"));
    context.drawImage(picture, 0, 0);
    return valuesOfGreys(context.getImageData(0, 0, picture.width, picture.height), [low, high]);
  });
}

/**
 * Ask whether a graphics card can draw a view of a scene, and for the document that it needs.
 * @param {string} scene
 * @param {FrameQuery} query
 * @returns {Promise<import("../documents.js").Card>}
 */
export async function readCard(scene, query) {
  return (await ask(sceneAddress(scene, "card", query))).json();
}

/**
 * Return the bytes at an address of that document.
 * @param {string} scene
 * @param {string} href
 * @returns {Promise<ArrayBuffer>}
 */
export async function readCardBytes(scene, href) {
  return (await ask(new URL(href, sceneAddress(scene, "card", {})))).arrayBuffer().catch(failed);
}

/**
 * Return the chunks of texels that a view reads, most visible first.
 * @param {string} scene
 * @param {FrameQuery} query
 * @returns {Promise<import("../documents.js").CardChunk[]>}
 */
export async function readChunks(scene, query) {
  return (await (await ask(sceneAddress(scene, "card/chunks", query))).json()).chunks;
}

/**
 * Return light of some chunks, or their raw transfer.
 * @param {string} scene
 * @param {"light"|"transfer"} what
 * @param {string[]} chunks names of chunks: place-version
 * @param {FrameQuery} query
 * @returns {Promise<ArrayBuffer>}
 */
export async function readBlocks(scene, what, chunks, query) {
  return (await ask(sceneAddress(scene, `card/${what}/${chunks.join(",")}`, query)))
    .arrayBuffer()
    .catch(failed);
}

/**
 * Begin to export the surface, or the volume, with its light, and return the address of the job.
 * @param {string} scene
 * @param {FrameQuery} query
 * @returns {Promise<string>}
 */
export async function beginExport(scene, query) {
  const texts = Object.entries(query).map(([name, value]) => [name, String(value)]);
  const answer = await ask(`${scenePath(scene)}/export?${new URLSearchParams(texts)}`, {
    method: "POST",
  });
  return `v1/jobs/${(await answer.json()).jobID}`;
}

/**
 * Return the state of a job.
 * @param {string} address
 * @returns {Promise<import("../documents.js").Job>}
 */
export async function readJob(address) {
  return (await ask(address)).json();
}

/** Stop a job; the request outlives the page. @param {string} address */
export async function stopJob(address) {
  await ask(address, { method: "DELETE", keepalive: true });
}

/**
 * Return true if the server asks programs without this browser's cookie for a token.
 * @returns {Promise<boolean>}
 */
export async function wantsToken() {
  // Only a server with a token marks its answers as private.
  return (await ask("v1/scenes")).headers.get("Cache-Control")?.includes("private") ?? false;
}

/**
 * Open the stream of one scene.
 * @param {string} scene
 * @returns {WebSocket}
 * @throws {Error} if the browser has no sockets
 */
export function openStream(scene) {
  const address = new URL(`${scenePath(scene)}/stream`, document.baseURI);
  address.protocol = address.protocol.replace("http", "ws");
  return new WebSocket(address);
}

/**
 * Return the address of a resource of a scene.
 * @param {string} scene
 * @param {string} what name of the resource
 * @param {FrameQuery} query
 */
function sceneAddress(scene, what, query) {
  const texts = Object.entries(query).map(([name, value]) => [name, String(value)]);
  return new URL(`${scenePath(scene)}/${what}?${new URLSearchParams(texts)}`, document.baseURI);
}

/** Return the relative address of a scene. @param {string} id */
function scenePath(id) {
  return `v1/scenes/${encodeURIComponent(id)}`;
}

/**
 * Make a request, and return its answer if that is good or unchanged.
 * @param {string|URL} path
 * @param {RequestInit} [options]
 * @throws {Trouble} if the server does not answer, or reports a problem
 */
async function ask(path, options) {
  const answer = await fetch(new URL(path, document.baseURI), options).catch(failed);
  if (answer.ok || answer.status === 304) return answer;
  const problem = await answer.json().catch(() => ({}));
  throw troubleOf(
    { ...problem, status: answer.status },
    Number(answer.headers.get("Retry-After")) || 0,
  );
}

/** Return the body of an answer. @param {Response} answer */
async function bodyOf(answer) {
  return answer.blob().catch(failed);
}

/**
 * Throw `lost()` for any failure of the network; an aborted request keeps its error.
 * @param {Error} error
 * @returns {never}
 */
function failed(error) {
  throw error.name === "AbortError" ? error : lost();
}
