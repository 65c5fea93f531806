/**
 * Volumes and light probes of one's own: a file that is opened or dropped goes to the server, and
 * is shown; or deleted.
 */

import { find } from "../dom.js";
import { deleteUpload, readReadiness, sendFile } from "./api.js";
import { progressWords } from "./compiling.js";

/** @typedef {import("../documents.js").UploadLimits} UploadLimits */

const MEGABYTE = 1 << 20;
const LOOK_MS = 500; // between two looks at what the server compiles for a file

/**
 * Offer to open files, and to delete what was uploaded. Does nothing where the server takes no
 * uploads.
 * @param {HTMLElement} root holds the buttons `#upload-open` and `#upload-delete`, the
 *   `#upload-file` input and the
 *   `#upload-note` popover with a `p` and a `progress`
 * @param {HTMLElement} stage where files may be dropped
 * @param {UploadLimits|null} limits what may be uploaded
 * @param {{name: string, volume: string|null}} scene the one that is shown
 * @param {(scene: string|null) => void} show goes to a scene; to the first where it is null
 * @param {(environment: string) => void} light shows the scene in the light of an uploaded probe
 */
export function attachUpload(root, stage, limits, scene, show, light) {
  if (!limits) return;
  const [open, erase, note] = [
    find(root, "#upload-open"),
    find(root, "#upload-delete"),
    find(root, "#upload-note"),
  ];
  const file = find(root, "#upload-file", HTMLInputElement);
  /** @param {File|undefined} chosen */
  const send = (chosen) =>
    chosen &&
    upload(chosen, limits, note).then(
      ({ id }) => (isProbe(chosen.name) ? light(id) : show(id)),
      () => {},
    );
  root.hidden = false;
  erase.hidden = !scene.volume;
  open.addEventListener("click", () => file.click());
  file.addEventListener("change", () => {
    send(file.files?.[0]);
    file.value = "";
  });
  erase.addEventListener("click", async () => {
    if (!scene.volume || !confirm(`Delete the volume “${scene.name}” from the server?`)) return;
    await reporting(note, deleteUpload(scene.volume)).then(
      () => show(null),
      () => {},
    );
  });
  attachDrop(stage, send);
}

/**
 * Why a file may not be uploaded; "" where it may.
 * @param {{name: string, size: number}} file
 * @param {{limit_bytes: number}} limits
 * @returns {string}
 */
export function tooLarge(file, limits) {
  if (file.size <= limits.limit_bytes) return "";
  return `${file.name} is larger than the ${Math.floor(limits.limit_bytes / MEGABYTE)} MB that an upload may be.`;
}

/**
 * Whether a file is light and no volume, by its name.
 * @param {string} file
 * @returns {boolean}
 */
export function isProbe(file) {
  return /\.hdr$/i.test(file);
}

/**
 * The name of a file as a title: without its ending, and no longer than the server takes.
 * @param {string} file
 * @returns {string}
 */
export function volumeName(file) {
  return file
    .replace(/\.(hdr|nrrd|nhdr|nii(\.gz)?|dcm|tiff?|mrc|map|h5|hdf5|nc|npy|npz)$/i, "")
    .replace(/\p{C}/gu, "")
    .slice(0, 80);
}

/**
 * @param {HTMLElement} stage
 * @param {(file: File|undefined) => void} send
 */
function attachDrop(stage, send) {
  stage.addEventListener("dragover", (event) => {
    if (!event.dataTransfer?.types.includes("Files")) return;
    event.preventDefault();
    stage.toggleAttribute("data-drop", true);
  });
  stage.addEventListener("dragleave", () => stage.toggleAttribute("data-drop", false));
  stage.addEventListener("drop", (event) => {
    event.preventDefault();
    stage.toggleAttribute("data-drop", false);
    send(event.dataTransfer?.files[0]);
  });
}

/**
 * Send a file while the note says how far it is.
 * @param {File} file
 * @param {UploadLimits} limits
 * @param {HTMLElement} note
 * @returns {Promise<{id: string}>} the volume, or the environment
 */
function upload(file, limits, note) {
  const refusal = tooLarge(file, limits);
  if (refusal) return reporting(note, Promise.reject(new Error(refusal)));
  const bar = find(note, "progress", HTMLProgressElement);
  let [sent, done] = [false, false];
  /** @param {number} share */
  const progress = (share) => {
    if (sent) return;
    bar.hidden = false;
    if (share < 1) bar.value = share;
    else bar.removeAttribute("value"); // sent: the server reads it
    say(
      note,
      share < 1
        ? `Sending ${file.name}: ${Math.floor(100 * share)} %`
        : `The server reads ${file.name}…`,
    );
    sent = share >= 1;
    if (sent) watchCompiling(file, note, bar, () => done);
  };
  progress(0);
  return reporting(
    note,
    sendFile(
      isProbe(file.name) ? "environments" : "volumes",
      file,
      volumeName(file.name),
      progress,
    ),
  ).finally(() => {
    done = true;
    bar.hidden = true;
  });
}

/**
 * Say how far the server compiles what draws a file, where it must.
 * @param {File} file
 * @param {HTMLElement} note
 * @param {HTMLProgressElement} bar
 * @param {() => boolean} done whether the file is there, or was refused
 */
async function watchCompiling(file, note, bar, done) {
  for (
    ;
    !done();
    await new Promise((resolve) => {
      setTimeout(resolve, LOOK_MS);
    })
  ) {
    const compiling = (await readReadiness())?.compiling;
    if (!compiling || done()) continue;
    bar.value = compiling.done / compiling.total;
    say(note, progressWords(`Compiling what draws ${file.name}`, compiling));
  }
}

/**
 * The same promise; where it fails the note says why, until it is closed.
 * @template T
 * @param {HTMLElement} note
 * @param {Promise<T>} promise
 * @returns {Promise<T>}
 */
async function reporting(note, promise) {
  try {
    return await promise;
  } catch (error) {
    say(note, /** @type {Error} */ (error).message);
    throw error;
  }
}

/**
 * @param {HTMLElement} note
 * @param {string} text
 */
function say(note, text) {
  find(note, "p").textContent = text;
  note.showPopover();
}
