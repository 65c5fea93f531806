/** Where the light comes from: the scene's own, surroundings that come with the server, or a probe that was uploaded. */

import { find } from "../dom.js";
import { deleteUpload, readLight } from "../net/api.js";

/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {import("../view/model.js").Knobs} Knobs */
/** @typedef {import("../view/model.js").ViewModel} ViewModel */

const SAME = 1e-3; // addresses hold four digits of an exposure

/**
 * Tie the choice to the view. When the view's light changes, what the scene says of its light is read anew.
 * @param {HTMLElement} section holds the choice `#environment` and the button `#environment-delete`
 * @param {Scene} scene its light is replaced
 * @param {ViewModel} view
 * @param {() => void} relit shows what the scene then says
 * @param {(words: string) => void} say tells what went wrong
 */
export function attachEnvironments(section, scene, view, relit, say) {
  const [select, erase] = [find(section, "#environment", HTMLSelectElement), find(section, "#environment-delete")];
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
  erase.addEventListener("click", () => forget(scene, view).catch((/** @type {Error} */ error) => say(error.message)));
  let before = view.values;
  view.watch(({ environment }) => environment, async (values) => {
    const [former, wanted] = [before, values.environment];
    try {
      const light = await readLight(scene.id, wanted);
      if (view.values.environment !== wanted) return; // another was chosen meanwhile
      const exposure = exposureIn(light.defaults.exposure, view.values.exposure, former.exposure, scene.defaults.exposure);
      Object.assign(scene, light);
      view.set({ exposure }, true);
      relit();
    } catch (error) {
      say(/** @type {Error} */ (error).message);
      if (view.values.environment === wanted) view.set({ environment: former.environment });
    }
  });
  view.subscribe((values) => { before = values; });
}

/**
 * The exposure in another light: as many stops from the new light's own as it was from the former's.
 * @param {number} usual in the new light
 * @param {number} now what the view has
 * @param {number} before what it had when the light was chosen: where both differ, it was chosen too
 * @param {number} former what was usual in the former light
 * @returns {number}
 */
export function exposureIn(usual, now, before, former) {
  if (now === former) return usual;
  const wanted = now === before ? (usual * now) / former : now;
  return Math.abs(wanted / usual - 1) < SAME ? usual : wanted;
}

/** @type {(scene: Scene, environment: string) => import("../net/schemas.js").Environment|undefined} */
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
