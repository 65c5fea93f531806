import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import { Shown } from "../../../web/isogi_web/net/shown.js";
import { FakeClock, facts, knobs } from "./fixtures.mjs";

const [A, B] = [knobs({ azimuth: 10 }), knobs({ azimuth: 20 })];
const FINAL = facts({ provisional: false });

let clock;
let shown;
let told;

/** A picture of a view that was asked for. */
const picture = (of, values = {}) => ({ of, draft: false, sharp: false, facts: facts(), ...values });

beforeEach(() => {
  [clock, told] = [new FakeClock(), 0];
  shown = new Shown(A, ({ azimuth, exposure }) => `${azimuth} ${exposure}`, clock);
  shown.subscribe(() => { told += 1; });
});

test("before the first picture nothing is said of one", () => {
  assert.deepEqual([shown.state, shown.facts, shown.leftAt, shown.waitsSince], ["loading", null, Infinity, 0]);
});

test("a full picture of the view is told by its facts", () => {
  shown.show(picture(shown.asked));
  assert.deepEqual([shown.state, shown.facts, shown.waitsSince], ["provisional", facts(), Infinity]);
  shown.show(picture(shown.asked, { facts: FINAL, sharp: true }));
  assert.deepEqual([shown.state, shown.sharp, shown.leftAt], ["final", true, Infinity]);
});

test("from the first change on nothing is said of the picture", async () => {
  shown.show(picture(shown.asked));
  await clock.pass(5000);
  assert.equal(shown.ask(B), true);
  assert.deepEqual([shown.facts, shown.state, shown.leftAt, shown.waitsSince], [null, "updating", 5000, 5000]);
  assert.equal(shown.values, A, "it is still the picture of the former");
  shown.move(true);
  assert.equal(shown.state, "moving");
});

test("the time left passes while nothing comes", async () => {
  shown.show(picture(shown.asked, { facts: facts({ timeLeft: { low: 5, likely: 10, high: 20 } }) }));
  await clock.pass(4000);
  assert.deepEqual(shown.left, { low: 3, likely: 6, high: 12, overdue: false });
  await clock.pass(8000);
  assert.deepEqual([shown.left.likely, shown.left.overdue], [18, true]);
  shown.ask(B);
  assert.equal(shown.left, null);
});

test("a draft is never told by its facts", () => {
  shown.move(true);
  shown.show(picture(shown.asked, { draft: true }));
  assert.deepEqual([shown.facts, shown.state, shown.leftAt], [null, "moving", Infinity]);
  shown.move(false);
  assert.equal(shown.state, "updating");
});

test("controls that change no picture leave it as it is", () => {
  shown.show(picture(shown.asked));
  const rulers = { ...A, rulers: "off" };
  assert.equal(shown.ask(rulers), false);
  assert.deepEqual([shown.state, shown.values, shown.asked.values], ["provisional", rulers, rulers]);
});

test("a picture counts as old from when its view was left", async () => {
  const first = shown.asked;
  await clock.pass(100);
  shown.ask(B);
  await clock.pass(900);
  shown.show(picture(first, { draft: true }));
  assert.equal(shown.leftAt, 100, "not from when it came");
});

test("back at the view of the picture all is said again", async () => {
  shown.show(picture(shown.asked, { facts: FINAL }));
  shown.ask(B);
  await clock.pass(1000);
  shown.ask({ ...A });
  assert.deepEqual([shown.state, shown.facts, shown.leftAt], ["final", FINAL, Infinity]);
  await clock.pass(1000);
  shown.ask(B);
  assert.equal(shown.leftAt, 2000);
});

test("a picture of the view is not replaced by another's", () => {
  const first = shown.asked;
  shown.ask(B);
  assert.equal(shown.surpasses(first), false, "there is none");
  shown.show(picture(first));
  assert.equal(shown.surpasses(shown.asked), false);
  shown.show(picture(shown.asked, { draft: true }));
  assert.deepEqual([shown.surpasses(first), shown.surpasses(shown.asked)], [true, false]);
});

test("a lost view is trouble until a picture comes", () => {
  shown.show(picture(shown.asked));
  shown.lose();
  assert.deepEqual([shown.state, shown.waitsSince], ["trouble", Infinity]);
  shown.ask(B);
  assert.deepEqual([shown.state, shown.facts], ["trouble", null]);
  shown.show(picture(shown.asked));
  assert.equal(shown.state, "provisional");
});

test("a page that is left shows nothing that was asked for", async () => {
  shown.show(picture(shown.asked, { facts: FINAL }));
  await clock.pass(700);
  shown.leave();
  assert.deepEqual([shown.state, shown.facts, shown.leftAt], ["updating", null, 700]);
  assert.equal(shown.ask(A), true, "a page that is come back to asks again");
});

test("every change is told", () => {
  const changes = [() => shown.ask(B), () => shown.move(true), () => shown.show(picture(shown.asked)), () => shown.lose(), () => shown.leave()];
  changes.forEach((change, k) => {
    change();
    assert.equal(told, k + 1);
  });
});

test("a predicted error is that of the view that the controls ask for", () => {
  assert.equal(shown.predicted, null);
  shown.cover({ of: shown.asked, predicted: 0.05 });
  assert.deepEqual([shown.predicted, shown.facts], [0.05, null]);
  shown.ask(B);
  assert.equal(shown.predicted, null);
  shown.show(picture(shown.asked));
  shown.uncover();
  assert.deepEqual([shown.predicted, shown.facts], [null, facts()], "the server's picture has an error that was measured");
});

test("a picture that shows shine by few rays is that of its view alone", () => {
  shown.cover({ of: shown.asked, predicted: null, shines: true });
  assert.deepEqual([shown.shines, shown.predicted], [true, null]);
  shown.ask(B);
  assert.equal(shown.shines, false);
  shown.cover({ of: shown.asked, predicted: 0.05, shines: false });
  assert.deepEqual([shown.shines, shown.predicted], [false, 0.05]);
});

test("what was measured of a picture is not said of the card's over it", () => {
  shown.show(picture(shown.asked, { facts: FINAL }));
  shown.ask(B);
  shown.cover({ of: shown.asked, predicted: null });
  shown.ask({ ...A });
  assert.deepEqual([shown.state, shown.facts], ["updating", null], "the card's is of another view");
  shown.cover({ of: shown.asked, predicted: null });
  assert.deepEqual([shown.state, shown.facts, shown.values.azimuth], ["updating", null, 10]);
  shown.uncover();
  assert.deepEqual([shown.state, shown.facts], ["final", FINAL]);
});

test("of a picture under the card's is said how far its light is", () => {
  shown.cover({ of: shown.asked, predicted: null });
  shown.show(picture(shown.asked));
  assert.deepEqual([shown.state, shown.facts], ["provisional", { ...facts(), error: NaN, p99: null, p99_interval: null }]);
  shown.move(true);
  assert.deepEqual([shown.state, shown.facts], ["moving", null]);
});

test("a picture that comes to light again is as old as it is", async () => {
  shown.show(picture(shown.asked));
  await clock.pass(100);
  shown.ask(B);
  shown.cover({ of: shown.asked, predicted: null });
  await clock.pass(900);
  shown.ask(knobs({ azimuth: 30 }));
  assert.equal(shown.leftAt, 1000);
  shown.uncover();
  assert.equal(shown.leftAt, 100, "not as the card's, which is gone");
});

test("while the server is away the page's pictures are told as its own", () => {
  shown.show(picture(shown.asked, { facts: FINAL }));
  shown.part(true);
  assert.equal(shown.state, "final", "what the server finished stays so");
  shown.ask(B);
  shown.cover({ of: shown.asked, predicted: 0.03 });
  assert.deepEqual([shown.state, shown.predicted, shown.waitsSince], ["away", 0.03, Infinity]);
  shown.part(false);
  assert.equal(shown.state, "updating");
});

test("a picture that the server was still refining is no longer told as refining", () => {
  shown.show(picture(shown.asked));
  shown.part(true);
  assert.equal(shown.state, "away");
  shown.lose();
  assert.equal(shown.state, "trouble", "what the card does not draw is lost");
  shown.part(true);
  assert.equal(shown.state, "away");
});
