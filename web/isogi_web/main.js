/** Puts the page together: one scene, one view, one frame loop, and the controls around them. */

import { Card } from "./card/card.js";
import { find } from "./dom.js";
import { Live } from "./live/live.js";
import { Player } from "./live/player.js";
import { complaints, followAddress, readAddress } from "./net/address.js";
import {
  listScenes,
  openStream,
  probeScene,
  readBlocks,
  readCard,
  readCardBytes,
  readChunks,
  readFrame,
  readLight,
  readPoint,
  readReadiness,
  readScene,
  readSize,
  readSlice,
  readSurfacePoint,
} from "./net/api.js";
import { CompilingLine } from "./net/compiling.js";
import { Exporter } from "./net/export.js";
import { FrameLoop } from "./net/loop.js";
import { describe, fileName, frameQuery, ground, pointQuery } from "./net/request.js";
import { Saver } from "./net/save.js";
import { attachShare } from "./net/share.js";
import { Shown } from "./net/shown.js";
import { Trouble } from "./net/trouble.js";
import { attachUpload } from "./net/upload.js";
import {
  Comparison,
  RightSide,
  attachComparison,
  namesOf,
  refuseUnknown,
} from "./panels/comparison.js";
import { attachCuts, attachLabels, attachMaterial, attachSurfaces } from "./panels/cuts.js";
import { attachEnvironments } from "./panels/environment.js";
import { ErrorPanel } from "./panels/error.js";
import { attachHistogram } from "./panels/histogram.js";
import { attachKnobs } from "./panels/knobs.js";
import { attachLight } from "./panels/light.js";
import { PointCard } from "./panels/point.js";
import { Reading, attachMeasures, attachSize } from "./panels/reading.js";
import { attachPresets } from "./panels/presets.js";
import { showScene } from "./panels/scene.js";
import { Notice, Status, TroublePanel } from "./panels/status.js";
import { Times } from "./panels/times.js";
import { attachViews } from "./panels/views.js";
import { SlicesPane } from "./slices/pane.js";
import { towardsEye } from "./view/camera.js";
import { emptyInWords } from "./view/format.js";
import { attachClicks, attachGestures } from "./view/gestures.js";
import { Handles } from "./view/handles.js";
import { attachKeys } from "./view/keys.js";
import { Marks } from "./view/marks.js";
import { attachRulers, attachSides, legendOf, legendShapes, rulerShapes } from "./view/rulers.js";
import { ViewModel } from "./view/model.js";
import { cutAt, nearestAxis } from "./view/planes.js";
import { dot, vector } from "./view/rotation.js";
import { Picture } from "./view/picture.js";

/** @typedef {import("./net/polling.js").FrameOptions} FrameOptions */
/** @typedef {import("./net/schemas.js").Scene} Scene */
/** @typedef {import("./documents.js").SceneLink} SceneLink */
/** @typedef {import("./view/model.js").Knobs} Knobs */
/** @typedef {import("./view/rotation.js").Vec3} Vec3 */

const SECOND_MS = 1000;
const RETRY_MS = 1500; // pause before a server that is away is asked again
const COMPILING_MS = 300; // pause before a server that compiles is asked again
const REFUSED = 422; // HTTP status of a picture that is too large
const GONE = 404; // HTTP status of a scene that the server does not have

/**
 * Return an element of the page by its id.
 * @template {Element} [T=HTMLElement]
 * @param {string} id
 * @param {new (...args: any[]) => T} [kind]
 */
const $ = (id, kind) => find(document, `#${id}`, kind);

/**
 * Load the scene that the address names, or the first one, and start the page; try again while the
 * server is away.
 */
async function start() {
  const trouble = new TroublePanel($("trouble"));
  const compiling = new CompilingLine($("compiling"), readReadiness);
  compiling.watch();
  const { scene: wanted, start: knobs } = readAddress(location.search);
  for (;;) {
    try {
      const { scenes, uploads } = await listScenes();
      const link = scenes.find((each) => each.id === wanted) ?? scenes[0];
      // Read the scene with the size of the picture, so that its camera fits.
      const size = new Picture($("stage"), $("picture", HTMLImageElement)).size(1);
      const scene = await readScene(link.id, size, knobs);
      offerScenes(scenes, link.id);
      attachUpload($("upload"), $("stage"), uploads, link, openScene, openLight);
      const { environment = "", material = "" } = new ViewModel(scene, knobs).values;
      // Another light or material changes parts of the scene's document.
      if (environment || material)
        Object.assign(scene, await readLight(scene.id, { environment, material }));
      return assemble(scene, knobs, scenes, trouble);
    } catch (error) {
      const failure = /** @type {import("./net/trouble.js").Trouble} */ (error);
      if (!failure.retry || !(await compiling.look())) {
        $("stage").dataset.state = "trouble";
        trouble.show(failure);
      }
      if (!failure.retry) throw error;
      await trouble.patience(compiling.shown ? COMPILING_MS : RETRY_MS);
    }
  }
}

/**
 * Make the parts of the page, and tie them to one view.
 * @param {Scene} scene
 * @param {Partial<Knobs>} knobs knobs that the address names
 * @param {SceneLink[]} scenes all scenes of the server
 * @param {TroublePanel} trouble
 */
function assemble(scene, knobs, scenes, trouble) {
  const view = new ViewModel(scene, knobs);
  const others = scenes.filter(({ id }) => id !== scene.id);
  const unknown = refuseUnknown(view, others);
  const picture = new Picture(
    $("stage"),
    $("picture", HTMLImageElement),
    $("draft", HTMLCanvasElement),
  );
  const { say } = new Notice($("notice"));
  const { card, reading } = attachReading(scene, view, picture, say);
  const shown = new Shown(view.values, (values) => keyOf(scene, values, picture));
  const { loop, live, ready } = startLoop(scene, view, picture, {
    trouble,
    card,
    shown,
    say,
    scenes,
  });
  const keys = {
    f: toggleFull,
    p: () => reading.middle(),
    m: () => reading.measure(),
    r: () => toggleRulers(view),
    c: () => unfold($("cuts", HTMLDetailsElement)),
    v: () => slices.toggle(),
  };
  const options = {
    onRest: () => loop.settle(),
    toggleHelp: () => $("help").togglePopover(),
    keys,
  };

  // Tie controls, panels, gestures and keys to the view.
  const form = $("controls");
  attachKnobs(form, scene, view, shown);
  attachComparison(form, scene, view, others);
  new Player($("play", HTMLButtonElement), scene, view, shown);
  attachHistogram(form, scene, view, say);
  attachPresets($("presets"), scene, view);
  attachLabels($("colour-scale"), scene, view);
  attachSurfaces($("beside"), scene, view);
  attachCuts($("cuts"), scene, view);
  attachMaterial($("material"), scene, view);
  const slices = attachCutting(scene, view, card, options.onRest);
  attachMeasures($("measures"), scene, view);
  attachSize($("size", HTMLDetailsElement), scene, view, (values, signal) =>
    readSize(scene, values, signal),
  );
  const showLight = attachLight($("light"), scene, view, options.onRest);
  const follow = () => followView(view, picture, shown, loop, live);
  attachEnvironments(
    $("light"),
    scene,
    view,
    () => {
      showLight();
      showScene(form, scene);
      follow();
    },
    say,
  );
  attachGestures($("stage"), scene, view, options);
  attachKeys(scene, view, options);
  attachSides($("sides"), scene, shown);
  attachRulers($("rulers", SVGElement), scene, view, shown);
  showScene(form, scene);
  form.addEventListener("submit", (event) => event.preventDefault());
  $("reset").addEventListener("click", () => view.reset());

  // Offer the view to those parts that share and save it.
  const description = {
    link: followAddress(scene, view),
    query: () => queryOf(scene, view.values, picture),
    ready,
    file: () => fileName(scene, view.values),
    alt: () => describe(scene, view.values),
    empty: () => emptyInWords(scene, view.values),
    rulers: (/** @type {{width: number, height: number}} */ size) =>
      rulerShapes(scene, view.values, size),
    legend: (/** @type {{width: number, height: number}} */ size) => {
      const legend = legendOf(scene, view.values);
      return legend && legendShapes(legend, size);
    },
  };
  attachShare($("share"), scene, view, description);
  attachViews($("views"), scene, view, description.query);
  new Saver($("save"), scene, description);
  new Exporter($("export"), scene, description);
  $("scene-name").textContent = scene.name;
  document.title = `${scene.name} · isogi`;
  form.inert = false;
  for (const id of ["share-button", "save-button", "reset", "slices-button"])
    $(id, HTMLButtonElement).disabled = false;

  // Request a picture whenever something changes it, and the first one now.
  view.subscribe(follow);
  picture.onResize(follow);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", follow);
  addEventListener("beforeunload", () => shown.leave());
  addEventListener("pageshow", follow); // also when the visitor comes back to a page that was left
  $("full-screen").hidden = !document.fullscreenEnabled;
  $("full-screen").addEventListener("click", toggleFull);
  say([...complaints(location.search, scene), ...unknown].join(" "));
  loop.settle();
}

/**
 * Let clicks on the picture read a point, or measure, and double clicks bring a point to the
 * middle.
 * @param {Scene} scene
 * @param {ViewModel} view
 * @param {Picture} picture
 * @param {(words: string) => void} say
 * @returns {{card: PointCard, reading: Reading}}
 */
function attachReading(scene, view, picture, say) {
  /** @type {import("./view/marks.js").FindSurface} */
  const pick = (values, right, up) => readSurfacePoint(scene, values, right, up);
  const marks = new Marks($("marks", SVGElement), scene, view, pick);
  const card = new PointCard($("point"), scene, marks, (right, up) =>
    readPoint(scene.id, pointQuery(queryOf(scene, view.values, picture), right, up)),
  );
  const reading = new Reading($("measuring"), card, marks, view, pick, say);
  // Clicks read or measure; the card of the point follows its mark.
  marks.onDraw = () => card.place();
  attachClicks($("stage"), {
    click: (right, up) => reading.click(right, up),
    async double(right, up) {
      card.close();
      const target = await pick(view.values, right, up);
      if (target) view.set({ target });
    },
  });
  $("point-measure").addEventListener("click", () => reading.measure());
  document.addEventListener("keydown", ({ key }) => key === "Escape" && reading.stop());
  return { card, reading };
}

/**
 * Attach the parts that move planes of the cut: handles on the picture, shown while the folder of
 * the cut is open; the card of a point; and slices, which cut away the matter in front of them.
 * @param {Scene} scene
 * @param {ViewModel} view
 * @param {PointCard} card
 * @param {() => void} onRest
 * @returns {SlicesPane}
 */
function attachCutting(scene, view, card, onRest) {
  const folder = $("cuts", HTMLDetailsElement);
  const handles = new Handles($("handles"), scene, view, { wanted: () => folder.open, onRest });
  folder.addEventListener("toggle", () => handles.draw());
  /**
   * Cut through a point, and unfold the sliders of the planes.
   * @param {Vec3|null} point
   * @param {(towards: Vec3) => Vec3} normalOf returns the normal of the cut for the direction to
   *   the eye
   */
  const cut = (point, normalOf) => {
    if (point)
      view.set({
        planes: cutAt(
          view.values.planes,
          scene.volume.bounds,
          point,
          normalOf(towardsEye(scene, view.values, point)),
        ),
      });
    folder.open = true;
  };
  // The card cuts along the axis that is nearest to the direction of view.
  $("point-cut").addEventListener("click", () => {
    cut(card.point, nearestAxis);
    card.close();
  });
  // A slice cuts along itself, on the side of the viewer.
  const slices = new SlicesPane($("slices"), $("slices-button"), scene, view, {
    read: (axis, at, voxels) => readSlice(scene, axis, at, voxels),
    cuts: folder,
    cut: (point, normal) =>
      cut(point, (towards) => vector((i) => normal[i] * (dot(normal, towards) < 0 ? -1 : 1))),
    onRest,
  });
  card.onOpen = ({ voxel }) => slices.follow(voxel);
  $("point-slices").addEventListener("click", () => slices.toggle());
  return slices;
}

/** Show scale bar and axes, or hide them. @param {ViewModel} view */
function toggleRulers(view) {
  view.set({ rulers: view.values.rulers === "on" ? "off" : "on" });
}

/**
 * Unfold a part, and scroll to it if the picture remains in view; or fold it.
 * @param {HTMLDetailsElement} part
 */
function unfold(part) {
  part.open = !part.open;
  const isSticky = getComputedStyle(find(document, ".picture")).position === "sticky";
  if (part.open && isSticky) part.scrollIntoView({ block: "nearest" });
}

/** Show the picture on the whole screen, or the page again. */
function toggleFull() {
  if (document.fullscreenElement) document.exitFullscreen();
  else if (document.fullscreenEnabled) $("stage").requestFullscreen();
}

/**
 * Start the frame loop, which requests pictures from the server, lets the card draw moving views,
 * and reports the state of the picture.
 * @param {Scene} scene
 * @param {ViewModel} view
 * @param {Picture} picture
 * @param {{trouble: TroublePanel, card: PointCard, shown: Shown, say: (words: string) => void,
 *   scenes: SceneLink[]}} parts
 */
function startLoop(scene, view, picture, { trouble, card, shown, say, scenes }) {
  const status = new Status(document, scene.target_error, (values) => emptyInWords(scene, values));
  const panel = new ErrorPanel($("error"), scene.target_error);
  const times = new Times($("times", HTMLDetailsElement));
  /** @type {(values: Knobs, scale?: number, moving?: boolean) => ReturnType<typeof frameQuery>} */
  const query = (values, scale = 1, moving = false) =>
    queryOf(scene, values, picture, scale, moving);
  const ask =
    (/** @type {(values: Knobs) => Promise<{scene: Scene, values: Knobs}>} */ side) =>
    async (/** @type {FrameOptions} */ options, /** @type {AbortSignal} */ signal) => {
      const of = shown.asked;
      const { scene: drawn, values } = await side(of.values);
      const asked = queryOf(drawn, values, picture, options.scale, options.draft);
      return {
        ...(await readFrame(
          drawn.id,
          { ...asked, ...formatOf(options) },
          { etag: options.etag, signal },
        )),
        of,
      };
    };
  // The requests by which the loop gets pictures.
  const server = {
    open: () => openStream(scene.id),
    view: (/** @type {boolean} */ moving) => ({
      query: query(shown.asked.values, 1, moving),
      chunks: live.draws(shown.asked.values),
      of: shown.asked,
    }),
    ask: ask(async (values) => ({ scene, values })),
    drafts: () => !live.draws(shown.asked.values),
    probe: () => probeScene(scene.id),
  };
  let gone = false; // true if the server no longer has the scene
  const canvas = $("live", HTMLCanvasElement);
  const live = new Live(
    canvas,
    scene,
    cardSource(scene),
    {
      open: () => Card.open(canvas),
      size: () => picture.size(1, true),
      picture: () => $("picture", HTMLImageElement),
      drawn() {
        shown.cover({ of: shown.asked, predicted: live.predicted, shines: live.shines });
        $("stage").dataset.ground = ground(shown.asked.values);
      },
      gone: () => shown.uncover(),
      lost: () => loop.redraw(),
      refused: (reason) => say(reason),
    },
    readAddress(location.search).draw,
  );
  const right = new RightSide(
    scene,
    (id) => readScene(id, picture.size(1, false)),
    $("compare-note"),
  );
  const comparison = new Comparison(
    $("comparison"),
    new Picture($("stage"), $("other", HTMLImageElement)),
    ask((values) => right.of(values, view.values.compare)),
    view,
    namesOf(scene, scenes),
  );
  /** @type {{blob: Blob, of: import("./net/shown.js").Asked}|null} */
  let received = null; // the newest picture of a view at rest, for the panel that saves it
  const loop = new FrameLoop(server, {
    async frame({ blob, facts, chunks, of }, draft) {
      const { sharp } = picture;
      const words = describe(scene, of.values);
      // Drop a picture that would replace one of a newer view, or that was overtaken while it was
      // decoded.
      if (
        shown.surpasses(of) ||
        (blob && !(await (draft ? picture.sketch(blob, words) : picture.show(blob, words))))
      )
        return;
      trouble.hide();
      if (blob && !draft) received = { blob, of };
      shown.part(false);
      shown.show({ of, draft, sharp, facts });
      if (!draft && of === shown.asked) live.rest(of.values, facts, chunks);
      $("stage").dataset.ground = ground(of.values);
      if (facts) times.show(facts, draft);
      // A final picture is requested again with all of the screen's pixels, if these are more.
      const done = shown.state === "final";
      const more = done && !picture.sharp && picture.sharpen();
      $("stage").toggleAttribute("data-sharp", done && !more);
      if (shown.facts) card.refresh();
      if (more) {
        loop.improve();
        comparison.improve();
      }
    },
    trouble(error) {
      // The server does not accept so many pixels: continue with fewer.
      if (picture.sharp && error instanceof Trouble && error.status === REFUSED) {
        picture.blunt();
        return;
      }
      gone = error instanceof Trouble && error.status === GONE;
      // While the server is away, the card goes on drawing if it can.
      const here = error instanceof Trouble && error.retry && live.draws(shown.asked.values);
      if (here) {
        shown.part(true);
        if (!shown.facts) live.show(shown.asked.values);
      } else shown.lose();
      trouble.show(error, here);
    },
    moving(moving) {
      shown.move(moving);
      live.move(moving);
      comparison.moving(moving);
    },
  });
  const tell = () => {
    status.show(shown);
    panel.show(shown);
    comparison.name(shown.values);
  };
  shown.subscribe(tell);
  tell();
  setInterval(() => shown.left && tell(), SECOND_MS); // counts the time left down between answers
  trouble.onRetry = () => (gone ? openScene(null) : loop.settle());
  const ready = () => {
    // The picture on the stage can be saved as it is if it is final, and the one that the controls
    // ask for.
    const { facts } = shown;
    if (!facts || facts.provisional || received?.of.key !== shown.pictureOf?.key) return null;
    const { naturalWidth: width, naturalHeight: height } = $("picture", HTMLImageElement);
    if (received?.blob.type !== "image/png") return null;
    return { blob: received.blob, facts, width, height };
  };
  return { loop, live, ready };
}

/**
 * Return the requests by which a graphics card draws a scene.
 * @param {Scene} scene
 * @returns {import("./live/live.js").Source}
 */
function cardSource({ id }) {
  return {
    document: (query) => readCard(id, query),
    bytes: (href) => readCardBytes(id, href),
    chunks: (query) => readChunks(id, query),
    blocks: (what, chunks, query) => readBlocks(id, what, chunks, query),
  };
}

/**
 * Return the parameters of the request for the picture on the stage.
 * @param {Scene} scene
 * @param {Knobs} values
 * @param {Picture} picture
 * @param {number} [scale] 1 for the full picture, less for drafts
 * @param {boolean} [moving] true if the view goes on changing
 */
function queryOf(scene, values, picture, scale = 1, moving = false) {
  return frameQuery(scene, values, picture.size(scale), moving);
}

/**
 * Return a key that differs for views whose pictures differ: the parameters at rest, with the
 * stage's size.
 * @param {Scene} scene
 * @param {Knobs} values
 * @param {Picture} picture
 */
function keyOf(scene, values, picture) {
  return JSON.stringify(frameQuery(scene, values, picture.size(1, false)));
}

/**
 * Show a view that has changed, if it needs another picture; at first with as many pixels as come
 * quickly.
 * @param {ViewModel} view
 * @param {Picture} picture
 * @param {Shown} shown
 * @param {FrameLoop} loop
 * @param {Live} live
 */
function followView(view, picture, shown, loop, live) {
  if (!shown.ask(view.values)) return;
  live.show(view.values);
  picture.sharp = false;
  $("stage").removeAttribute("data-sharp");
  loop.change();
}

/** Return the parameters of a request for the picture's format. @param {FrameOptions} options */
function formatOf({ draft, waitMs }) {
  return { f: draft ? "jpeg" : "png", wait_ms: waitMs };
}

/**
 * List the scenes to choose from.
 * @param {SceneLink[]} scenes
 * @param {string} current id of the scene that is shown
 */
function offerScenes(scenes, current) {
  const select = $("scene", HTMLSelectElement);
  select.replaceChildren(
    ...scenes.map(({ id, name }) => new Option(name, id, id === current, id === current)),
  );
  select.hidden = scenes.length < 2;
  $("scene-name").hidden = !select.hidden;
  select.onchange = () => openScene(select.value);
}

/** Go to a scene; to the first one if it is null. @param {string|null} id */
function openScene(id) {
  location.search = id === null ? "" : String(new URLSearchParams({ scene: id }));
}

/** Show the same view in the light of an uploaded probe. @param {string} id */
function openLight(id) {
  const query = new URLSearchParams(location.search);
  query.set("environment", id);
  query.delete("exposure"); // belongs to the former light
  location.search = String(query);
}

start();
