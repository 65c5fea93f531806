/**
 * The part of the panel of files that lets the server export the surface, or the volume, with its
 * light.
 */

import { find } from "../dom.js";
import { leftInWords } from "../view/format.js";
import { beginExport, readJob, stopJob } from "./api.js";
import { Trouble } from "./trouble.js";

/** @typedef {import("./schemas.js").FrameQuery} FrameQuery */
/** @typedef {import("../documents.js").Job} Job */

/** Parameters of a picture that the light of an export depends on. */
const OF_LIGHT = [
  "isovalue",
  "yaw",
  "pitch",
  "roll",
  "albedo",
  "exposure",
  "environment",
  "cut",
  "time",
  "smooth",
  "surfaces",
  "hide",
  "material",
];
const ASK_MS = 1000; // time between two requests for the job's state
const GONE = 404; // HTTP status of a job that the server does not have

/**
 * Return the parameters of a picture that an export reads: light does not depend on camera and
 * size.
 * @param {FrameQuery} query
 * @returns {FrameQuery}
 */
export function exportQuery(query) {
  return Object.fromEntries(Object.entries(query).filter(([name]) => OF_LIGHT.includes(name)));
}

/**
 * Describe the state of a job.
 * @param {Pick<Job, "message"|"progress"|"time_left">} job
 * @returns {string}
 */
export function jobInWords({ message, progress, time_left: left }) {
  return `${progress} %${left ? `, ${leftInWords(left)}` : ""}. ${message}`;
}

/**
 * Makes one file at a time, and hands it to the browser. Work continues while the panel is closed.
 */
export class Exporter {
  #part;
  #scene;
  #query;
  #name;
  /** @type {{address: string}|null} */
  #work = null;

  /**
   * @param {HTMLElement} part holds `#export-kind`, `#export-time`, a `progress`, a `.note` and two
   *   buttons
   * @param {Pick<import("./schemas.js").Scene, "id"|"plan"|"volume">} scene
   * @param {Pick<import("./request.js").Description, "query"|"file">} description of the view
   */
  constructor(part, scene, { query, file }) {
    this.#part = part;
    this.#scene = scene.id;
    this.#query = query;
    this.#name = file;
    const [x, y, z] = scene.volume.size;
    // A VTI file holds values at voxels: it needs one texel per voxel.
    if (scene.plan.texels.total !== x * y * z) find(part, "option[value=vti]").remove();
    find(part, "#export-start").addEventListener("click", () => this.#start());
    find(part, "#export-stop").addEventListener("click", () =>
      this.#stop("Stopped, nothing is saved."),
    );
    addEventListener("pagehide", () => this.#work && this.#stop(""));
  }

  /** Begin an export with the chosen format and deadline. */
  async #start() {
    const { value: f } = find(this.#part, "#export-kind", HTMLSelectElement);
    const { value: deadline } = find(this.#part, "#export-time", HTMLSelectElement);
    const work = { address: "" };
    const name = `${this.#name()}.${f}`;
    this.#work = work;
    this.#show(true);
    this.#say("Asking for the file…");
    try {
      work.address = await beginExport(this.#scene, {
        ...exportQuery(this.#query()),
        f,
        ...(deadline && { deadline }),
      });
      // The visitor stopped it before the job had an address.
      if (this.#work !== work) return void stopJob(work.address).catch(() => {});
      await this.#follow(work, name);
    } catch (error) {
      if (this.#work === work) this.#end(/** @type {Error} */ (error).message);
    }
  }

  /**
   * Show the state of a job until it ends, and download its result.
   * @param {{address: string}} work
   * @param {string} name of the file
   */
  async #follow(work, name) {
    while (this.#work === work) {
      const job = await this.#ask(work.address);
      if (this.#work !== work) return;
      // Download the result by a link, as the browser can then save it while it arrives.
      const file = job?.links.find(({ rel }) => rel.endsWith("/results"));
      if (job?.status === "successful" && file) {
        Object.assign(document.createElement("a"), {
          href: file.href.replace(/^\//, ""),
          download: name,
        }).click();
        return this.#end(`${name} is on its way. ${file.title}.`);
      }
      if (job && !["accepted", "running"].includes(job.status)) return this.#end(job.message);
      if (job) {
        find(this.#part, "progress", HTMLProgressElement).value = job.progress / 100;
        this.#say(jobInWords(job));
      }
      await new Promise((resolve) => setTimeout(resolve, ASK_MS));
    }
  }

  /**
   * Return the state of a job; null if the server does not answer now.
   * @param {string} address
   * @returns {Promise<Job|null>}
   */
  async #ask(address) {
    try {
      return await readJob(address);
    } catch (error) {
      if (!(error instanceof Trouble && error.retry) || error.status === GONE) throw error;
      this.#say(error.detail);
      return null;
    }
  }

  /** Stop the job, and show some words. @param {string} words */
  #stop(words) {
    // A failure does not matter: the job has ended, or the server is away.
    if (this.#work?.address) stopJob(this.#work.address).catch(() => {});
    this.#end(words);
  }

  /** Show that no job is running, and some words. @param {string} words */
  #end(words) {
    this.#work = null;
    this.#show(false);
    this.#say(words);
  }

  /** Show or hide the parts of the panel that belong to a running job. @param {boolean} busy */
  #show(busy) {
    const progress = find(this.#part, "progress", HTMLProgressElement);
    progress.hidden = !busy;
    progress.value = 0;
    for (const id of ["#export-kind", "#export-time"])
      find(this.#part, id, HTMLSelectElement).disabled = busy;
    find(this.#part, "#export-start").hidden = busy;
    find(this.#part, "#export-stop").hidden = !busy;
  }

  /** Show some words below the buttons. @param {string} words */
  #say(words) {
    find(this.#part, ".note").textContent = words;
  }
}
