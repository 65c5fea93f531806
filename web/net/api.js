/**
 * The HTTP API, as far as the page needs it. Addresses are relative, so that a path prefix in front
 * works.
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
// parameters of a view that say what its surface is
const OF_SIZE = ["isovalue", "cut", "time", "smooth", "hide"];
// and what of it is seen, and what is beside it
const OF_SURFACE = [...OF_SIZE, "window", "surfaces"];
const PIXEL_BYTES = 36; // nine floats: three of light, hit, state, error, three of position
const [HIT, POSITION] = [12, 24]; // bytes from the pixel's first

/**
 * List the scenes, and what may be uploaded.
 * @returns {Promise<SceneList>}
 */
export async function listScenes() {
  return (await ask("v1/scenes")).json();
}

/**
 * @typedef {object} Readiness
 * @property {boolean} ready whether pictures are drawn
 * @property {{done: number, total: number, seconds?: number}} [compiling] kernels, and the time
 *   left
 */

/**
 * How ready the server is to draw pictures.
 * @returns {Promise<Readiness|null>} null where it does not answer
 */
export async function readReadiness() {
  try {
    return await (await fetch(new URL("readyz", document.baseURI))).json();
  } catch {
    return null;
  }
}

/**
 * Upload a volume, or a light probe. `fetch` reports no progress, so this is an `XMLHttpRequest`.
 * @param {"volumes"|"environments"} kind
 * @param {Blob} file
 * @param {string} name
 * @param {(share: number) => void} progress
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
 * Delete what was uploaded.
 * @param {string} href its address
 * @returns {Promise<void>}
 */
export async function deleteUpload(href) {
  await ask(href.replace(/^\//, ""), { method: "DELETE" });
}

/**
 * Everything about one scene: volume, histogram, defaults, ranges, plan, and the camera that shows
 * its surface whole.
 * @param {string} id
 * @param {{width: number, height: number}} size of the picture
 * @param {Partial<Pick<Knobs, "isovalue"|"projection">>} [knobs] of the view; the scene's where
 *   they are left out, or have no meaning
 * @returns {Promise<Scene>}
 */
export async function readScene(id, { width, height }, { isovalue, projection } = {}) {
  const asked = new URLSearchParams({ width: String(width), height: String(height) });
  const fit = async () => {
    if (PROJECTIONS.some((each) => each === projection))
      asked.set("projection", String(projection));
    return (await ask(`${scenePath(id)}/fit?${asked}`)).json();
  };
  const coming = ask(scenePath(id));
  // Both at once where the camera does not depend on what the scene allows: it may be far away.
  const early = isovalue === undefined ? fit() : null;
  early?.catch(() => {}); // the scene's own trouble says more
  const scene = await (await coming).json();
  const { min, max } = scene.ranges?.isovalue ?? {};
  if (isovalue !== undefined && isovalue >= min && isovalue <= max)
    asked.set("isovalue", String(isovalue));
  return { ...scene, start: { ...scene.view, ...(await (early ?? fit())) } };
}

/**
 * Ask whether the server has a scene.
 * @param {string} id
 * @returns {Promise<void>}
 * @throws {Trouble} where it has not, or does not answer
 */
export async function probeScene(id) {
  try {
    await ask(scenePath(id));
  } catch (error) {
    if (!(error instanceof Trouble && error.status === 404)) throw error;
    const detail = `It was started again, and has no scene “${id}”.`;
    throw new Trouble("The server has another scene", detail, { status: 404, retry: true });
  }
}

/**
 * What a scene is in other light, or of another material: what of its document depends on that.
 * @param {string} id
 * @param {Partial<Pick<Knobs, "environment"|"material">>} knobs of the view; "" for the scene's own
 * @returns {Promise<Pick<Scene, "lights"|"plan"|"defaults"|"rotating"|"turns">>}
 */
export async function readLight(id, { environment, material }) {
  const query = new URLSearchParams({
    ...(environment && { environment }),
    ...(material && { material }),
  });
  const { lights, plan, defaults, rotating, turns } = await (
    await ask(`${scenePath(id)}?${query}`)
  ).json();
  return { lights, plan, defaults, rotating, turns };
}

/**
 * Ask for one frame. With `etag`, an unchanged frame comes back with `blob: null`.
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
 * World position of the surface at a place of the picture; null where there is none, or no answer.
 * @param {Scene} scene
 * @param {Knobs} values knobs of the view
 * @param {number} right of the middle, in heights of the picture
 * @param {number} up of the middle, in heights of the picture
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

/** Milliseconds before what a click asks for is asked for again, while the server is busy. */
const AGAIN_MS = [300, 1000, 3000];

/**
 * What is read, also where a busy server answers late; null where it does not, and the picture's
 * own requests say why.
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
 * What the surface is like in one pixel of a view; null where there is none, or no answer.
 * @param {string} scene
 * @param {FrameQuery} query of the view, and the place: see `pointQuery`
 * @returns {Promise<SurfacePoint|null>}
 */
export async function readPoint(scene, query) {
  return persistently(async () => {
    const { hit, ...point } = await (await ask(sceneAddress(scene, "point", query))).json();
    return hit ? point : null;
  });
}

/**
 * How large a view's surface is.
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
 * World position in the last pixel of an `npy` frame; null where it shows no surface.
 * @param {ArrayBuffer} frame
 * @returns {Vec3|null}
 */
export function surfacePoint(frame) {
  const pixel = new DataView(frame, frame.byteLength - PIXEL_BYTES);
  const position = (/** @type {number} */ i) => pixel.getFloat32(POSITION + 4 * i, true);
  return pixel.getFloat32(HIT, true) > 0 ? [position(0), position(1), position(2)] : null;
}

/**
 * A picture of the light around a scene: latitude and longitude, tone-mapped, not turned.
 * @param {string} scene
 * @param {number} width pixels
 * @param {string} environment "" for the scene's own
 * @returns {Promise<Blob>}
 */
export async function readSky(scene, width, environment) {
  const query = { width: String(width), ...(environment && { environment }) };
  return bodyOf(await ask(`${scenePath(scene)}/sky?${new URLSearchParams(query)}`));
}

/**
 * The whole address of a frame, as others may ask for it.
 * @param {string} scene
 * @param {FrameQuery} query
 * @returns {URL}
 */
export function frameAddress(scene, query) {
  return sceneAddress(scene, "frame", query);
}

/**
 * The values on a slice through a scene's volume, as an `npy` file: in steps of a grey where the
 * server keeps them; null where it does not answer.
 * @param {Scene} scene
 * @param {"x"|"y"|"z"} axis of the voxels, that the plane is across
 * @param {number} at voxel index
 * @param {string} voxels parameters that say which voxels, see `voxelsOf`
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
 * Whether a graphics card can draw a view of a scene, and what it takes.
 * @param {string} scene
 * @param {FrameQuery} query
 * @returns {Promise<import("../documents.js").Card>}
 */
export async function readCard(scene, query) {
  return (await ask(sceneAddress(scene, "card", query))).json();
}

/**
 * Bytes at an address of that document.
 * @param {string} scene
 * @param {string} href
 * @returns {Promise<ArrayBuffer>}
 */
export async function readCardBytes(scene, href) {
  return (await ask(new URL(href, sceneAddress(scene, "card", {})))).arrayBuffer().catch(failed);
}

/**
 * The chunks of texels that a view reads, most visible first.
 * @param {string} scene
 * @param {FrameQuery} query
 * @returns {Promise<import("../documents.js").CardChunk[]>}
 */
export async function readChunks(scene, query) {
  return (await (await ask(sceneAddress(scene, "card/chunks", query))).json()).chunks;
}

/**
 * Light of some chunks, or the transfer that it is made of.
 * @param {string} scene
 * @param {"light"|"transfer"} what
 * @param {string[]} chunks by their places and versions
 * @param {FrameQuery} query
 * @returns {Promise<ArrayBuffer>}
 */
export async function readBlocks(scene, what, chunks, query) {
  return (await ask(sceneAddress(scene, `card/${what}/${chunks.join(",")}`, query)))
    .arrayBuffer()
    .catch(failed);
}

/**
 * Have a file made of the surface, or the volume, with its light: the address of the job.
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

/** How far a job is. @param {string} address @returns {Promise<import("../documents.js").Job>} */
export async function readJob(address) {
  return (await ask(address)).json();
}

/** End a job, also of a page that goes. @param {string} address */
export async function stopJob(address) {
  await ask(address, { method: "DELETE", keepalive: true });
}

/**
 * Whether the server wants a token from clients that have not this browser's cookie.
 * @returns {Promise<boolean>}
 */
export async function wantsToken() {
  // as behind a token only
  return (await ask("v1/scenes")).headers.get("Cache-Control")?.includes("private") ?? false;
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
 * @param {string} scene
 * @param {string} what is asked for of it
 * @param {FrameQuery} query
 */
function sceneAddress(scene, what, query) {
  const texts = Object.entries(query).map(([name, value]) => [name, String(value)]);
  return new URL(`${scenePath(scene)}/${what}?${new URLSearchParams(texts)}`, document.baseURI);
}

/** @param {string} id */
function scenePath(id) {
  return `v1/scenes/${encodeURIComponent(id)}`;
}

/**
 * @param {string|URL} path
 * @param {RequestInit} [options]
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

/** @param {Response} answer */
async function bodyOf(answer) {
  return answer.blob().catch(failed);
}

/**
 * Any failure of the network is the same trouble; what was aborted stays so.
 * @param {Error} error
 * @returns {never}
 */
function failed(error) {
  throw error.name === "AbortError" ? error : lost();
}
