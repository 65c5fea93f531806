/** Puts the page together: one scene, one view, one frame loop, and the controls around them. */

import { followAddress, readAddress } from "./address.js";
import { listScenes, openStream, readFrame, readScene } from "./api.js";
import { showFacts } from "./facts.js";
import { attachGestures } from "./gestures.js";
import { attachHistogram } from "./histogram.js";
import { attachKeys } from "./keys.js";
import { attachKnobs } from "./knobs.js";
import { attachLight } from "./light.js";
import { FrameLoop } from "./loop.js";
import { ErrorPanel } from "./panel.js";
import { attachPick } from "./pick.js";
import { Picture } from "./picture.js";
import { attachPresets } from "./presets.js";
import { describe, fileName, frameQuery } from "./request.js";
import { Saver } from "./save.js";
import { attachShare } from "./share.js";
import { attachSides } from "./sides.js";
import { Status, TroublePanel } from "./status.js";
import { Times } from "./times.js";
import { attachUpload } from "./upload.js";
import { ViewModel } from "./view.js";
import { Wipe } from "./wipe.js";

const RETRY_MS = 1500;
const $ = (id) => document.getElementById(id);

/** Load the scene that the address names (else the first) and start; keep trying while the server is away. */
async function start() {
  const trouble = new TroublePanel($("trouble"));
  const { scene: wanted, start: knobs } = readAddress(location.search);
  for (;;) {
    try {
      const { scenes, uploads } = await listScenes();
      const link = scenes.find((each) => each.id === wanted) ?? scenes[0];
      const scene = await readScene(link.id);
      offerScenes(scenes, link.id);
      attachUpload($("upload"), $("stage"), uploads, link, showScene);
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
  const picture = new Picture($("stage"), $("picture"));
  const loop = startLoop(scene, view, picture, trouble);
  const options = { onRest: () => loop.settle(), toggleHelp: () => $("help").togglePopover() };
  const form = $("controls");
  attachKnobs(form, scene, view);
  attachHistogram(form, scene, view);
  attachPresets($("presets"), scene, view);
  attachLight($("light"), scene, view, options.onRest);
  attachSides($("sides"), view);
  attachGestures($("stage"), scene, view, options);
  attachPick($("stage"), scene, view);
  attachKeys(scene, view, options);
  showFacts(form, scene);
  form.addEventListener("submit", (event) => event.preventDefault());
  $("reset").addEventListener("click", () => view.reset());
  const told = {
    link: followAddress(scene, view),
    query: () => frameQuery(scene, view.values, picture.size(1)),
    file: () => fileName(scene, view.values),
    alt: () => describe(scene, view.values),
  };
  attachShare($("share"), scene, view, told);
  new Saver($("save"), scene, told);
  $("scene-name").textContent = scene.name;
  document.title = `${scene.name} · isogi`;
  form.inert = false;
  for (const id of ["share-button", "save-button", "reset"]) $(id).disabled = false;
  view.watch(({ compare, ...shown }) => shown, () => loop.change());
  loop.settle();
}

function startLoop(scene, view, picture, trouble) {
  const status = new Status(document);
  const panel = new ErrorPanel($("error"), scene.target_error);
  const times = new Times($("times"));
  const query = (values, scale = 1) => frameQuery(scene, values, picture.size(scale));
  const ask = (values) => (wish, signal) =>
    readFrame(scene.id, { ...query(values(), wish.scale), ...formatOf(wish) }, { ...wish, signal });
  const server = { open: () => openStream(scene.id), view: () => query(view.values), ask: ask(() => view.values) };
  const other = ask(() => ({ ...view.values, shading: view.values.compare }));
  const wipe = new Wipe($("wipe"), new Picture($("stage"), $("other")), other, view);
  const loop = new FrameLoop(server, {
    async frame({ blob, facts }, draft) {
      trouble.hide();
      if (facts) {
        status.show(facts, draft);
        panel.show(facts, draft);
        times.show(facts, draft);
      }
      if (blob) await picture.show(blob, describe(scene, view.values));
    },
    trouble(error) {
      status.stale();
      trouble.show(error);
    },
    moving: (moving) => wipe.moving(moving),
    busy: (busy) => $("stage").toggleAttribute("data-busy", busy),
  });
  panel.follow(view);
  trouble.onRetry = () => loop.settle();
  picture.onResize(() => loop.change());
  return loop;
}

function formatOf({ draft, waitMs }) {
  return { f: draft ? "jpeg" : "png", wait_ms: waitMs };
}

function offerScenes(scenes, current) {
  const select = $("scene");
  select.replaceChildren(...scenes.map(({ id, name }) => new Option(name, id, id === current, id === current)));
  select.hidden = scenes.length < 2;
  $("scene-name").hidden = !select.hidden;
  select.onchange = () => showScene(select.value);
}

/** Go to a scene, to the first where there is none. */
function showScene(id) {
  location.search = new URLSearchParams(id === null ? {} : { scene: id });
}

start();
