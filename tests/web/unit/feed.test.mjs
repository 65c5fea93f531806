import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import { Feed } from "../../../web/isogi_web/live/feed.js";
import { fromAngles } from "../../../web/isogi_web/view/rotation.js";
import { FakeClock, knobs, settled } from "./fixtures.mjs";

const STRAIGHT = { yaw: 0, pitch: 0, roll: 0 };
const TURNED = { yaw: 30, pitch: 0, roll: 0 };
const chunk = (at, values = {}) => ({ at, version: "a1", final: true, ...values });

let asked; // requests that wait for their answers
let card;
let clock;
let feed;
let lit;

/** A card that notes what it takes, by what: an answer is `{what, chunks}`. */
class FakeCard {
  folded = new Map(); // name of a chunk to the turn that it was folded by
  raw = new Set();
  lacking(chunks, turn) {
    const names = chunks.map(({ at, version }) => `${at}-${version}`), key = String(turn);
    return {
      light: names.filter((name) => !this.folded.has(name) || (this.folded.get(name) !== key && !this.raw.has(name))),
      transfer: names.filter((name) => this.folded.has(name) && !this.raw.has(name)),
    };
  }
  take({ what, chunks }, turn) {
    for (const name of chunks) what === "light" ? this.folded.set(name, String(turn)) : this.raw.add(name);
  }
}

/** Answer the oldest request, with what it asks for or something else. */
async function answer(values = {}) {
  const { what, chunks, resolve } = asked.shift();
  resolve({ what, chunks, ...values });
  await settled();
}

beforeEach(() => {
  [asked, card, clock, lit] = [[], new FakeCard(), new FakeClock(), 0];
  const ask = (what, chunks, turn) => new Promise((resolve, reject) => asked.push({ what, chunks, turn, resolve, reject }));
  feed = new Feed(card, ask, STRAIGHT, () => { lit += 1; }, clock);
});

test("the most visible chunks come first, a few together", async () => {
  const chunks = Array.from({ length: 40 }, (_, i) => chunk(`0.0.${i}`));
  feed.bring(chunks, knobs(), false);
  const sizes = [];
  while (asked.length) {
    assert.equal(asked[0].chunks[0], `0.0.${sizes.reduce((sum, size) => sum + size, 0)}-a1`);
    sizes.push(asked[0].chunks.length);
    await answer();
  }
  assert.deepEqual([sizes, lit], [[16, 24], 2]);
});

test("what the card has is not asked for again", async () => {
  feed.bring([chunk("0.0.1")], knobs(), false);
  await answer();
  feed.bring([chunk("0.0.1"), chunk("0.0.2")], knobs(), false);
  assert.deepEqual(asked.map(({ chunks }) => chunks), [["0.0.2-a1"]]);
});

test("a chunk that grew on its way is asked for once a list", async () => {
  feed.bring([chunk("0.0.1")], knobs(), false);
  await answer({ chunks: ["0.0.1-b2"] });
  assert.deepEqual(asked, []);
  feed.bring([chunk("0.0.1", { version: "c3" })], knobs(), false);
  assert.deepEqual(asked.map(({ chunks }) => chunks), [["0.0.1-c3"]]);
});

test("light that converges is brought ever more rarely, and when it is final", async () => {
  const brought = [];
  for (let i = 0; i < 32; i++) {
    feed.bring([chunk("0.0.1", { version: `a${i}`, final: false })], knobs(), false);
    await settled();
    if (asked.length) {
      brought.push(i / 2);
      await answer();
    }
    await clock.pass(500);
  }
  assert.deepEqual(brought, [0, 2, 6, 14], "seconds");
  feed.bring([chunk("0.0.1", { version: "z9" })], knobs(), true);
  assert.deepEqual(asked.map(({ chunks }) => chunks), [["0.0.1-z9"]]);
});

test("light that converges is brought at once at rest on another isovalue", async () => {
  const chunks = (version) => [chunk("0.0.1", { version, final: false })];
  feed.bring(chunks("a1"), knobs({ isovalue: 70 }), false);
  await answer();
  for (const isovalue of [71, 72]) {
    feed.bring(chunks(`m${isovalue}`), knobs({ isovalue }), true);
    await settled();
  }
  assert.deepEqual(asked, [], "while it slides, the light that is here is shown");
  feed.bring(chunks("b2"), knobs({ isovalue: 72 }), false);
  assert.deepEqual(asked.map(({ chunks: names }) => names), [["0.0.1-b2"]]);
  await answer();
  feed.bring(chunks("c3"), knobs({ isovalue: 72 }), false);
  assert.deepEqual(asked, [], "then more rarely again");
});

test("an answer that comes late defers no light of the isovalue at rest", async () => {
  feed.bring([chunk("0.0.1", { version: "a1", final: false })], knobs({ isovalue: 71 }), true);
  feed.bring([chunk("0.0.1", { version: "b2", final: false })], knobs({ isovalue: 72 }), false);
  await answer();
  assert.deepEqual(asked.map(({ chunks: names }) => names), [["0.0.1-b2"]]);
});

test("the newest list counts", async () => {
  feed.bring([chunk("0.0.1")], knobs(), true);
  feed.bring([chunk("0.0.2")], knobs(), true);
  feed.bring([chunk("0.0.3")], knobs(), true);
  await answer();
  assert.deepEqual(asked.map(({ chunks }) => chunks), [["0.0.3-a1"]]);
});

test("transfer is asked for once the light is turned", async () => {
  feed.bring([chunk("0.0.1")], knobs(), false);
  await answer();
  assert.deepEqual(asked, []);
  feed.bring([chunk("0.0.1")], knobs(TURNED), true);
  assert.deepEqual(asked.map(({ what, chunks }) => [what, chunks]), [["transfer", ["0.0.1-a1"]]]);
  await answer();
  feed.bring([chunk("0.0.1")], knobs({ yaw: 50 }), false);
  assert.deepEqual(asked, []);
});

test("new chunks are folded as the others are, while the light turns", async () => {
  feed.bring([chunk("0.0.1")], knobs(), false);
  await answer();
  feed.bring([chunk("0.0.1"), chunk("0.0.2")], knobs(TURNED), true);
  assert.deepEqual(asked.map(({ what, chunks, turn }) => [what, chunks, turn]), [["light", ["0.0.2-a1"], STRAIGHT]]);
});

test("light that converges is folded once more at rest, not raw", async () => {
  const chunks = [chunk("0.0.1", { final: false }), chunk("0.0.2")];
  feed.bring(chunks, knobs(), false);
  await answer();
  feed.bring(chunks, knobs(TURNED), true);
  assert.deepEqual(asked.map(({ what, chunks: names }) => [what, names]), [["transfer", ["0.0.2-a1"]]]);
  await answer();
  feed.bring(chunks, knobs(TURNED), false);
  assert.deepEqual(asked.map(({ what, chunks: names, turn }) => [what, names, turn]), [["light", ["0.0.1-a1"], TURNED]]);
  await answer();
  assert.equal(card.folded.get("0.0.1-a1"), String(fromAngles(TURNED)));
  assert.deepEqual(asked, []);
});

test("a request that fails is asked again with the next list", async () => {
  const failing = feed.bring([chunk("0.0.1")], knobs(), false);
  asked.shift().reject(new Error("away"));
  await assert.rejects(failing, /away/);
  feed.bring([chunk("0.0.1")], knobs(), false);
  assert.equal(asked.length, 1);
});

test("what comes for a scene that is left is not taken", async () => {
  feed.bring([chunk("0.0.1"), chunk("0.0.2")], knobs(), false);
  feed.close();
  await answer();
  assert.deepEqual([card.folded.size, lit, asked], [0, 0, []]);
});
