/**
 * The choice of the light: that of the scene, surroundings that come with the server, or an
 * uploaded probe.
 */

import { find } from "../dom.js";
import { deleteUpload, readLight } from "../net/api.js";
import { retryDelay } from "../net/trouble.js";

/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {import("../view/model.js").Knobs} Knobs */
/** @typedef {import("../view/model.js").ViewModel} ViewModel */

const SAME = 1e-3; // relative difference of equal exposures: addresses hold four digits
const AGAIN_MS = [300, 1000, 3000]; // pauses before a busy server is asked again

/**
 * Tie the choice to the view. When the view's light or material changes, read those parts of the
 * scene's document that depend on it.
 * @param {HTMLElement} section holds the choice `#environment` and the button `#environment-delete`
 * @param {Scene} scene parts that depend on the light are replaced
 * @param {ViewModel} view
 * @param {() => void} relit shows the scene in the new light
 * @param {(words: string) => void} say shows a sentence about trouble
 */
export function attachEnvironments(section, scene, view, relit, say) {
  const [select, erase] = [
    find(section, "#environment", HTMLSelectElement),
    find(section, "#environment-delete"),
  ];
  const sceneLight = new Option("The scene’s own light", "");
  select.replaceChildren(sceneLight, ...scene.environments.map(({ id, name }) => new Option(name, id)));
  /** @param {Knobs} values */
  const mirror = ({ environment }) => {
    select.value = environment;
    erase.hidden = !chosen(scene, environment)?.href;
  };
  mirror(view.values);
  view.subscribe(mirror);
  select.addEventListener("change", () => view.set({ environment: select.value }));
  erase.addEventListener("click", () =>
    forget(scene, view).catch((/** @type {Error} */ error) => say(error.message)),
  );
  let before = view.values;
  view.watch(litBy, async (values) => {
    const former = before;
    const wanted = litBy(values);
    // The visitor may choose again while the document is on its way.
    const chosenStill = () =>
      Object.entries(wanted).every(([name, text]) => Object(view.values)[name] === text);
    try {
      const light = await readPatiently(scene.id, wanted, chosenStill);
      if (!chosenStill()) return; // the visitor has chosen another light
      // Keep the brightness that the visitor chose, relative to each light's default.
      const exposure = exposureIn(
        light.defaults.exposure,
        view.values.exposure,
        former.exposure,
        scene.defaults.exposure,
      );
      Object.assign(scene, light, { defaults: { ...scene.defaults, ...light.defaults } });
      view.set({ exposure }, true);
      relit();
    } catch (error) {
      say(/** @type {Error} */ (error).message);
      // Without the new light's document, go back to the former light.
      if (chosenStill()) view.set(litBy(former));
    }
  });
  view.subscribe((values) => {
    before = values;
  });
}

/** Return the knobs of a view that its light depends on. @param {Knobs} values */
function litBy({ environment, material }) {
  return { environment, material };
}

/**
 * Read the parts of a scene that depend on its light, and try again while the server is busy. The
 * picture's requests report the trouble.
 * @param {string} scene
 * @param {ReturnType<typeof litBy>} knobs
 * @param {() => boolean} wanted returns true as long as the result is wanted
 * @throws {import("../net/trouble.js").Trouble} if it cannot be read
 */
async function readPatiently(scene, knobs, wanted) {
  for (let failures = 0; ; failures += 1) {
    try {
      return await readLight(scene, knobs);
    } catch (error) {
      const delay = retryDelay(error, failures, AGAIN_MS);
      if (delay === null || !wanted()) throw error;
      await new Promise((done) => {
        setTimeout(done, delay);
      });
    }
  }
}

/**
 * Return the exposure in another light: as many stops from the new light's default as it was from
 * the former light's.
 * @param {number} usual default of the new light
 * @param {number} now exposure of the view
 * @param {number} before exposure when the light was chosen; if `now` differs, the visitor has
 *   chosen `now` too
 * @param {number} former default of the former light
 * @returns {number}
 */
export function exposureIn(usual, now, before, former) {
  if (now === former) return usual;
  const wanted = now === before ? (usual * now) / former : now;
  return Math.abs(wanted / usual - 1) < SAME ? usual : wanted;
}

/**
 * Find the chosen environment of a scene.
 * @type {(scene: Scene, environment: string) => import("../documents.js").Environment|undefined}
 */
function chosen({ environments }, environment) {
  return environments.find(({ id }) => id === environment);
}

/** Delete the probe that is shown. @type {(scene: Scene, view: ViewModel) => Promise<void>} */
async function forget(scene, view) {
  const probe = chosen(scene, view.values.environment);
  if (!probe?.href || !confirm(`Delete the light “${probe.name}” from the server?`)) return;
  await deleteUpload(probe.href);
  view.set({ environment: "" });
  scene.environments = scene.environments.filter(({ id }) => id !== probe.id);
  find(document, `#environment option[value="${probe.id}"]`).remove();
}
