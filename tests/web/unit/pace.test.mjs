import assert from "node:assert/strict";
import { test } from "node:test";
import { Card } from "../../../web/isogi_web/card/card.js";
import { largerShare, smallerShare } from "../../../web/isogi_web/card/pace.js";
import { Live } from "../../../web/isogi_web/live/live.js";
import { FakeClock, SCENE, knobs, settled } from "./fixtures.mjs";

const SIZE = { width: 1000, height: 800 };
const DOCUMENT = { plan: { turns: true }, surfaces: null, grounds: { dark: [0, 0, 0], light: [1, 1, 1] }, volume: { slabs: [] } };
const LIT = { coverage: { provisional: 0 } };
const EVERY_MS = 4; // between two timers of a browser at least, and so what a reading is unsure by

/** What of WebGL fences need, on a card that is done with its work one piece after the other. */
class FakeGL {
  TIMEOUT_EXPIRED = 1;
  WAIT_FAILED = 2;
  free = 0; // when all is done that was asked for
  constructor(clock) { this.clock = clock; }
  work(ms) { this.free = Math.max(this.free, this.clock.now()) + ms; }
  fenceSync() { return { done: this.free }; }
  clientWaitSync({ done }) { return this.clock.now() < done ? this.TIMEOUT_EXPIRED : 3; }
  deleteSync() {}
  flush() {}
}

/** A canvas without a picture, and how often another size made it black. */
class FakeCanvas extends EventTarget {
  hidden = true;
  blacks = 0;
  #size = [300, 150];
  #attributes = new Set();
  hasAttribute = (name) => this.#attributes.has(name);
  setAttribute = (name) => this.#attributes.add(name);
  removeAttribute = (name) => this.#attributes.delete(name);
  get width() { return this.#size[0]; }
  get height() { return this.#size[1]; }
  set width(x) { this.#size[0] = x; this.blacks += 1; }
  set height(y) { this.#size[1] = y; this.blacks += 1; }
}

/**
 * A page whose card takes `ms` for a picture in all pixels, of which `rows(y, n)` is what a row takes over the mean row,
 * and whose screen has `hz` frames a second.
 */
async function pageOf(ms, hz, rows = () => 1) {
  const clock = new FakeClock(), canvas = new FakeCanvas(), gl = new FakeGL(clock), size = { ...SIZE };
  globalThis.requestAnimationFrame = (run) => {
    const frame = Math.floor((clock.now() * hz) / 1000 + 1e-6) + 1;
    return clock.after((frame * 1000) / hz - clock.now(), run);
  };
  Object.defineProperty(globalThis, "performance", { value: clock, configurable: true });
  const draws = [], shows = [], card = new Card(canvas, { gl }, null);
  card.pace.clock = { now: clock.now, after: (ms, run) => clock.after(Math.max(ms, EVERY_MS), run) };
  card.isQuick = async () => true;
  card.load = async () => {
    card.drawing = {
      texels: { chunks: new Map() },
      refused: new Set(),
      isReady: () => true,
      sample(view, [width, height], n, [from, to] = [0, height]) {
        let share = 0;
        for (let y = from; y < to; y++) share += (rows(y / height, n) * width) / (SIZE.width * SIZE.height);
        gl.work(ms * share);
        draws.push({ at: clock.now(), width, n, ms: ms * share, view });
      },
      show: (_, [width]) => shows.push({ at: clock.now(), width, blacks: canvas.blacks }),
    };
  };
  const said = [], source = { document: async () => ({ scene: DOCUMENT }), chunks: async () => [] };
  const hooks = { open: () => card, size: () => ({ ...size }), drawn: () => said.push("drawn"), lost: () => said.push("lost"), refused: (reason) => said.push(reason) };
  const live = new Live(canvas, SCENE, source, hooks, null);
  live.rest(knobs({ azimuth: 0 }), LIT);
  await settled();
  return { clock, canvas, card, live, draws, shows, said, size };
}

let azimuth = 0;

/** Drag with so many `events` a second, then rest until the server's picture is there; the pictures that were drawn. */
async function drag({ clock, live, draws }, events, seconds = 0.5) {
  const first = draws.length;
  for (let i = 0; i < events * seconds; i++) {
    azimuth = (azimuth + 1) % 360;
    live.show(knobs({ azimuth }));
    live.move(true);
    await clock.pass(1000 / events);
  }
  await clock.pass(200);
  const drawn = draws.slice(first);
  live.move(false);
  await clock.pass(700);
  live.rest(knobs({ azimuth }), LIT, []);
  await clock.pass(300);
  return drawn;
}

for (const ms of [2, 8, 20, 60]) {
  for (const hz of [60, 75, 120, 144]) {
    test(`a card of ${ms} ms draws its share of the width at ${hz} Hz`, async () => {
      const wanted = Math.min(1, Math.sqrt(20 / ms));
      for (const events of [10, 30, 60, 120]) {
        const page = await pageOf(ms, hz);
        for (let i = 0; i < 9; i++) await drag(page, events, i < 3 ? 0.2 : 0.5);
        const shares = (await drag(page, events)).map(({ width }) => width / SIZE.width);
        assert.ok(shares.length > 4 && shares.every((share) => Math.abs(share - wanted) <= 0.1 * wanted), `${events} events/s: ${shares} is not ${wanted}`);
      }
    });
  }
}

test("time in which nothing is drawn does not count", async () => {
  const page = await pageOf(2, 60);
  for (let i = 0; i < 4; i++) await drag(page, 60);
  await page.clock.pass(60_000);
  assert.deepEqual(page.clock.waits, [], "a card at rest is not looked at");
  assert.equal((await drag(page, 60))[0].width, SIZE.width);
});

test("a page that is busy itself learns nothing of its card", async () => {
  const page = await pageOf(2, 60);
  await drag(page, 60);
  page.card.pace.clock = { now: page.clock.now, after: (_, run) => page.clock.after(400, run) };
  for (let i = 0; i < 3; i++) assert.equal((await drag(page, 1, 3)).at(-1).width, SIZE.width);
});

test("a card that nobody knows begins small, and doubles", async () => {
  const [first, second, third] = await drag(await pageOf(2, 60), 60);
  assert.deepEqual([first.width, second.width, third.width], [250, 500, 1000]);
});

/** Of a picture whose middle takes all of the time. */
const middle = (y, n) => (Math.abs(y - 0.5) < 0.15 ? 3.3 : 0.02) * (n ? 0.3 : 1);

for (const ms of [2, 60, 300]) {
  test(`a card of ${ms} ms becomes smooth in bands of some milliseconds`, async () => {
    const { clock, live, draws, shows, card } = await pageOf(ms, 60, middle);
    live.show(knobs({ azimuth: 5 }));
    live.move(true);
    await clock.pass(500);
    live.move(false);
    await clock.pass(120_000);
    const bands = draws.filter(({ width }) => width === SIZE.width);
    assert.equal(card.last.samples, 17);
    assert.ok(Math.max(...draws.map((each) => each.ms)) <= Math.max(20, ms / 10), `${Math.max(...draws.map((each) => each.ms))} ms`);
    const most = Math.max(...bands.filter(({ n }) => n > 1).map((each) => each.ms));
    assert.ok(most <= Math.max(8 + EVERY_MS, (3.3 * ms) / 64), `${most} ms`);
    assert.ok(bands.length <= 64 + 17 * (1 + Math.ceil((3.3 * ms) / 4)), `${bands.length} bands, the first ones small`);
    const whole = shows.filter(({ width }) => width === SIZE.width);
    assert.equal(whole.length, 17, "each sample is shown once, whole");
  });
}

test("a hand need not wait for a picture at rest", async () => {
  const { clock, live, draws } = await pageOf(300, 60);
  live.show(knobs({ azimuth: 1 }));
  await clock.pass(1000);
  const first = draws.length;
  live.show(knobs({ azimuth: 2 }));
  await clock.pass(50);
  assert.ok(draws.slice(first).some(({ width, n }) => width < 500 && n === 0));
});

test("another size makes no canvas black that is not drawn then", async () => {
  const { clock, canvas, live, size, shows, draws } = await pageOf(300, 60);
  live.show(knobs({ azimuth: 1 }));
  await clock.pass(20);
  for (let i = 0; i < 30; i++) {
    size.width = 600 + i;
    live.show(knobs({ azimuth: i }));
    await clock.pass(7);
    assert.equal(shows.at(-1).blacks, canvas.blacks, "black since it was drawn");
  }
  assert.ok(draws.length > 3 && canvas.width > 600);
});

test("what waits to be drawn does not lie over the server's picture", async () => {
  const { clock, live } = await pageOf(300, 60);
  live.show(knobs({ azimuth: 1 }));
  await clock.pass(20);
  live.show(knobs({ azimuth: 2 }));
  live.rest(knobs({ azimuth: 2 }), LIT, []);
  assert.equal(live.shows, false);
  await clock.pass(2000);
  assert.equal(live.shows, false);
});

test("a card that is lost begins small again", async () => {
  const page = await pageOf(2, 60);
  await drag(page, 60);
  const { pace } = page.card;
  assert.equal(pace.share, 1);
  pace.restart(pace.gl);
  assert.deepEqual([(await drag(page, 60))[0].width, pace.share], [250, 1]);
});

test("a card that is lost twice in a minute leaves all to the server", async () => {
  for (const [apart, last] of [[50_000, "The graphics card was lost twice within a minute: the server draws."], [70_000, "lost"]]) {
    const { clock, canvas, card, live, said } = await pageOf(2, 60);
    await clock.pass(100_000);
    const lose = () => canvas.dispatchEvent(new Event("webglcontextlost", { cancelable: true }));
    assert.equal(lose(), false, "it is asked to come back");
    card.lost = false;
    await clock.pass(apart);
    assert.equal(lose(), apart < 60_000);
    assert.deepEqual([said.at(-1), live.draws(knobs({}))], [last, false]);
  }
});

test("a slow card draws fewer pixels, and a fast one all", () => {
  assert.ok(Math.abs(smallerShare(1, 30) - Math.sqrt(20 / 30)) < 1e-9);
  assert.equal(largerShare(1, { low: 6, high: 8 }), 1);
  assert.equal(largerShare(0.25, { low: 0, high: 2 }), 0.5);
  assert.ok(Math.abs(largerShare(0.5, { low: 8, high: 10 }) - 0.5 * Math.SQRT2) < 1e-9);
  assert.equal(largerShare(0.5, { low: 18, high: 20 }), 0.5, "what is hardly larger is not worth another size");
  assert.equal(largerShare(0.5, { low: 16, high: 20 }), 0.55, "unless that may fit");
});

test("a card of 30 pictures a second keeps 60 % of the width", () => {
  for (const ms of [40, 60, 90]) assert.equal(smallerShare(1, ms), Math.max(Math.sqrt(20 / ms), 0.6));
  assert.ok(smallerShare(1, 400) < 0.6);
  assert.ok(smallerShare(0.2, 1e6) >= 0.2);
});
