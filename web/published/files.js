/** The files of a published page: those that are in it, and those beside it, unpacked. */

const TOGETHER = 6; // requests at a time: a server that is far away is never idle

/**
 * @typedef {object} Light what is known of the light
 * @property {string[]} files those of the first view first
 * @property {number[]} steps of the codes of transfer
 * @property {[number, number]} isovalues whose light is there
 * @property {{likely: number, low: number, high: number}} error relative, of pictures, and its 95 %
 *   interval
 * @property {number} views that it was measured in
 * @property {number} bytes of the page
 * @property {"page"|"light"|"dark"} background
 * @property {string} caption "" for none
 *
 * @typedef {{aspect: number, distance: number, target: import("../view/rotation.js").Vec3}} Fit
 *   where the first camera sees the surface whole in stages of that width over height, and in wider
 *   ones
 *
 * @typedef {object} Published
 * @property {import("../net/schemas.js").Scene & {fits: Fit[]}} scene `fits` from narrow to wide;
 *   none of a camera that was placed
 * @property {import("../card/document.js").CardDocument} card
 * @property {Light} light
 */

/** The page's document. @returns {Promise<Published>} @throws {Error} where it does not come */
export async function readDocument() {
  return JSON.parse(await readText("scene.json"));
}

/** The text of a file. @param {string} name @returns {Promise<string>} */
export async function readText(name) {
  return new TextDecoder().decode(await readFile(name));
}

/**
 * A file as it was before it was packed: some servers unpack it themselves.
 * @param {string} name
 * @returns {Promise<ArrayBuffer>}
 * @throws {Error} where it does not come
 */
export async function readFile(name) {
  const content = enclosed(name) ?? (await (await answerOf(name)).arrayBuffer());
  const [first, second] = new Uint8Array(content, 0, Math.min(content.byteLength, 2));
  if (first !== 0x1f || second !== 0x8b) return content;
  return new Response(
    new Blob([content]).stream().pipeThrough(new DecompressionStream("gzip")),
  ).arrayBuffer();
}

/**
 * Read files ahead, a few at a time, in their order.
 * @param {string[]} names
 * @param {Promise<unknown>} [after] when to begin
 * @returns {Promise<ArrayBuffer>[]} each file's, which may fail by itself
 */
export function readAhead(names, after = Promise.resolve()) {
  /** @type {Promise<unknown>[]} */
  const reading = [];
  return names.map((name, n) => {
    // A file is asked for once the one that is so many places before it has come.
    const before = reading[n - TOGETHER] ?? after.catch(() => {});
    const file = before.then(() => readFile(name));
    reading.push(file.catch(() => {}));
    return file;
  });
}

/** A file that is in the page; null where it is not. @param {string} name */
function enclosed(name) {
  const element = [...document.querySelectorAll("script[data-file]")].find(
    (each) => each.getAttribute("data-file") === name,
  );
  if (!element) return null;
  return Uint8Array.from(atob(element.textContent ?? ""), (letter) => letter.charCodeAt(0)).buffer;
}

const FROM_DISK =
  "Browsers load the parts of this page from a web server alone: put the folder on one, run “python -m http.server” in it and open http://localhost:8000, or have it published as one file.";

/** @param {string} name @returns {Promise<Response>} */
async function answerOf(name) {
  if (location.protocol === "file:") throw new Error(FROM_DISK);
  const answer = await fetch(name);
  if (!answer.ok) throw new Error(`The file ${name} did not come: HTTP ${answer.status}.`);
  return answer;
}
