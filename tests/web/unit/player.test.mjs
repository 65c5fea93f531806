import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import { Shown } from "../../../web/isogi_web/net/shown.js";
import { Player } from "../../../web/isogi_web/live/player.js";
import { FakeClock, knobs } from "./fixtures.mjs";

const STEPS = 3;
let clock, shown, view, button;

/** A view whose controls ask for its pictures. */
class FakeView {
  values = knobs({ time: 1 });
  #listeners = [];
  subscribe = (listener) => this.#listeners.push(listener);

  set(change) {
    this.values = { ...this.values, ...change };
    this.#listeners.forEach((each) => each(this.values));
    shown.ask(this.values);
  }
}

/** A button that keeps its attributes. */
class FakeButton extends EventTarget {
  #attributes = {};
  textContent = "Play";
  getAttribute = (name) => this.#attributes[name] ?? null;
  setAttribute = (name, text) => { this.#attributes[name] = text; };
  click = () => this.dispatchEvent(new Event("click"));
}

beforeEach(() => {
  [clock, view, button] = [new FakeClock(), new FakeView(), new FakeButton()];
  shown = new Shown(view.values, ({ time, azimuth }) => `${time} ${azimuth}`, clock);
  new Player(button, { volume: { times: STEPS } }, view, shown, clock);
  see();
});

/** The picture that is asked for comes. */
const see = () => shown.show({ of: shown.asked, draft: true, sharp: false, facts: null });
const plays = () => button.getAttribute("aria-pressed") === "true";

test("the steps come in turn, and begin again after the last", async () => {
  button.click();
  const seen = [view.values.time];
  for (let n = 0; n < 4; n += 1) {
    see();
    await clock.pass(500);
    seen.push(view.values.time);
  }
  assert.deepEqual(seen, [2, 0, 1, 2, 0]);
  assert.deepEqual([button.textContent, plays()], ["Pause", true]);
});

test("a step whose volume is late is waited for, and none is skipped", async () => {
  button.click();
  await clock.pass(9000);
  assert.equal(view.values.time, 2);
  see();
  assert.equal(view.values.time, 0);
});

test("a step that comes quickly stays for its time", async () => {
  button.click();
  see();
  await clock.pass(499);
  see();
  assert.equal(view.values.time, 2);
  await clock.pass(1);
  assert.equal(view.values.time, 0);
});

test("it pauses by its button, and goes on from there", async () => {
  button.click();
  button.click();
  see();
  await clock.pass(9000);
  assert.deepEqual([view.values.time, button.textContent, plays()], [2, "Play", false]);
  button.click();
  assert.equal(view.values.time, 0);
});

test("a step that is chosen pauses it, and a turn of the camera does not", () => {
  button.click();
  view.set({ azimuth: 40 });
  assert.equal(plays(), true);
  view.set({ time: 1 });
  assert.equal(plays(), false);
});
