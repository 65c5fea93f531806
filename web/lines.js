/** A view as one line: for a shell, and for Python. */

/**
 * The parameters that say what the scene's defaults do not, and the isovalue in any case.
 * @param {object} scene answer of `readScene`
 * @param {Record<string, string|number>} query parameters of a frame request
 * @returns {Record<string, string|number>}
 */
export function tellingParts(scene, query) {
  const defaults = { ...scene.defaults, overlay: "none", f: "png" };
  const telling = ([name, value]) => name === "isovalue" || String(value) !== String(defaults[name]);
  return Object.fromEntries(Object.entries(query).filter(telling));
}

/**
 * A line for a shell that saves the picture. It names the variable that holds the token, never the token.
 * @param {URL} address of the frame
 * @param {string} file
 * @param {boolean} token whether the server wants one
 * @returns {string}
 */
export function curlLine(address, file, token) {
  const shown = token ? ['-H "Authorization: Bearer $ISOGI_TOKEN"'] : [];
  return ["curl -f", ...shown, quoted(address.href), "-o", plain(file) ? file : quoted(file)].join(" ");
}

/**
 * A line of Python that saves the final picture; the client finds the token in the environment itself.
 * @param {string} server address of the server
 * @param {string} scene
 * @param {Record<string, string|number>} view
 * @param {string} file
 * @returns {string}
 */
export function pythonLine(server, scene, view, file) {
  const knobs = Object.entries(view).map(([name, value]) => `, ${name}=${literal(value)}`).join("");
  const frame = `frame(${literal(scene)}${knobs}, wait="final")`;
  return `from isogi_client import Isogi; Isogi(${literal(server)}).${frame}.save(${literal(file)})`;
}

function literal(value) {
  return JSON.stringify(value);
}

function plain(word) {
  return /^[\w.+-]+$/.test(word);
}

function quoted(word) {
  return `'${word.replaceAll("'", "'\\''")}'`;
}
