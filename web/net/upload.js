/**
 * Volumes and light probes of one's own: files or a folder that are opened or dropped go to the
 * server, and are shown; or deleted.
 */

import { find } from "../dom.js";
import { deleteUpload, readReadiness, sendFile } from "./api.js";
import { zipOf } from "./bytes.js";
import { progressWords } from "./compiling.js";

/** @typedef {import("../documents.js").UploadLimits} UploadLimits */
/** @typedef {{path: string, file: File}} Chosen a file, and where it lies in what was chosen */

const MEGABYTE = 1 << 20;
const LOOK_MS = 500; // between two looks at what the server compiles for a file

/**
 * Offer to open files, and to delete what was uploaded. Does nothing where the server takes no
 * uploads.
 * @param {HTMLElement} root holds the buttons `#upload-open`, `#upload-folder` and
 *   `#upload-delete`, the inputs `#upload-file` and `#upload-files`, and the `#upload-note` popover
 *   with a `p` and a `progress`
 * @param {HTMLElement} stage where files may be dropped
 * @param {UploadLimits|null} limits what may be uploaded
 * @param {{name: string, volume: string|null}} scene the one that is shown
 * @param {(scene: string|null) => void} show goes to a scene; to the first where it is null
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
 * Why files may not be uploaded; "" where they may.
 * @param {{name: string, size: number}[]} files
 * @param {{limit_bytes: number, limit_files: number}} limits
 * @returns {string}
 */
export function tooLarge(files, limits) {
  const size = files.reduce((sum, file) => sum + file.size, 0);
  const most = `the ${Math.floor(limits.limit_bytes / MEGABYTE)} MB that an upload may be`;
  if (files.length > limits.limit_files)
    return `These are ${files.length} files, and ${limits.limit_files} are the most that an upload may be.`;
  if (size <= limits.limit_bytes) return "";
  return files.length === 1
    ? `${files[0].name} is larger than ${most}.`
    : `These ${files.length} files are larger than ${most}, together.`;
}

// names of files that systems leave in folders, which hold nothing to show
const NO_VOLUMES = /(^|\/)(\.|__MACOSX\/|DICOMDIR$|Thumbs\.db$|desktop\.ini$)/i;

/**
 * The files of a choice that may belong to a volume.
 * @template {{path: string}} T
 * @param {T[]} chosen
 * @returns {T[]} by their paths
 */
export function ofVolumes(chosen) {
  return chosen
    .filter(({ path }) => !NO_VOLUMES.test(path))
    .sort((a, b) => (a.path < b.path ? -1 : 1));
}

/**
 * What several files are called together: their folder, else the header among them, else the first.
 * @param {{path: string}[]} chosen
 * @returns {string}
 */
export function nameOfAll(chosen) {
  const [folder] = chosen[0].path.split("/");
  if (chosen.every(({ path }) => path.startsWith(`${folder}/`))) return folder;
  return (chosen.find(({ path }) => /\.nhdr$/i.test(path)) ?? chosen[0]).path;
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
    .replace(/\.(hdr|nrrd|nhdr|nii(\.gz)?|dcm|tiff?|mrc|map|h5|hdf5|nc|npy|npz|zip)$/i, "")
    .replace(/\p{C}/gu, "")
    .slice(0, 80);
}

/**
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
 * All files that were dropped, also those in folders.
 * @param {DataTransfer|null} data
 * @returns {Promise<Chosen[]>}
 */
async function dropped(data) {
  // what was dropped can be asked for at once alone
  const files = [...(data?.files ?? [])];
  const entries = [...(data?.items ?? [])].map((item) => item.webkitGetAsEntry?.() ?? null);
  if (!entries.some((entry) => entry?.isDirectory))
    return files.map((file) => ({ path: file.name, file }));
  const found = await Promise.all(entries.map((entry) => (entry ? filesIn(entry) : [])));
  return found.flat();
}

/**
 * The files of an entry: its own, or all below a folder.
 * @param {FileSystemEntry} entry
 * @returns {Promise<Chosen[]>}
 */
async function filesIn(entry) {
  const path = entry.fullPath.replace(/^\//, "");
  if (entry.isFile) {
    const own = /** @type {FileSystemFileEntry} */ (entry);
    return [{ path, file: await new Promise((done, failed) => own.file(done, failed)) }];
  }
  const reader = /** @type {FileSystemDirectoryEntry} */ (entry).createReader();
  /** @type {Chosen[]} */
  const found = [];
  for (;;) {
    // a folder is read in batches, until one is empty
    /** @type {FileSystemEntry[]} */
    const batch = await new Promise((done, failed) => reader.readEntries(done, failed));
    if (!batch.length) return found;
    found.push(...(await Promise.all(batch.map(filesIn))).flat());
  }
}

/**
 * Send files while the note says how far it is: one as it is, several as one ZIP file.
 * @param {Chosen[]} all
 * @param {UploadLimits} limits
 * @param {HTMLElement} note
 * @returns {Promise<{id: string, kind: "volumes"|"environments"}|null>} the volume, or the
 *   environment; null where nothing was chosen
 */
async function upload(all, limits, note) {
  if (!all.length) return null;
  const chosen = ofVolumes(all);
  const refusal = chosen.length
    ? tooLarge(
        chosen.map(({ file }) => file),
        limits,
      )
    : "There is no file of a volume in it.";
  if (refusal) return reporting(note, Promise.reject(new Error(refusal)));
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
 * Send what is one file while the note says how far it is.
 * @param {"volumes"|"environments"} kind
 * @param {Blob} body
 * @param {{name: string, said: string}} names of the volume, and of what is sent
 * @param {HTMLElement} note
 * @returns {Promise<{id: string}>} the volume, or the environment
 */
function sendBody(kind, body, { name, said }, note) {
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
 * Say how far the server compiles what draws a file, where it must.
 * @param {string} said what the file is called
 * @param {HTMLElement} note
 * @param {HTMLProgressElement} bar
 * @param {() => boolean} done whether the file is there, or was refused
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
