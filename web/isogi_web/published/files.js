/** The files of a published page: those that are enclosed in it, and those next to it, unpacked. */

const TOGETHER = 6; // requests at a time, so that a server that is far away is never idle

/**
 * @typedef {object} Light the light of the page
 * @property {{file: string, steps: number[]}} coarse name of the file with means of bricks, which
 *   stand in for texels, and quantization steps of their transfer
 * @property {string[]} files names of files with texels, those of the first view first
 * @property {number[]} steps quantization steps of texels' transfer
 * @property {[number, number]} isovalues range of isovalues with light
 * @property {{likely: number, low: number, high: number}} error relative error of pictures, and its
 *   95 % interval
 * @property {number} views number of views that the error was measured in
 * @property {number} bytes size of the page
 * @property {"page"|"light"|"dark"} background
 * @property {string} caption "" for none
 *
 * @typedef {{aspect: number, distance: number, target: import("../view/rotation.js").Vec3}} Fit
 *   the camera that sees the whole surface in stages of this width over height, and in wider ones
 *
 * @typedef {object} Published
 * @property {import("../net/schemas.js").Scene & {fits: Fit[]}} scene `fits` from narrow to wide;
 *   none if the scene places its camera
 * @property {import("../card/document.js").CardDocument} card
 * @property {Light} light
 */

/** Read the page's document. @returns {Promise<Published>} @throws {Error} if it cannot be read */
export async function readDocument() {
  return JSON.parse(await readText("scene.json"));
}

/**
 * Read a file as text.
 * @param {string} name
 * @returns {Promise<string>}
 * @throws {Error} if it cannot be read
 */
export async function readText(name) {
  return new TextDecoder().decode(await readFile(name));
}

/**
 * Read a file, and unpack it if it is compressed by gzip; some servers unpack files themselves.
 * @param {string} name
 * @returns {Promise<ArrayBuffer>}
 * @throws {Error} if it cannot be read
 */
export async function readFile(name) {
  const content = enclosed(name) ?? (await (await answerOf(name)).arrayBuffer());
  // A gzip file begins with 1f 8b.
  const [first, second] = new Uint8Array(content, 0, Math.min(content.byteLength, 2));
  if (first !== 0x1f || second !== 0x8b) return content;
  return new Response(
    new Blob([content]).stream().pipeThrough(new DecompressionStream("gzip")),
  ).arrayBuffer();
}

/**
 * Read files ahead in their order, a few at a time.
 * @param {string[]} names
 * @param {Promise<unknown>} [after] delays the first requests until it is settled
 * @returns {Promise<ArrayBuffer>[]} a promise per file; each may fail by itself
 */
export function readAhead(names, after = Promise.resolve()) {
  /** @type {Promise<unknown>[]} */
  const reading = [];
  return names.map((name, n) => {
    // Wait for the file that is TOGETHER places before: at most as many requests are open.
    const before = reading[n - TOGETHER] ?? after.catch(() => {});
    const file = before.then(() => readFile(name));
    reading.push(file.catch(() => {}));
    return file;
  });
}

/** Return a file that is enclosed in the page; null if it is not. @param {string} name */
function enclosed(name) {
  const element = [...document.querySelectorAll("script[data-file]")].find(
    (each) => each.getAttribute("data-file") === name,
  );
  if (!element) return null;
  return Uint8Array.from(atob(element.textContent ?? ""), (letter) => letter.charCodeAt(0)).buffer;
}

const FROM_DISK =
  "Browsers load the parts of this page from a web server alone: put the folder on one, run “python -m http.server” in it and open http://localhost:8000, or have it published as one file.";

/**
 * Request a file from the page's server.
 * @param {string} name
 * @returns {Promise<Response>}
 * @throws {Error} if it cannot be read
 */
async function answerOf(name) {
  if (location.protocol === "file:") throw new Error(FROM_DISK);
  const answer = await fetch(name);
  if (!answer.ok) throw new Error(`The file ${name} did not come: HTTP ${answer.status}.`);
  return answer;
}
