/** The files of a published page: the document, the volume's slabs, and the light, unpacked. */

/**
 * @typedef {object} Light what is known of the light
 * @property {string[]} files
 * @property {number[]} steps of the codes of transfer
 * @property {[number, number]} isovalues whose light is there
 * @property {{likely: number, low: number, high: number}} error relative, of pictures, and its 95 %
 *   interval
 * @property {number} views that it was measured in
 * @property {number} bytes of the page
 * @property {"page"|"light"|"dark"} background
 *
 * @typedef {object} Published
 * @property {import("../net/schemas.js").Scene} scene
 * @property {import("../card/document.js").CardDocument} card
 * @property {Light} light
 */

/** The page's document. @returns {Promise<Published>} @throws {Error} where it does not come */
export async function readDocument() {
  return (await answerOf("scene.json")).json();
}

/**
 * A file as it was before it was packed: some servers unpack it themselves.
 * @param {string} name
 * @returns {Promise<ArrayBuffer>}
 * @throws {Error} where it does not come
 */
export async function readFile(name) {
  const content = await (await answerOf(name)).arrayBuffer();
  const [first, second] = new Uint8Array(content, 0, Math.min(content.byteLength, 2));
  if (first !== 0x1f || second !== 0x8b) return content;
  return new Response(
    new Blob([content]).stream().pipeThrough(new DecompressionStream("gzip")),
  ).arrayBuffer();
}

/** @param {string} name @returns {Promise<Response>} */
async function answerOf(name) {
  const answer = await fetch(name);
  if (!answer.ok) throw new Error(`The file ${name} did not come: HTTP ${answer.status}.`);
  return answer;
}
