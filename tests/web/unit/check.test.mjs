import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import { MOST_DIFFER, shareThatDiffers } from "../../../web/isogi_web/live/check.js";
import { Live } from "../../../web/isogi_web/live/live.js";
import { FakeClock, SCENE, knobs, settled } from "./fixtures.mjs";

const SIZE = { width: 80, height: 60 };
const LIT = { provisional: false, coverage: { provisional: 0 } };
const CHUNKS = [{ at: "0.0.1", version: "1a", final: true }];
const DOCUMENT = { plan: { turns: true }, surfaces: null, grounds: { dark: [0, 0, 0], light: [1, 1, 1] }, volume: { slabs: [] }, target: 0.016, expected: 0.012 };

/** A disc with a gentle slope on a plain ground, rows from the top, and `change(level, x, y)` of it. */
function disc(change = (level) => level) {
  const found = new Uint8Array(4 * SIZE.width * SIZE.height);
  for (let y = 0; y < SIZE.height; y++) for (let x = 0; x < SIZE.width; x++) {
    const level = Math.hypot(x - 40, y - 30) < 28 ? change(60 + x + 0.7 * y, x, y) : 20;
    found.set([level, level, level, 255], 4 * (y * SIZE.width + x));
  }
  return found;
}

/** The same rows, from below. */
function flipped(picture) {
  const row = 4 * SIZE.width;
  return Uint8Array.from(picture, (_, i) => picture[(SIZE.height - 1 - Math.floor(i / row)) * row + (i % row)]);
}

const share = (card, server = disc(), error = 0.02) => shareThatDiffers(flipped(card), server, SIZE, error);

test("equal pictures do not differ, and rounding does not count", () => {
  assert.equal(share(disc()), 0);
  assert.equal(share(disc((level, x) => level + (x % 3))), 0);
});

test("light of pixels' own is within what is left of the error", () => {
  assert.equal(share(disc((level, x, y) => (y > 40 ? 1.1 * level : level))), 0);
  assert.ok(share(disc((level, x, y) => (y > 40 ? 1.4 * level : level))) > MOST_DIFFER);
});

test("what is wrong everywhere is found, also within the tail of errors", () => {
  assert.equal(share(disc((level) => 1.08 * level), disc(), 0.1), 0);
  assert.ok(share(disc((level) => 1.4 * level), disc(), 0.1) > 0.9);
  assert.equal(share(disc((level, x) => (x > 60 ? 1.4 * level : level)), disc(), 0.1), 0, "a part alone may be pixels' own light");
});

test("what differs is counted, in any channel", () => {
  const wrong = disc();
  for (let i = 2; i < wrong.length; i += 4) wrong[i] = 255 - wrong[i];
  assert.ok(share(wrong) > 0.5);
  const part = share(disc((level, x) => (x > 55 ? 0 : level)));
  assert.ok(part > 0.1 && part < 0.3, String(part));
});

test("noise does not count where neighbours are averaged, and what is wrong does", () => {
  const noisy = (level, x, y) => level * ((x + y) % 2 ? 1.3 : 0.7);
  const averaged = (card) => shareThatDiffers(flipped(card), disc(), SIZE, 0.02, 2);
  assert.ok(share(disc(noisy)) > 0.9);
  assert.ok(averaged(disc(noisy)) < 0.01);
  assert.ok(averaged(disc((level) => 1.4 * level)) > 0.9);
});

test("means that reach an edge are left out", () => {
  const size = { width: 120, height: 90 };
  const levelAt = (x, step) => 40 + x + (x % 12 < 3 ? step : 0);
  const striped = (step) => Uint8Array.from({ length: 4 * size.width * size.height }, (_, i) => levelAt(Math.floor(i / 4) % size.width, step));
  const averaged = (around) => shareThatDiffers(striped(80), striped(40), size, 0.02, around);
  assert.ok(averaged(0) > 0.05, "pixels in the middle of a stripe differ");
  assert.equal(averaged(2), 0);
});

test("edges and the ground are left out", () => {
  const striped = disc((level, x) => (x % 8 < 2 ? 20 : level));
  assert.ok(share(disc((level, x) => ([7, 0, 1, 2].includes(x % 8) ? 250 : level)), striped) <= 0, "all that differs is at an edge");
  assert.equal(shareThatDiffers(disc(), new Uint8Array(4 * 80 * 60).fill(20), SIZE, 0.02), null, "ground alone");
});

let clock;
let document;
let canvas;
let card;
let said;
let image;
let live;

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

/** A card that needs three frames until its picture is as good as it can be, and then shows `pixels`. */
class FakeCard {
  lost = false;
  drawn = 0;
  left = 0;
  reads = 0;
  pixels = flipped(disc());
  drawing = { texels: { chunks: new Map([["0.0.1", { version: "1a" }]]) } };
  isQuick = async () => true;
  refuses = () => false;
  async load() {}
  lacking = () => ({ light: [], transfer: [] });
  draw(view, size) {
    Object.assign(canvas, size);
    this.drawn += 1;
    this.left = 3;
    return true;
  }
  refine() {
    this.left = Math.max(this.left - 1, 0);
    return this.left > 0;
  }
  read() {
    this.reads += 1;
    assert.equal(this.left, 0, "the picture is as good as it can be");
    return this.pixels;
  }
}

beforeEach(async () => {
  [clock, canvas, card, said] = [new FakeClock(), new FakeCanvas(), new FakeCard(), []];
  image = { naturalWidth: 80, naturalHeight: 60, data: disc() };
  globalThis.requestAnimationFrame = (run) => clock.after(16, run);
  globalThis.OffscreenCanvas = class {
    getContext() { return { drawImage() {}, getImageData: () => ({ data: image.data }) }; }
  };
  Object.defineProperty(globalThis, "performance", { value: clock, configurable: true });
  document = DOCUMENT;
  const source = { document: async () => ({ scene: document }), bytes: async () => new ArrayBuffer(4), chunks: async () => CHUNKS };
  const hooks = { open: () => card, size: () => SIZE, picture: () => image, drawn() {}, lost: () => said.push("lost"), refused: (reason) => said.push(reason) };
  live = new Live(canvas, SCENE, source, hooks, null);
  live.rest(knobs({}), LIT);
  await settled();
});

/** Turn the object, and rest until the server's picture is there. */
async function turn(values = knobs({ azimuth: 10 })) {
  live.move(true);
  live.show(values);
  await clock.pass(50);
  live.move(false);
  live.rest(values, LIT, CHUNKS);
  await clock.pass(1000);
  return values;
}

test("a card that draws as the server does goes on, and is checked once", async () => {
  await turn();
  await turn(knobs({ azimuth: 20 }));
  assert.deepEqual([card.reads, said, live.draws(knobs({}))], [1, [], true]);
  assert.deepEqual([live.shows, clock.waits], [false, []], "nobody sees it, and nothing goes on");
});

test("shine is checked at the first rest that shows it", async () => {
  document = { ...DOCUMENT, shine: { kind: "plastic", roughness: 0.3, strength: 1, surroundings: { href: "card/surroundings" } } };
  live.rest(knobs({ environment: "studio" }), LIT);
  await settled();
  const values = (strength) => knobs({ environment: "studio", strength, azimuth: 10 * strength });
  await turn(values(0));
  await turn(values(0.5));
  await turn(values(1));
  assert.deepEqual([card.reads, said], [2, []]);
});

test("a card that draws another picture leaves all to the server, which is said", async () => {
  card.pixels = flipped(disc((level, x) => (x % 20 < 9 ? 0 : level)));
  await turn();
  assert.equal(live.draws(knobs({})), false);
  assert.match(said.at(-1), /^The graphics card draws \d+ % of the pixels differently from the server: the server draws\.$/);
});

test("a card is not checked before it has the light of the picture", async () => {
  card.pixels = flipped(disc(() => 0));
  const { chunks } = card.drawing.texels;
  chunks.clear();
  const values = await turn();
  assert.deepEqual([card.reads, clock.waits], [0, []]);
  chunks.set("0.0.1", { version: "1a" });
  live.rest(values, LIT, CHUNKS);
  await clock.pass(1000);
  assert.deepEqual([card.reads, live.draws(values)], [1, false]);
});

test("a picture of fewer pixels waits for the one with all", async () => {
  image.naturalWidth = 40;
  const values = await turn();
  assert.deepEqual([card.reads, clock.waits], [0, []]);
  image.naturalWidth = 80;
  live.rest(values, LIT, CHUNKS);
  await clock.pass(1000);
  assert.equal(card.reads, 1);
});

test("a hand that goes on ends the check", async () => {
  const values = knobs({ azimuth: 30 });
  live.move(true);
  live.show(values);
  await clock.pass(50);
  live.move(false);
  live.rest(values, LIT, CHUNKS);
  await clock.pass(210);
  live.move(true);
  live.show(knobs({ azimuth: 31 }));
  await clock.pass(1000);
  assert.deepEqual([card.reads, live.shows], [0, true]);
});
