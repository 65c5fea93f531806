import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import { Refusal } from "../../../web/isogi_web/card/device.js";
import { Live } from "../../../web/isogi_web/live/live.js";
import { albedoOf, cardView, chunksQuery, documentQuery, lightQuery, turnOf, viewNear } from "../../../web/isogi_web/live/view.js";
import { troubleOf } from "../../../web/isogi_web/net/trouble.js";
import { fromAngles } from "../../../web/isogi_web/view/rotation.js";
import { PAINTED, POLISHED, SCENE, FakeClock, knobs, settled } from "./fixtures.mjs";

const DOCUMENT = { plan: { turns: true }, surfaces: null, grounds: { dark: [0, 0, 0], light: [1, 1, 1] }, volume: { slabs: [{ href: "card/volume/0-2" }, { href: "card/volume/2-4" }] } };
const [A, B] = [knobs({ azimuth: 10 }), knobs({ azimuth: 20 })];
const LIT = { coverage: { provisional: 0 } };

let clock;
let card;
let asked;
let said;
let canvas;
let live;
let listed;

/** A card that notes what it is told; `busy` of one that still draws. */
class FakeCard {
  lost = false;
  busy = false;
  left = 2; // samples until the picture at rest is smooth
  loaded = [];
  drawn = [];
  refined = 0;
  quick = true;
  async isQuick() { return this.quick; }
  async load(document, slabs) { this.loaded.push([document, slabs]); }
  refused = "";
  refuses(shading) { return shading === this.refused; }
  lacking() { return { light: [], transfer: [] }; }
  take() {}
  draw(view, size) {
    if (this.busy) return false;
    Object.assign(canvas, size);
    this.drawn.push(view);
    return true;
  }
  refine() {
    this.refined += 1;
    return this.refined < this.left;
  }
}

/** A canvas, as far as it is asked. */
class FakeCanvas {
  hidden = true;
  width = 300;
  height = 150;
  #attributes = new Set();
  hasAttribute = (name) => this.#attributes.has(name);
  setAttribute = (name) => this.#attributes.add(name);
  removeAttribute = (name) => this.#attributes.delete(name);
}

function makeLive({ scene = SCENE, choice = null, document = { drawable: true, reason: "", scene: DOCUMENT }, open = () => card } = {}) {
  const source = {
    document: async (query) => { asked.push(["document", query]); return document; },
    bytes: async (href) => { asked.push(["bytes", href]); return new ArrayBuffer(4); },
    chunks: async (query) => { asked.push(["chunks", query]); return listed; },
    blocks: async () => assert.fail("there is no light"),
  };
  const hooks = {
    open,
    size: () => ({ width: 80, height: 60 }),
    drawn: () => said.push("drawn"),
    lost: () => said.push("lost"),
    refused: (reason) => said.push(reason),
  };
  return new Live(canvas, scene, source, hooks, choice);
}

/** What was asked of the server. */
const kinds = () => asked.map(([kind]) => kind);

/** A page whose card has loaded what view A takes. */
async function ready(values = {}) {
  live = makeLive(values);
  live.rest(A, LIT);
  await settled();
  return live;
}

/** Show a view for one frame of the screen. */
async function see(view) {
  live.show(view);
  await clock.pass(16);
}

beforeEach(() => {
  [clock, card, asked, said, canvas, listed] = [new FakeClock(), new FakeCard(), [], [], new FakeCanvas(), []];
  globalThis.requestAnimationFrame = (run) => clock.after(16, run);
  Object.defineProperty(globalThis, "performance", { value: clock, configurable: true });
});

test("the server draws until the card has what it takes", async () => {
  live = makeLive();
  live.show(A);
  await clock.pass(100);
  assert.deepEqual([live.draws(A), asked, canvas.hidden], [false, [], true]);
  await ready();
  assert.deepEqual([live.draws(A), live.draws(B), kinds()], [true, true, ["document", "bytes", "bytes", "chunks"]]);
  assert.deepEqual([card.loaded[0][0], card.loaded[0][1].length], [DOCUMENT, 2]);
});

test("what moves is drawn once a frame of the screen, the newest view", async () => {
  await ready();
  live.move(true);
  for (let i = 0; i < 10; i++) live.show(knobs({ azimuth: i }));
  await clock.pass(16);
  assert.deepEqual([card.drawn.length, canvas.hidden, [canvas.width, canvas.height], said], [1, false, [80, 60], ["drawn"]]);
  const eye = cardView(SCENE, DOCUMENT, knobs({ azimuth: 9 })).camera.eye;
  assert.deepEqual(card.drawn[0].camera.eye, eye);
});

test("a card that is busy draws the newest view a frame later", async () => {
  await ready();
  card.busy = true;
  live.show(A);
  await clock.pass(48);
  assert.deepEqual([card.drawn.length, canvas.hidden], [0, true]);
  card.busy = false;
  await see(B);
  assert.deepEqual([card.drawn.length, canvas.hidden], [1, false]);
});

test("a view at rest becomes smooth, until it is", async () => {
  await ready();
  live.move(true);
  live.show(A);
  await clock.pass(100);
  assert.equal(card.refined, 0);
  live.move(false);
  await clock.pass(1000);
  assert.deepEqual([card.refined, clock.waits], [2, []]);
});

test("the server's picture is laid open where it is lit all over", async () => {
  await ready();
  await see(B);
  live.rest(B, { coverage: { provisional: 0.1 } }, []);
  assert.equal(live.shows, true);
  live.rest(B, LIT, []);
  assert.deepEqual([live.shows, canvas.hidden], [false, false]);
  await see(A);
  assert.equal(live.shows, true, "what moves again is there at once");
});

test("marks that the server draws are shown before all is lit", async () => {
  await ready();
  const marked = knobs({ overlay: "error" });
  await see(marked);
  live.rest(marked, { coverage: { provisional: 1 } }, []);
  assert.equal(live.shows, false);
});

test("chunks are listed now and then while a view moves", async () => {
  await ready();
  asked.length = 0;
  live.move(true);
  for (let i = 0; i < 100; i++) {
    live.show(knobs({ azimuth: i / 10 }));
    await clock.pass(16);
  }
  assert.ok(kinds().length >= 1 && kinds().length <= 2, String(kinds().length));
  assert.deepEqual([...new Set(kinds())], ["chunks"]);
});

/** Turn the object once around, and back to where it began; how often chunks were asked for. */
async function turnAround() {
  asked.length = 0;
  live.move(true);
  for (let azimuth = -180; azimuth <= 180; azimuth++) {
    live.show(knobs({ azimuth: ((azimuth + 540) % 360) - 180 }));
    await clock.pass(1001);
  }
  return kinds().length;
}

test("whoever turns on over final light asks for no more lists", async () => {
  await ready();
  listed = [{ at: "0.0.1", version: "1a", final: true }];
  assert.equal(await turnAround(), 24);
  const angles = asked.map(([, { azimuth }]) => azimuth).sort((a, b) => a - b);
  assert.deepEqual(angles, Array.from({ length: 24 }, (_, i) => 15 * i - 180));
  assert.equal(await turnAround(), 0);
  live.show(knobs({ azimuth: 0, isovalue: 80 }));
  await clock.pass(1001);
  assert.equal(kinds().length, 1, "another isosurface reads other chunks");
});

test("light that converges is listed again and again", async () => {
  await ready();
  listed = [{ at: "0.0.1", version: "1a", final: true }, { at: "0.0.2", version: "2b", final: false }];
  assert.equal(await turnAround(), 360, "all but the first, which comes at once after another list");
});

test("a view at rest is listed as it is", async () => {
  await ready();
  asked.length = 0;
  live.rest(knobs({ azimuth: 17.5, elevation: 31 }), LIT);
  await settled();
  assert.deepEqual(asked.map(([, { azimuth, elevation }]) => [azimuth, elevation]), [[17.5, 31]]);
});

test("views that move are listed by one nearby", () => {
  for (const [azimuth, near] of [[7, 0], [8, 15], [-179, -180], [175, -180], [180, -180], [-8, -15]]) {
    assert.equal(viewNear(knobs({ azimuth })).azimuth, near, String(azimuth));
  }
  assert.equal(viewNear(knobs({ elevation: 88 })).elevation, 90);
  const { isovalue, yaw, pitch, roll } = viewNear(knobs({ isovalue: 80, yaw: 20, pitch: 5, roll: 1 }));
  assert.deepEqual([isovalue, yaw, pitch, roll], [80, 0, 0, 0], "which chunks a view reads does not depend on light");
});

test("a card that is lost leaves what moves to the server", async () => {
  await ready();
  await see(A);
  card.lost = true;
  card.onlost();
  assert.deepEqual([said.at(-1), canvas.hidden, live.draws(B)], ["lost", true, false]);
  card.lost = false;
  card.onrestored();
  await see(B);
  assert.deepEqual([live.draws(B), canvas.hidden], [true, false]);
});

test("a card that is slow leaves all to the server", async () => {
  await ready();
  live.move(true);
  for (let i = 0; i < 4; i++) {
    card.busy = true;
    live.show(knobs({ azimuth: i }));
    await clock.pass(300);
    card.busy = false;
    await clock.pass(16);
  }
  assert.deepEqual([live.draws(A), canvas.hidden, said.at(-1)], [false, true, "lost"]);
});

test("a card that takes no more light leaves all to the server", async () => {
  await ready();
  await see(A);
  card.lacking = () => { throw new Error("The graphics card has no room for more texels."); };
  live.rest(A, { coverage: { provisional: 0.5 } }, []);
  await settled();
  assert.deepEqual([live.draws(A), canvas.hidden, said.at(-1)], [false, true, "lost"]);
});

test("a hand that pauses is no slow card", async () => {
  await ready();
  live.move(true);
  for (let i = 0; i < 9; i++) {
    live.show(knobs({ azimuth: i }));
    await clock.pass(400);
  }
  assert.equal(live.draws(A), true);
});

test("another albedo is drawn at once, and its light brought at rest", async () => {
  const grey = knobs({ albedo: 0.7, tint: "#ffffff" }), dark = { ...grey, albedo: 0.35 };
  live = makeLive({ scene: PAINTED });
  live.rest(grey, LIT);
  await settled();
  asked.length = 0;
  live.move(true);
  await see(grey);
  live.show(dark);
  await clock.pass(2000);
  await see(dark);
  assert.deepEqual(card.drawn.map(({ albedo }) => albedo), [[1, 1, 1], [0.5, 0.5, 0.5], [0.5, 0.5, 0.5]]);
  assert.deepEqual([live.draws(dark), live.predicted, kinds().filter((kind) => kind !== "chunks")], [true, null, []]);
  live.move(false);
  live.rest(dark, LIT, []);
  await settled();
  assert.deepEqual([card.loaded.length, asked.find(([kind]) => kind === "document")[1].albedo], [2, 0.35]);
  await see(dark);
  assert.deepEqual(card.drawn.at(-1).albedo, [1, 1, 1]);
});

test("local models are drawn without light", async () => {
  const phong = knobs({ shading: "phong_shadow" });
  live = makeLive();
  live.rest(phong, LIT);
  await settled();
  await see(phong);
  assert.equal(card.drawn.at(-1).shading, "phong_shadow");
  assert.deepEqual([kinds(), live.predicted], [["document", "bytes", "bytes"], 0]);
  assert.deepEqual([live.draws(A), live.draws(knobs({ shading: "vicinity" }))], [false, false]);
  live.rest(A, LIT);
  await settled();
  assert.deepEqual([live.draws(A), kinds().at(-1), card.loaded.length], [true, "chunks", 1]);
  await see(A);
  assert.equal(card.drawn.at(-1).shading, "gi");
});

test("a shading that a card refuses is drawn by the server", async () => {
  await ready();
  const fog = knobs({ shading: "lambert_fog" });
  card.busy = true;
  await see(fog);
  assert.deepEqual([live.draws(fog), said], [true, []]);
  card.refused = "lambert_fog";
  await clock.pass(16);
  assert.deepEqual([live.draws(fog), canvas.hidden, said], [false, true, ["lost"]]);
  assert.equal(live.draws(A), true);
});

test("a black surface tells nothing of another albedo", async () => {
  const black = knobs({ albedo: 0, tint: "#ffffff" });
  live = makeLive({ scene: PAINTED });
  live.rest(black, LIT);
  await settled();
  assert.deepEqual([live.draws(black), live.draws({ ...black, albedo: 0.5 })], [true, false]);
  assert.deepEqual(cardView(PAINTED, DOCUMENT, black, [0, 0, 0]).albedo, [1, 1, 1]);
  assert.deepEqual([albedoOf(SCENE, black), albedoOf(PAINTED, { ...black, albedo: 0.4 })], [[0.7, 0.7, 0.7], [0.4, 0.4, 0.4]]);
});

test("another light is drawn by the server, until the card has it", async () => {
  await ready();
  const other = { ...A, environment: "studio" };
  await see(A);
  live.show(other);
  assert.deepEqual([live.draws(other), canvas.hidden], [false, true]);
  live.rest(other, LIT, []);
  await settled();
  assert.deepEqual([live.draws(other), live.draws(A), card.loaded.length], [true, false, 2]);
});

test("views that a card cannot draw stay with the server", async () => {
  await ready({ document: { drawable: false, reason: "Walls are lit by the server.", scene: null } });
  assert.deepEqual([live.draws(A), said], [false, []]);
  live.rest(knobs({ shading: "vicinity" }), LIT, []);
  await settled();
  assert.deepEqual(kinds(), ["document"], "nor is the server asked for other shadings");
});

test("why a card does not draw is told to those who want it", async () => {
  const open = () => { throw new Refusal("This browser draws by its processor."); };
  await ready({ choice: "card", open });
  await ready({ open });
  assert.deepEqual([said, asked], [["This browser draws by its processor."], []]);
  assert.equal(live.draws(A), false);
});

test("who asks for the server's pictures gets them", async () => {
  await ready({ choice: "server", open: () => assert.fail("no card is wanted") });
  assert.deepEqual([live.draws(A), asked], [false, []]);
});

test("a server that is away is asked again at the next rest", async () => {
  let away = true;
  live = makeLive({ open: () => { if (away) throw troubleOf({ status: 503, detail: "away" }); return card; } });
  live.rest(A, LIT);
  await settled();
  assert.equal(live.draws(A), false);
  away = false;
  live.rest(A, LIT);
  await settled();
  assert.equal(live.draws(A), true);
});

test("the document is asked for by what it depends on", () => {
  const values = knobs({ environment: "studio", planes: "x>4;1,1,0<3", azimuth: 7, yaw: 20, isovalue: 80 });
  assert.deepEqual(documentQuery(SCENE, values), { environment: "studio", cut: "x>4", shading: "gi" });
  assert.deepEqual(documentQuery(SCENE, knobs({ azimuth: 1, exposure: 3 })), documentQuery(SCENE, knobs({ yaw: 5 })));
});

test("chunks and light are asked for without what does not count", () => {
  const values = knobs({ environment: "studio", yaw: 20, exposure: 3, overlay: "error" });
  const chunks = chunksQuery(SCENE, values, { width: 1280, height: 640 });
  assert.deepEqual([chunks.width, chunks.height, chunks.yaw, chunks.environment], [160, 80, 20, "studio"]);
  for (const name of ["f", "overlay", "background", "exposure"]) assert.equal(name in chunks, false, name);
  const turn = { yaw: 20, pitch: 0, roll: 0 };
  assert.deepEqual(lightQuery(SCENE, DOCUMENT, values, turn), { environment: "studio", ...turn });
  assert.deepEqual(lightQuery(SCENE, DOCUMENT, values, null), { environment: "studio" });
});

test("light of pinned surfaces is asked for at the isovalue that is shown", () => {
  const turn = { yaw: 0, pitch: 0, roll: 0 };
  const document = { ...DOCUMENT, surfaces: [{ isovalue: null }, { isovalue: 50 }] };
  assert.deepEqual(lightQuery(SCENE, document, knobs({ isovalue: 80 }), turn), { isovalue: 80, ...turn });
});

test("light that is baked for each turn is another document at each, and lies still", () => {
  const scene = { ...SCENE, turn_step: 5 };
  const values = knobs({ yaw: 22, pitch: 0, roll: 0 });
  const document = { ...DOCUMENT, plan: { turns: false } };
  const turn = { yaw: 20, pitch: 0, roll: 0 };
  assert.deepEqual(documentQuery(scene, values), { ...turn, shading: "gi" });
  assert.deepEqual(lightQuery(scene, document, values, turnOf(scene, document, values)), turn);
  assert.deepEqual(cardView(scene, document, values).light, [1, 0, 0, 0]);
  assert.deepEqual([viewNear(values, scene).yaw, viewNear(values).yaw], [22, 0]);
});

test("hidden surfaces leave light that the card turns, in the steps of the server's pictures", () => {
  const scene = { ...SCENE, turn_step: 5, surfaces: [{ isovalue: 50 }] };
  const values = knobs({ surfaces: "off", yaw: 22, pitch: 0, roll: 0 });
  const turn = turnOf(scene, DOCUMENT, values);
  assert.deepEqual(turn, { yaw: 20, pitch: 0, roll: 0 });
  assert.deepEqual(cardView(scene, DOCUMENT, values).light, fromAngles(turn));
  assert.deepEqual(lightQuery(scene, DOCUMENT, values, turn), { surfaces: "off", ...turn });
});

test("the lobe of a view is that of its knobs, and asks for no other document", () => {
  const document = { ...DOCUMENT, shine: { kind: "plastic", roughness: 0.3, strength: 1 } };
  const asked = knobs({ shine: "metal", roughness: 0.1, strength: 0.5 });
  assert.deepEqual(cardView(POLISHED, document, asked).shine, { kind: "metal", roughness: 0.1, strength: 0.5 });
  assert.deepEqual(cardView(POLISHED, document, knobs({})).shine, { kind: "plastic", roughness: 0.3, strength: 1 });
  assert.equal("shine" in cardView(POLISHED, DOCUMENT, asked), false);
  assert.deepEqual(documentQuery(POLISHED, asked), documentQuery(POLISHED, knobs({})));
});

test("planes along no axis are a window of the card", () => {
  const { window } = cardView(SCENE, DOCUMENT, knobs({ planes: "x>4;0,3,4<10" }));
  assert.deepEqual(window, [{ normal: [-0, -0.6, -0.8], limit: -2 }]);
  assert.deepEqual(cardView(SCENE, DOCUMENT, knobs({})).window, []);
});

test("a card's camera is the server's", () => {
  const { camera, light, ground, isovalue } = cardView(SCENE, DOCUMENT, knobs({ azimuth: 0, elevation: 0, distance: 2, background: "light" }));
  const radius = Math.hypot(10, 10, 10) / 2;
  assert.deepEqual(camera.target, [5, 5, 5]);
  assert.ok(Math.abs(camera.eye[0] - (5 + 2 * radius)) < 1e-9 && Math.abs(camera.eye[1] - 5) < 1e-9);
  assert.deepEqual([camera.parallel, light, ground, isovalue], [false, [1, 0, 0, 0], [1, 1, 1], 70]);
  const parallel = cardView(SCENE, DOCUMENT, knobs({ azimuth: 0, elevation: 0, distance: 2, projection: "orthographic" })).camera;
  assert.deepEqual([parallel.parallel, parallel.eye], [true, camera.eye]);
});

test("the error of the card's pictures is predicted once all their light is here, and final", async () => {
  const document = { drawable: true, reason: "", scene: { ...DOCUMENT, target: 0.03, expected: 0.04 } };
  await ready({ document });
  assert.equal(live.predicted, null, "no list has come");
  const chunks = [{ at: "0.0.1", version: "1a", final: true }, { at: "0.0.2", version: "2b", final: true }];
  card.drawing = { texels: { chunks: new Map([["0.0.1", { version: "1a" }]]) } };
  live.rest(A, LIT, chunks);
  assert.equal(live.predicted, null, "one is not here");
  card.drawing.texels.chunks.set("0.0.2", { version: "2b" });
  assert.ok(Math.abs(live.predicted - 0.05) < 1e-12);
  live.rest(A, LIT, [{ ...chunks[0], final: false }, chunks[1]]);
  assert.equal(live.predicted, null, "one converges");
});

test("no error is predicted of pinned surfaces' light from another isovalue", async () => {
  const surfaces = [{ isovalue: null }, { isovalue: 50 }];
  const document = { drawable: true, reason: "", scene: { ...DOCUMENT, surfaces, target: 0.03, expected: 0.04 } };
  await ready({ document });
  card.drawing = { texels: { chunks: new Map([["0.0.1", { version: "1a" }]]) } };
  live.rest(A, LIT, [{ at: "0.0.1", version: "1a", final: true }]);
  assert.ok(Math.abs(live.predicted - 0.05) < 1e-12);
  live.move(true);
  live.show(knobs({ azimuth: 10, isovalue: 80 }));
  assert.equal(live.predicted, null);
});

test("a list for an isovalue that a view slid past is not taken at rest", async () => {
  const surfaces = [{ isovalue: null }, { isovalue: 50 }];
  await ready({ document: { drawable: true, reason: "", scene: { ...DOCUMENT, surfaces, target: 0.03, expected: 0.04 } } });
  card.drawing = { texels: { chunks: new Map([["0.0.1", { version: "1a" }]]) } };
  listed = [{ at: "0.0.1", version: "9z", final: true }];
  await clock.pass(1001);
  live.move(true);
  live.show(knobs({ isovalue: 80 }));
  live.move(false);
  live.rest(knobs({ isovalue: 90 }), LIT, [{ at: "0.0.1", version: "1a", final: true }]);
  await settled();
  assert.deepEqual(kinds().filter((kind) => kind === "chunks").length, 2, "one came late");
  assert.ok(live.predicted !== null, "and did not replace that of the picture");
});

test("a shiny view has no predicted error, and is compared with a final picture", async () => {
  const shine = { surroundings: { href: "card/surroundings" } };
  const document = { drawable: true, reason: "", scene: { ...DOCUMENT, shine, target: 0.03, expected: 0.04 } };
  await ready({ document });
  assert.deepEqual(asked.filter(([kind]) => kind === "bytes").at(-1), ["bytes", "card/surroundings"]);
  card.drawing = { texels: { chunks: new Map([["0.0.1", { version: "1a" }]]) } };
  const chunks = [{ at: "0.0.1", version: "1a", final: true }];
  live.rest(A, { ...LIT, provisional: true }, chunks);
  await clock.pass(2000);
  assert.deepEqual([live.shines, live.predicted, card.drawn.length], [true, null, 0], "not with a picture of single rays");
  live.rest(A, { ...LIT, provisional: false }, chunks);
  await clock.pass(2000);
  assert.equal(card.drawn.length, 1);
  assert.equal(live.shines, true);
  live.show(knobs({ shading: "phong" }));
  assert.deepEqual([live.shines, live.predicted], [false, 0], "local models do not shine");
});
