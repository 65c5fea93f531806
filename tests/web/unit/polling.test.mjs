import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import { FrameLoop } from "../../../web/isogi_web/net/loop.js";
import { Polling, refinementPause, untilFinal } from "../../../web/isogi_web/net/polling.js";
import { Streaming } from "../../../web/isogi_web/net/streaming.js";
import { Trouble, lost, troubleOf } from "../../../web/isogi_web/net/trouble.js";
import { FakeClock, facts, settled } from "./fixtures.mjs";

const PICTURE = new Blob(["a picture"]);
const VIEW = { query: { isovalue: 1 }, of: { key: "a" } };
const frame = (values = {}) => ({ blob: PICTURE, etag: '"a"', facts: facts(), of: VIEW.of, ...values });
const FINAL = frame({ etag: '"z"', facts: facts({ provisional: false }) });

let clock;
let frames; // what the page was given to show

/** A server whose requests are answered by hand: `requests` holds their options and signals. */
class Requests {
  requests = [];
  ask = (options, signal) => new Promise((resolve, reject) => this.requests.push({ options, signal, resolve, reject }));

  get last() {
    return this.requests.at(-1);
  }

  /** Answer the latest request after so long. */
  async answer(value, milliseconds = 0) {
    const { resolve, reject } = this.last;
    await clock.pass(milliseconds);
    if (value instanceof Error) reject(value);
    else resolve(value);
    await settled();
  }
}

/** What a page does with pictures: it notes them. */
function hooks() {
  const note = { shown: [], troubles: [], moving: [] };
  frames = note;
  return {
    frame: async (shown, draft) => { note.shown.push({ ...shown, draft }); },
    trouble: (error) => note.troubles.push(error),
    moving: (moving) => note.moving.push(moving),
  };
}

beforeEach(() => {
  clock = new FakeClock();
  globalThis.document = { hidden: false, addEventListener: () => {} };
  globalThis.window = { addEventListener: () => {} };
  globalThis.requestAnimationFrame = (run) => clock.after(16, run);
  globalThis.cancelAnimationFrame = clock.cancel;
});

test("a refinement waits as long as its frame took to draw", () => {
  assert.equal(refinementPause(400 + 350, 0), 350, "without the 400 ms that the server waited for light");
  assert.equal(refinementPause(5, 0), 60);
  assert.equal(refinementPause(1e6, 0), 2000);
});

test("a refinement waits longer while nothing is new", () => {
  assert.deepEqual([1, 5, 30].map((unchanged) => refinementPause(0, unchanged)), [100, 500, 2000]);
});

test("a view at rest is asked for in full, and then refined", async () => {
  const server = new Requests();
  new Polling(server.ask, hooks(), clock).show(false);
  assert.deepEqual(server.last.options, { draft: false, scale: 1, waitMs: 0, etag: null });
  await server.answer(frame(), 100);
  assert.deepEqual(clock.waits, [60]);
  await clock.pass(60);
  assert.deepEqual(server.last.options, { draft: false, scale: 1, waitMs: 400, etag: '"a"' });
});

test("a final picture is not asked for again", async () => {
  const server = new Requests();
  const polling = new Polling(server.ask, hooks(), clock);
  polling.show(false);
  await server.answer(FINAL);
  assert.deepEqual(clock.waits, []);
  polling.resume();
  assert.equal(server.requests.length, 1);
});

test("an unchanged picture keeps the facts of the last", async () => {
  const server = new Requests();
  new Polling(server.ask, hooks(), clock).show(false);
  await server.answer(frame());
  await clock.pass(60);
  await server.answer({ blob: null, etag: '"a"', facts: null, of: VIEW.of });
  assert.deepEqual(frames.shown.at(-1), { blob: null, facts: facts(), of: VIEW.of, draft: false });
  assert.deepEqual(clock.waits, [100]);
});

test("while a draft is drawn newer views wait, and the last wins", async () => {
  const server = new Requests();
  const polling = new Polling(server.ask, hooks(), clock);
  for (let i = 0; i < 5; i++) polling.show(true);
  assert.equal(server.requests.length, 1);
  await server.answer(frame(), 80);
  assert.equal(server.requests.length, 2);
  await server.answer(frame(), 80);
  assert.equal(server.requests.length, 2, "the view has not changed since");
});

test("drafts are a third as wide, however long they take", async () => {
  const server = new Requests();
  const polling = new Polling(server.ask, hooks(), clock);
  for (const elapsed of [20, 200, 400]) {
    polling.show(true);
    await server.answer(frame(), elapsed);
  }
  assert.deepEqual(server.requests.map(({ options }) => options.scale), [0.35, 0.35, 0.35]);
});

test("a view that comes to rest takes its draft's place", async () => {
  const server = new Requests();
  const polling = new Polling(server.ask, hooks(), clock);
  polling.show(true);
  const draft = server.last;
  polling.show(false);
  assert.ok(draft.signal.aborted);
  draft.resolve(frame());
  await settled();
  assert.deepEqual(frames.shown, [], "the draft is not shown");
});

test("failures are asked for again, later each time", async () => {
  const server = new Requests();
  new Polling(server.ask, hooks(), clock).show(false);
  const waits = [];
  for (let i = 0; i < 5; i++) {
    await server.answer(lost());
    waits.push(...clock.waits);
    await clock.pass(clock.waits[0]);
  }
  assert.deepEqual(waits, [500, 1000, 2000, 4000, 4000]);
  assert.equal(frames.troubles.length, 5);
  await server.answer(frame());
  await clock.pass(60);
  await server.answer(lost());
  assert.deepEqual(clock.waits, [500], "an answer ends the row");
});

test("a view that cannot be drawn is not asked for again", async () => {
  const server = new Requests();
  new Polling(server.ask, hooks(), clock).show(false);
  await server.answer(troubleOf({ status: 422, detail: "no" }));
  assert.deepEqual([clock.waits, frames.troubles[0].detail], [[], "no"]);
});

test("a page that is hidden asks no more until it is seen", async () => {
  const server = new Requests();
  const polling = new Polling(server.ask, hooks(), clock);
  polling.show(false);
  await server.answer(frame());
  document.hidden = true;
  await clock.pass(60);
  assert.equal(server.requests.length, 1);
  document.hidden = false;
  polling.resume();
  assert.equal(server.requests.length, 2);
});

test("a stop gives up the request and its retry", async () => {
  const server = new Requests();
  const polling = new Polling(server.ask, hooks(), clock);
  polling.show(false);
  polling.stop();
  assert.ok(server.last.signal.aborted);
  await server.answer(frame());
  assert.deepEqual([frames.shown, clock.waits], [[], []]);
});

/** All pictures of `untilFinal` while the server gives these answers, each after 10 ms; and the waits asked for. */
async function collect(answers, controller = new AbortController(), elapsed = 10) {
  const [pictures, waits, troubles] = [[], [], []];
  const ask = async (waitMs, etag) => {
    waits.push([waitMs, etag]);
    clock.time += elapsed;
    const answer = answers.shift();
    if (answer instanceof Error) throw answer;
    return answer;
  };
  const run = (async () => {
    for await (const picture of untilFinal(ask, controller.signal, (trouble) => troubles.push(trouble), clock)) pictures.push(picture);
  })();
  const end = run.then(() => "done", (error) => error);
  for (let i = 0; i < 20; i++) {
    await settled();
    await clock.pass(clock.waits[0] ?? 0);
  }
  return { pictures, waits, troubles, end: await Promise.race([end, "waiting"]) };
}

test("a picture is asked for until it is final", async () => {
  const { pictures, waits, end } = await collect([frame(), frame({ etag: '"b"' }), FINAL]);
  assert.deepEqual(waits, [[0, null], [3000, '"a"'], [3000, '"b"']]);
  assert.deepEqual([pictures.length, pictures.at(-1).facts.provisional, end], [3, false, "done"]);
});

test("four quick answers without news mean no more light", async () => {
  const same = { blob: null, etag: '"a"', facts: null };
  const { pictures, waits, end } = await collect([frame(), same, same, same, same, same]);
  assert.deepEqual([pictures.length, waits.length, end], [1, 5, "done"]);
});

test("a server that foresees an end is waited for, however quick its answers", async () => {
  const same = { blob: null, etag: '"a"', facts: facts({ timeLeft: { low: 1, likely: 2, high: 3 } }) };
  const { waits, end } = await collect([frame(), ...Array(6).fill(same), FINAL]);
  assert.deepEqual([waits.length, end], [8, "done"]);
});

test("answers that waited for light do not count as vain", async () => {
  const same = { blob: null, etag: '"a"', facts: null };
  const { waits, end } = await collect([frame(), ...Array(6).fill(same), FINAL], undefined, 2000);
  assert.deepEqual([waits.length, end], [8, "done"]);
});

test("a loss of the server is reported and outlived", async () => {
  const { pictures, troubles, end } = await collect([lost(), troubleOf({ status: 503 }, 2), FINAL]);
  assert.deepEqual([pictures.length, troubles.length, end, clock.time], [1, 2, "done", 30 + 500 + 2000]);
});

test("a refusal ends the search for a final picture", async () => {
  const refusal = troubleOf({ status: 422, detail: "no" });
  assert.equal((await collect([refusal])).end, refusal);
});

test("a search that is stopped ends while it waits", async () => {
  const controller = new AbortController();
  const ask = async () => { throw lost(); };
  const next = untilFinal(ask, controller.signal, () => {}, clock).next();
  await settled();
  assert.deepEqual(clock.waits, [500]);
  controller.abort(new Error("stopped"));
  await assert.rejects(next, /stopped/);
  assert.deepEqual(clock.waits, []);
});

/** A socket that notes what is sent. */
class FakeSocket {
  readyState = 0;
  sent = [];
  send = (text) => this.sent.push(JSON.parse(text));
  connect() {
    this.readyState = 1;
    this.onopen();
  }
  async picture(message) {
    this.onmessage({ data: JSON.stringify({ draft: false, media_type: "image/png", timing: {}, facts: { provisional: false, pixels: { surface: 7 }, time_left: null }, ...message }) });
    this.onmessage({ data: PICTURE });
    await settled();
  }
  close(code, reason = "") {
    this.readyState = 3;
    this.onclose({ code, reason });
  }
}

function streaming(view = () => VIEW, probe = null, refused = () => assert.fail("a stream can be had")) {
  const sockets = [];
  const open = () => (sockets.push(new FakeSocket()), sockets.at(-1));
  return { sockets, stream: new Streaming(open, view, hooks(), refused, clock, probe) };
}

/** A stream that is open and has sent its view. */
function connected(view, probe, refused) {
  const made = streaming(view, probe, refused);
  made.stream.show(false);
  made.sockets[0].connect();
  return made;
}

test("a stream sends the view once it is open", () => {
  const { sockets, stream } = streaming();
  stream.show(false);
  assert.deepEqual(sockets[0].sent, []);
  sockets[0].connect();
  assert.deepEqual(sockets[0].sent, [{ id: 1, view: { isovalue: 1 }, moving: false }]);
});

test("a moving view is sent once for each frame of the screen", async () => {
  const { sockets, stream } = connected();
  for (let i = 0; i < 10; i++) stream.show(true);
  await clock.pass(16);
  assert.deepEqual(sockets[0].sent.map(({ moving }) => moving), [false, true]);
});

test("a picture is shown, and acknowledged", async () => {
  const { sockets, stream } = connected();
  await sockets[0].picture({ id: 1 });
  assert.equal(frames.shown[0].draft, false);
  assert.deepEqual(sockets[0].sent.at(-1), { shown: 1, took: 0 });
});

test("a picture carries the view that it was asked for", async () => {
  let count = 0;
  const { sockets, stream } = connected(() => ({ query: {}, of: { key: `view ${++count}` } }));
  for (let i = 0; i < 3; i++) stream.show(false);
  for (const id of [1, 3, 3, 4]) await sockets[0].picture({ id });
  assert.deepEqual(frames.shown.map(({ of }) => of.key), ["view 1", "view 3", "view 3", "view 4"]);
});

test("a problem with an earlier view is none of the newest", async () => {
  const { sockets, stream } = connected();
  stream.show(false);
  const problem = { status: 422, detail: "out of range" };
  sockets[0].onmessage({ data: JSON.stringify({ id: 1, problem }) });
  assert.deepEqual(frames.troubles, []);
  sockets[0].onmessage({ data: JSON.stringify({ id: 2, problem }) });
  assert.equal(frames.troubles.length, 1);
});

test("a lost stream is opened again, later each time", async () => {
  const { sockets, stream } = connected();
  const waits = [];
  for (let i = 0; i < 3; i++) {
    sockets.at(-1).close(1006);
    waits.push(...clock.waits);
    await clock.pass(clock.waits[0]);
  }
  assert.deepEqual([waits, sockets.length, frames.troubles.length], [[300, 600, 1200], 4, 3]);
});

test("after two handshakes that fail the server is asked why by HTTP", async () => {
  const gone = new Trouble("The server has another scene", "no scene", { status: 404, retry: true });
  let asked = 0;
  const probe = async () => { asked += 1; throw gone; };
  const { sockets } = connected(undefined, probe);
  sockets[0].close(1006);
  const seen = [];
  for (let i = 0; i < 3; i++) {
    await clock.pass(clock.waits[0]);
    sockets.at(-1).close(1006);
    await settled();
    seen.push([asked, frames.troubles.at(-1) === gone]);
  }
  assert.deepEqual(seen, [[0, false], [1, true], [2, true]]);
  await clock.pass(clock.waits[0]);
  sockets.at(-1).connect();
  assert.deepEqual(sockets.at(-1).sent.length, 1, "it is back");
});

test("a server that answers by HTTP is tried once more, and then asked for single pictures", async () => {
  let refused = 0;
  const { sockets } = connected(undefined, async () => {}, () => { refused += 1; });
  sockets[0].close(1006);
  for (let i = 0; i < 2; i++) {
    await clock.pass(clock.waits[0]);
    sockets.at(-1).close(1006);
    await settled();
    if (i === 0) continue;
    assert.deepEqual([sockets.length, refused], [4, 0], "at once");
  }
  sockets.at(-1).close(1006);
  await settled();
  assert.equal(refused, 1);
});

test("a stream that was idle is opened by the next view alone", () => {
  const { sockets, stream } = connected();
  sockets[0].close(4000);
  assert.deepEqual([clock.waits, frames.troubles], [[], []]);
  stream.show(false);
  assert.equal(sockets.length, 2);
});

test("a stream that another client needs says so, and comes back", () => {
  const { sockets, stream } = connected();
  sockets[0].close(1013, "Another client needed this place.");
  assert.deepEqual([frames.troubles[0].detail, clock.waits], ["Another client needed this place.", [300]]);
});

test("a problem on the stream is reported", () => {
  const { sockets, stream } = connected();
  sockets[0].onmessage({ data: JSON.stringify({ problem: { status: 422, detail: "out of range" } }) });
  assert.deepEqual([frames.troubles[0].detail, clock.waits], ["out of range", []]);
});

test("where no stream can be had single requests take over", async () => {
  const server = new Requests();
  const open = () => { throw new ReferenceError("no sockets"); };
  const loop = new FrameLoop({ open, view: () => VIEW, ask: server.ask }, hooks(), clock);
  loop.settle();
  await server.answer(FINAL);
  assert.equal(frames.shown.length, 1);
});

test("a view rests 200 ms after its last change", async () => {
  const server = new Requests();
  const loop = new FrameLoop({ open: () => new FakeSocket(), view: () => VIEW, ask: server.ask }, hooks(), clock);
  loop.change();
  await clock.pass(150);
  loop.change();
  await clock.pass(199);
  assert.deepEqual(frames.moving, [true, true]);
  await clock.pass(1);
  assert.deepEqual(frames.moving, [true, true, false]);
});

test("a view that the page draws by itself is asked for at rest alone", async () => {
  const socket = new FakeSocket();
  const loop = new FrameLoop({ open: () => socket, view: () => ({ ...VIEW, chunks: true }), ask: () => assert.fail("there is a stream"), drafts: () => false }, hooks(), clock);
  loop.settle();
  socket.connect();
  for (let i = 0; i < 20; i++) {
    loop.change();
    await clock.pass(50);
  }
  await clock.pass(200);
  const [first, paused, last, ...others] = socket.sent;
  assert.deepEqual([first.moving, first.chunks, "pictures" in first], [false, true, false]);
  assert.deepEqual([paused.moving, paused.pictures], [true, false]);
  assert.deepEqual([last.moving, "pictures" in last, others], [false, false, []]);
});

test("drafts come from the server as soon as the page draws none", async () => {
  const socket = new FakeSocket();
  let own = true;
  const loop = new FrameLoop({ open: () => socket, view: () => VIEW, ask: () => assert.fail("there is a stream"), drafts: () => !own }, hooks(), clock);
  loop.settle();
  socket.connect();
  loop.change();
  own = false;
  loop.redraw();
  await clock.pass(16);
  assert.deepEqual(socket.sent.map(({ moving, pictures = true }) => [moving, pictures]), [[false, true], [true, false], [true, true]]);
});

test("without a stream no drafts are asked for either", async () => {
  const server = new Requests();
  const open = () => { throw new ReferenceError("no sockets"); };
  const loop = new FrameLoop({ open, view: () => VIEW, ask: server.ask, drafts: () => false }, hooks(), clock);
  loop.settle();
  assert.equal(server.requests.length, 1);
  loop.change();
  assert.equal(server.last.signal.aborted, true, "nor is the picture of the former view waited for");
  await clock.pass(150);
  loop.change();
  await clock.pass(250);
  assert.deepEqual(server.requests.map(({ options }) => options.draft), [false, false]);
});

test("the chunks that a picture reads come with it", async () => {
  const { sockets, stream } = connected(() => ({ ...VIEW, chunks: true }));
  const chunks = [{ at: "0.1.2", version: "a1", final: true }];
  await sockets[0].picture({ id: 1, chunks });
  assert.deepEqual(frames.shown[0].chunks, chunks);
});
