/**
 * Where the light comes from: the scene's own, surroundings that come with the server, or a probe
 * that was uploaded.
 */

import { find } from "../dom.js";
import { deleteUpload, readLight } from "../net/api.js";
import { retryDelay } from "../net/trouble.js";

/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {import("../view/model.js").Knobs} Knobs */
/** @typedef {import("../view/model.js").ViewModel} ViewModel */

const SAME = 1e-3; // addresses hold four digits of an exposure
const AGAIN_MS = [300, 1000, 3000]; // before a busy server is asked again

/**
 * Tie the choice to the view. When the view's light or material changes, what the scene says of its
 * light is read anew.
 * @param {HTMLElement} section holds the choice `#environment` and the button `#environment-delete`
 * @param {Scene} scene its light is replaced
 * @param {ViewModel} view
 * @param {() => void} relit shows what the scene then says
 * @param {(words: string) => void} say tells what went wrong
 */
export function attachEnvironments(section, scene, view, relit, say) {
  const [select, erase] = [
    find(section, "#environment", HTMLSelectElement),
    find(section, "#environment-delete"),
  ];
  const own = new Option("The scene’s own light", "");
  select.replaceChildren(own, ...scene.environments.map(({ id, name }) => new Option(name, id)));
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
    const [former, wanted] = [before, litBy(values)];
    const chosenStill = () =>
      Object.entries(wanted).every(([name, text]) => Object(view.values)[name] === text);
    try {
      const light = await readPatiently(scene.id, wanted, chosenStill);
      if (!chosenStill()) return; // another was chosen meanwhile
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
      if (chosenStill()) view.set(litBy(former));
    }
  });
  view.subscribe((values) => {
    before = values;
  });
}

/** The knobs of a view that its light depends on. @param {Knobs} values */
function litBy({ environment, material }) {
  return { environment, material };
}

/**
 * What a scene is in its light, also where a busy server answers late: the picture's own requests
 * say why.
 * @param {string} scene
 * @param {ReturnType<typeof litBy>} knobs
 * @param {() => boolean} wanted whether that is wanted still
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
 * The exposure in another light: as many stops from the new light's own as it was from the
 * former's.
 * @param {number} usual in the new light
 * @param {number} now what the view has
 * @param {number} before what it had when the light was chosen: where both differ, it was chosen
 *   too
 * @param {number} former what was usual in the former light
 * @returns {number}
 */
export function exposureIn(usual, now, before, former) {
  if (now === former) return usual;
  const wanted = now === before ? (usual * now) / former : now;
  return Math.abs(wanted / usual - 1) < SAME ? usual : wanted;
}

/**
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
