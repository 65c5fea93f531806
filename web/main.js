/** Puts the page together: one scene, one view, one request loop, and the controls around them. */

import { followAddress, readAddress } from "./address.js";
import { listScenes, readFrame, readScene } from "./api.js";
import { showFacts } from "./facts.js";
import { attachGestures } from "./gestures.js";
import { attachHistogram } from "./histogram.js";
import { attachKeys } from "./keys.js";
import { attachKnobs, shadingName } from "./knobs.js";
import { attachLight } from "./light.js";
import { FrameLoop } from "./loop.js";
import { ErrorPanel } from "./panel.js";
import { Picture } from "./picture.js";
import { Status, TroublePanel } from "./status.js";
import { NUMBERS, ViewModel } from "./view.js";

const RETRY_MS = 1500;
const LIGHT_KNOBS = new Set(["yaw", "pitch", "roll"]);
const $ = (id) => document.getElementById(id);

/** Load the scene that the address names (else the first) and start; keep trying while the server is away. */
async function start() {
  const trouble = new TroublePanel($("trouble"));
  const { scene: wanted, start: knobs } = readAddress(location.search);
  for (;;) {
    try {
      const scenes = await listScenes();
      const { id } = scenes.find((each) => each.id === wanted) ?? scenes[0];
      const scene = await readScene(id);
      offerScenes(scenes, id);
      return assemble(scene, knobs, trouble);
    } catch (error) {
      $("stage").dataset.state = "trouble";
      trouble.show(error);
      if (!error.retry) throw error;
      await trouble.patience(RETRY_MS);
    }
  }
}

function assemble(scene, knobs, trouble) {
  const view = new ViewModel(scene, knobs);
  const loop = startLoop(scene, view, trouble);
  const options = { lightTurns: scene.turns, onRest: () => loop.settle(), toggleHelp: () => $("help").togglePopover() };
  const form = $("controls");
  attachKnobs(form, scene, view);
  attachHistogram(form, scene, view);
  attachLight($("light"), scene, view, options.onRest);
  attachGestures($("stage"), view, options);
  attachKeys(scene, view, options);
  showFacts(form, scene);
  form.addEventListener("submit", (event) => event.preventDefault());
  $("reset").addEventListener("click", () => view.reset());
  $("copy-link").addEventListener("click", copier(followAddress(scene, view)));
  $("scene-name").textContent = scene.name;
  document.title = `${scene.name} · isogi`;
  form.inert = $("reset").disabled = $("copy-link").disabled = false;
  view.subscribe(() => loop.change());
  loop.settle();
}

function startLoop(scene, view, trouble) {
  const picture = new Picture($("stage"), $("picture"), $("save-picture"));
  const status = new Status(document);
  const panel = new ErrorPanel($("error"), scene.target_error);
  const ask = (wish, signal) => readFrame(scene.id, frameQuery(scene, view.values, picture, wish), { ...wish, signal });
  const loop = new FrameLoop(ask, {
    frame({ blob, facts }, draft) {
      trouble.hide();
      if (facts) {
        status.show(facts, draft);
        panel.show(facts, draft);
      }
      if (blob) picture.show(blob, labels(scene, view.values));
    },
    trouble(error) {
      status.stale();
      trouble.show(error);
    },
    busy: (busy) => $("stage").toggleAttribute("data-busy", busy),
  });
  panel.follow(view);
  trouble.onRetry = () => loop.settle();
  picture.onResize(() => loop.change());
  return loop;
}

function frameQuery(scene, values, picture, { draft, scale, waitMs }) {
  const numbers = NUMBERS.filter((name) => name in values && (scene.turns || !LIGHT_KNOBS.has(name)));
  return {
    ...Object.fromEntries(numbers.map((name) => [name, values[name]])),
    ...picture.size(draft ? scale : 1),
    shading: values.shading,
    overlay: values.overlay ? "provisional" : "none",
    f: draft ? "jpeg" : "png",
    wait_ms: waitMs,
  };
}

function labels(scene, values) {
  const isovalue = Number(values.isovalue.toPrecision(6));
  const from = `azimuth ${Math.round(values.azimuth)}°, elevation ${Math.round(values.elevation)}°`;
  return {
    alt: `Isosurface of ${scene.name} at ${isovalue}, seen from ${from}; ${shadingName(values.shading)}`,
    file: `${scene.id}-${isovalue}`,
  };
}

function offerScenes(scenes, current) {
  const select = $("scene");
  select.replaceChildren(...scenes.map(({ id, name }) => new Option(name, id, id === current, id === current)));
  select.hidden = scenes.length < 2;
  $("scene-name").hidden = !select.hidden;
  select.onchange = () => { location.search = new URLSearchParams({ scene: select.value }); };
}

function copier(writeAddress) {
  return async ({ currentTarget: button }) => {
    const address = writeAddress();
    const copied = await navigator.clipboard?.writeText(address).then(() => true, () => false);
    const label = [...button.childNodes];
    button.textContent = copied ? "Copied" : "Copy it from the address bar";
    button.disabled = true;
    setTimeout(() => {
      button.replaceChildren(...label);
      button.disabled = false;
    }, 1600);
  };
}

start();
