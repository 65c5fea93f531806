/**
 * The visitor's volumes and light probes: files or a folder that are opened or dropped are sent to
 * the server and shown, or deleted from it.
 */

import { find } from "../dom.js";
import { deleteUpload, readReadiness, sendFile } from "./api.js";
import { zipOf } from "./bytes.js";
import { progressWords } from "./compiling.js";

/** @typedef {import("../documents.js").UploadLimits} UploadLimits */
/** @typedef {{path: string, file: File}} Chosen a file, and its path in the chosen folder */

const MEGABYTE = 1 << 20;
const LOOK_MS = 500; // time between two looks at kernels that the server compiles for a file

/**
 * Offer to open files, and to delete uploads. Does nothing if the server takes no uploads.
 * @param {HTMLElement} root holds the buttons `#upload-open`, `#upload-folder` and
 *   `#upload-delete`, the inputs `#upload-file` and `#upload-files`, and the `#upload-note` popover
 *   with a `p` and a `progress`
 * @param {HTMLElement} stage element that files may be dropped on
 * @param {UploadLimits|null} limits limits of uploads; null if there are none
 * @param {{name: string, volume: string|null}} scene the scene that is shown; `volume` is its
 *   address if it is an upload
 * @param {(scene: string|null) => void} show goes to a scene; null goes to the first one
 * @param {(environment: string) => void} light shows the scene in the light of an uploaded probe
 */
export function attachUpload(root, stage, limits, scene, show, light) {
  if (!limits) return;
  const [open, folder, erase, note] = [
    find(root, "#upload-open"),
    find(root, "#upload-folder"),
    find(root, "#upload-delete"),
    find(root, "#upload-note"),
  ];
  /** @param {Chosen[]} chosen */
  const send = (chosen) =>
    upload(chosen, limits, note).then(
      (sent) => sent && (sent.kind === "environments" ? light(sent.id) : show(sent.id)),
      () => {},
    );
  root.hidden = false;
  erase.hidden = !scene.volume;
  // The buttons open the browser's dialogs; the same file can be chosen again, as the input is
  // emptied.
  for (const [button, input] of [
    [open, find(root, "#upload-file", HTMLInputElement)],
    [folder, find(root, "#upload-files", HTMLInputElement)],
  ]) {
    button.addEventListener("click", () => input.click());
    input.addEventListener("change", () => {
      const files = [.../** @type {HTMLInputElement} */ (input).files ?? []];
      send(files.map((file) => ({ path: file.webkitRelativePath || file.name, file })));
      /** @type {HTMLInputElement} */ (input).value = "";
    });
  }
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
 * Return a sentence if files exceed the limits of an upload, otherwise "".
 * @param {{name: string, size: number}[]} files
 * @param {{limit_bytes: number, limit_files: number}} limits
 * @returns {string}
 */
export function tooLarge(files, limits) {
  const size = files.reduce((sum, file) => sum + file.size, 0);
  const most = `the ${Math.floor(limits.limit_bytes / MEGABYTE)} MB that an upload may be`;
  if (files.length > limits.limit_files)
    return `These are ${files.length} files; an upload may have ${limits.limit_files} at most.`;
  if (size <= limits.limit_bytes) return "";
  return files.length === 1
    ? `${files[0].name} is larger than ${most}.`
    : `These ${files.length} files are larger than ${most}, together.`;
}

/** Names of files that operating systems leave in folders. */
const NO_VOLUMES = /(^|\/)(\.|__MACOSX\/|DICOMDIR$|Thumbs\.db$|desktop\.ini$)/i;

/**
 * Return the files of a choice that may belong to a volume.
 * @template {{path: string}} T
 * @param {T[]} chosen
 * @returns {T[]} sorted by their paths
 */
export function ofVolumes(chosen) {
  return chosen
    .filter(({ path }) => !NO_VOLUMES.test(path))
    .sort((a, b) => (a.path < b.path ? -1 : 1));
}

/**
 * Return a name for several files: that of their folder, else of the header among them, else of the
 * first file.
 * @param {{path: string}[]} chosen
 * @returns {string}
 */
export function nameOfAll(chosen) {
  const [folder] = chosen[0].path.split("/");
  if (chosen.every(({ path }) => path.startsWith(`${folder}/`))) return folder;
  return (chosen.find(({ path }) => /\.nhdr$/i.test(path)) ?? chosen[0]).path;
}

/**
 * Return true if a file's name is that of a light probe.
 * @param {string} file
 * @returns {boolean}
 */
export function isProbe(file) {
  return /\.(hdr|exr)$/i.test(file);
}

/**
 * Make a title of a file's name: without its ending, and no longer than the server accepts.
 * @param {string} file
 * @returns {string}
 */
export function volumeName(file) {
  return file
    .replace(/\.(hdr|nrrd|nhdr|nii(\.gz)?|dcm|tiff?|mrc|map|h5|hdf5|nc|npy|npz|zip)$/i, "")
    .replace(/\p{C}/gu, "")
    .slice(0, 80);
}

/**
 * Send files that are dropped on the stage.
 * @param {HTMLElement} stage
 * @param {(chosen: Chosen[]) => void} send
 */
function attachDrop(stage, send) {
  stage.addEventListener("dragover", (event) => {
    if (!event.dataTransfer?.types.includes("Files")) return;
    event.preventDefault();
    stage.toggleAttribute("data-drop", true);
  });
  stage.addEventListener("dragleave", () => stage.toggleAttribute("data-drop", false));
  stage.addEventListener("drop", async (event) => {
    event.preventDefault();
    stage.toggleAttribute("data-drop", false);
    send(await dropped(event.dataTransfer));
  });
}

/**
 * Return all files that were dropped, including those in folders.
 * @param {DataTransfer|null} data
 * @returns {Promise<Chosen[]>}
 */
async function dropped(data) {
  // The data can be read only before the event's handler first waits.
  const files = [...(data?.files ?? [])];
  const entries = [...(data?.items ?? [])].map((item) => item.webkitGetAsEntry?.() ?? null);
  if (!entries.some((entry) => entry?.isDirectory))
    return files.map((file) => ({ path: file.name, file }));
  const found = await Promise.all(entries.map((entry) => (entry ? filesIn(entry) : [])));
  return found.flat();
}

/**
 * Return the files of an entry: the file itself, or all files below a folder.
 * @param {FileSystemEntry} entry
 * @returns {Promise<Chosen[]>}
 */
async function filesIn(entry) {
  const path = entry.fullPath.replace(/^\//, "");
  if (entry.isFile) {
    const leaf = /** @type {FileSystemFileEntry} */ (entry);
    return [{ path, file: await new Promise((done, failed) => leaf.file(done, failed)) }];
  }
  const reader = /** @type {FileSystemDirectoryEntry} */ (entry).createReader();
  /** @type {Chosen[]} */
  const found = [];
  for (;;) {
    // A folder is read in batches; an empty batch ends it.
    /** @type {FileSystemEntry[]} */
    const batch = await new Promise((done, failed) => reader.readEntries(done, failed));
    if (!batch.length) return found;
    found.push(...(await Promise.all(batch.map(filesIn))).flat());
  }
}

/**
 * Send files, and show progress in the note: a single file as it is, several as one ZIP file.
 * @param {Chosen[]} all
 * @param {UploadLimits} limits
 * @param {HTMLElement} note
 * @returns {Promise<{id: string, kind: "volumes"|"environments"}|null>} the volume, or the
 *   environment; null if nothing was chosen
 */
async function upload(all, limits, note) {
  if (!all.length) return null;
  const chosen = ofVolumes(all);
  const refusal = chosen.length
    ? tooLarge(
        chosen.map(({ file }) => file),
        limits,
      )
    : "It contains no file of a volume.";
  if (refusal) return reporting(note, Promise.reject(new Error(refusal)));
  // A single file keeps its format; several files, as DICOM series are, become one ZIP.
  const alone = chosen.length === 1;
  const name = alone ? chosen[0].file.name : nameOfAll(chosen);
  const kind = alone && isProbe(name) ? "environments" : "volumes";
  const said = alone ? name : `${name} (${chosen.length} files)`;
  if (!alone) say(note, `Putting ${said} together…`);
  const body = alone ? chosen[0].file : await reporting(note, zipOf(chosen));
  const { id } = await sendBody(kind, body, { name: volumeName(name), said }, note);
  return { id, kind };
}

/**
 * Send one file, and show progress in the note.
 * @param {"volumes"|"environments"} kind
 * @param {Blob} body
 * @param {{name: string, said: string}} names `name` of the volume, and `said`, the words for the
 *   file in the note
 * @param {HTMLElement} note
 * @returns {Promise<{id: string}>} the volume, or the environment
 */
function sendBody(kind, body, { name, said }, note) {
  const bar = find(note, "progress", HTMLProgressElement);
  let sent = false; // true if the server has all bytes
  let done = false;
  /** @param {number} share */
  const progress = (share) => {
    if (sent) return;
    bar.hidden = false;
    if (share < 1) bar.value = share;
    else bar.removeAttribute("value"); // sent: the server reads it
    say(
      note,
      share < 1 ? `Sending ${said}: ${Math.floor(100 * share)} %` : `The server reads ${said}…`,
    );
    sent = share >= 1;
    if (sent) watchCompiling(said, note, bar, () => done);
  };
  progress(0);
  return reporting(note, sendFile(kind, body, name, progress)).finally(() => {
    done = true;
    bar.hidden = true;
  });
}

/**
 * Show the progress of kernels that the server compiles for a file, until the file is done.
 * @param {string} said words for the file
 * @param {HTMLElement} note
 * @param {HTMLProgressElement} bar
 * @param {() => boolean} done returns true once the file was accepted or refused
 */
async function watchCompiling(said, note, bar, done) {
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
    say(note, progressWords(`Compiling what draws ${said}`, compiling));
  }
}

/**
 * Return the result of a promise; if it fails, show the reason in the note first.
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
 * Show a sentence in the note.
 * @param {HTMLElement} note
 * @param {string} text
 */
function say(note, text) {
  find(note, "p").textContent = text;
  note.showPopover();
}
