/** Volumes of one's own: a file that is opened or dropped goes to the server, and becomes a scene; or it is deleted. */

import { deleteVolume, sendVolume } from "./api.js";

const MEGABYTE = 1 << 20;

/**
 * Offer to open files, and to delete what was uploaded. Does nothing where the server takes no uploads.
 * @param {HTMLElement} root holds the buttons `#upload-open` and `#upload-delete`, the `#upload-file` input and the
 *   `#upload-note` popover with a `p` and a `progress`
 * @param {HTMLElement} stage where files may be dropped
 * @param {{limit_bytes: number, free_bytes: number}|null} limits what may be uploaded
 * @param {{name: string, volume: string|null}} scene the one that is shown
 * @param {(scene: string|null) => void} show goes to a scene; to the first where it is null
 */
export function attachUpload(root, stage, limits, scene, show) {
  if (!limits) return;
  const { open, erase, file, note } = partsOf(root);
  const send = (chosen) => chosen && upload(chosen, limits, note).then(({ id }) => show(id), () => {});
  root.hidden = false;
  erase.hidden = !scene.volume;
  open.addEventListener("click", () => file.click());
  file.addEventListener("change", () => {
    send(file.files[0]);
    file.value = "";
  });
  erase.addEventListener("click", async () => {
    if (!confirm(`Delete the volume “${scene.name}” from the server?`)) return;
    await told(note, deleteVolume(scene.volume)).then(() => show(null), () => {});
  });
  attachDrop(stage, send);
}

function partsOf(root) {
  const find = (name) => root.querySelector(`#upload-${name}`);
  return { open: find("open"), erase: find("delete"), file: find("file"), note: find("note") };
}

function attachDrop(stage, send) {
  const holdsFiles = (event) => event.dataTransfer.types.includes("Files");
  stage.addEventListener("dragover", (event) => {
    if (!holdsFiles(event)) return;
    event.preventDefault();
    stage.toggleAttribute("data-drop", true);
  });
  stage.addEventListener("dragleave", () => stage.toggleAttribute("data-drop", false));
  stage.addEventListener("drop", (event) => {
    event.preventDefault();
    stage.toggleAttribute("data-drop", false);
    send(event.dataTransfer.files[0]);
  });
}

/** Send a file while the note tells how far it is. @returns {Promise<{id: string}>} the volume */
function upload(file, limits, note) {
  if (file.size > limits.limit_bytes) {
    const most = Math.floor(limits.limit_bytes / MEGABYTE);
    return told(note, Promise.reject(new Error(`${file.name} is larger than the ${most} MB that an upload may be.`)));
  }
  const bar = note.querySelector("progress");
  const progress = (share) => {
    bar.hidden = false;
    if (share < 1) bar.value = share;
    else bar.removeAttribute("value"); // sent: the server reads it
    tell(note, share < 1 ? `Sending ${file.name}: ${Math.floor(100 * share)} %` : `The server reads ${file.name}…`);
  };
  progress(0);
  return told(note, sendVolume(file, nameOf(file), progress)).finally(() => { bar.hidden = true; });
}

/** The same promise; where it fails the note says why, until it is closed. */
async function told(note, promise) {
  try {
    return await promise;
  } catch (error) {
    tell(note, error.message);
    throw error;
  }
}

function tell(note, text) {
  note.querySelector("p").textContent = text;
  note.showPopover();
}

/** The file's name as a title: without its ending, and no longer than the server takes. */
function nameOf(file) {
  return file.name.replace(/\.(nrrd|nhdr)$/i, "").replace(/\p{C}/gu, "").slice(0, 80);
}
