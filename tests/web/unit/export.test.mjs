import assert from "node:assert/strict";
import { test } from "node:test";
import { beginExport, readJob, stopJob } from "../../../web/isogi_web/net/api.js";
import { CompilingLine, compilingWords, progressWords } from "../../../web/isogi_web/net/compiling.js";
import { exportQuery, jobInWords } from "../../../web/isogi_web/net/export.js";
import { frameQuery } from "../../../web/isogi_web/net/request.js";
import { Bridge } from "../../../web/isogi_web/notebook/bridge.js";
import { keyframe, keyframeInWords, parseViews, viewsFile } from "../../../web/isogi_web/panels/views.js";
import { SCENE, knobs } from "./fixtures.mjs";

const QUERY = frameQuery(SCENE, knobs({ isovalue: 71.5, yaw: 40, exposure: 3, environment: "studio" }), { width: 9, height: 8 });

test("an export reads isovalue and light, and no camera", () => {
  assert.deepEqual(exportQuery(QUERY), { isovalue: 71.5, yaw: 40, pitch: 0, roll: 0, exposure: 3, environment: "studio" });
});

test("an export is begun, followed and stopped", async () => {
  globalThis.document = { baseURI: "http://host/prefix/" };
  const asked = [];
  globalThis.fetch = async (address, options) => {
    asked.push([String(address), options?.method]);
    return new Response(JSON.stringify({ jobID: "7", status: "running" }), { status: 200 });
  };
  const address = await beginExport("a b", { f: "glb", yaw: 40 });
  assert.equal((await readJob(address)).status, "running");
  await stopJob(address);
  assert.deepEqual(asked, [
    ["http://host/prefix/v1/scenes/a%20b/export?f=glb&yaw=40", "POST"],
    ["http://host/prefix/v1/jobs/7", undefined],
    ["http://host/prefix/v1/jobs/7", "DELETE"],
  ]);
});

test("a job says how far it is", () => {
  const left = { low: 10, likely: 20, high: 40 };
  assert.equal(jobInWords({ progress: 40, message: "Baking.", time_left: left }), "40 %, about 20 s left. Baking.");
  assert.equal(jobInWords({ progress: 1, message: "Looking.", time_left: null }), "1 %. Looking.");
});

test("keyframes have all of a view but what a film has once", () => {
  const view = keyframe(QUERY);
  assert.equal(keyframeInWords(view), "71.5, azimuth 30°, elevation 20°");
  for (const name of ["width", "height", "overlay", "f"]) assert.ok(!(name in view), name);
  assert.deepEqual(JSON.parse(viewsFile([{ address: "?", view }])), { views: [view] });
});

test("what was kept by another page is no reason to fail", () => {
  const good = { address: "?isovalue=3", view: { isovalue: 3 } };
  assert.deepEqual(parseViews(JSON.stringify([good, 7, null, { address: "?" }])), [good]);
  for (const text of [null, "", "{", "{}", "7"]) assert.deepEqual(parseViews(text), []);
});

test("what is compiled is said with its count and the time left, once it is known", () => {
  assert.equal(compilingWords({ done: 0, total: 24, seconds: undefined }, false), "Compiling, once on this machine: 0 of 24");
  assert.equal(compilingWords({ done: 7, total: 24, seconds: 39.6 }, false), "Compiling, once on this machine: 7 of 24, about 40 s left");
  assert.match(compilingWords({ done: 7, total: 24, seconds: 0.2 }, true), /^Light comes when isogi is compiled, .* about 1 s left$/);
  assert.match(compilingWords({ done: 7, total: 24, seconds: 130 }, true), /about 2 min left$/);
});

test("what is compiled is named", () => {
  assert.equal(progressWords("Compiling what draws it", { done: 1, total: 2 }), "Compiling what draws it, once on this machine: 1 of 2");
});

test("the line is shown while the server compiles, and no longer", async () => {
  const parts = { span: { textContent: "" }, progress: { value: 0 } };
  const root = { hidden: true, querySelector: (/** @type {"span"|"progress"} */ name) => parts[name] };
  for (const name of ["HTMLElement", "HTMLProgressElement"]) globalThis[name] ??= /** @type {any} */ (Object);
  const answers = [null, { ready: false, compiling: { done: 6, total: 24, seconds: 40 } }, { ready: true, compiling: { done: 18, total: 24, seconds: 9 } }, { ready: true, compiling: null }];
  const line = new CompilingLine(/** @type {any} */ (root), async () => /** @type {any} */ (answers.shift()), /** @type {any} */ ({ after: (_, run) => run() }));
  assert.equal(await line.look(), false);
  assert.equal(root.hidden, true);
  assert.equal(await line.look(), true);
  assert.equal(line.shown, true);
  assert.equal(parts.progress.value, 0.25);
  await line.watch();
  assert.equal(root.hidden, true);
  assert.match(parts.span.textContent, /18 of 24, about 9 s left/);
});

/** A widget's model, and what was sent to its kernel. */
function model() {
  const sent = [], listeners = new Set();
  return {
    sent,
    send: (message) => sent.push(message),
    on: (_, listener) => listeners.add(listener),
    off: (_, listener) => listeners.delete(listener),
    answer: (message, ...buffers) => listeners.forEach((each) => each(message, buffers)),
  };
}

const view = (text) => new DataView(new TextEncoder().encode(`--${text}`).buffer, 2);

test("answers of the kernel reach whoever asked for them", async () => {
  const kernel = model(), { source } = new Bridge(kernel);
  const chunks = source.chunks({ isovalue: 70, cut: "x>4" }), light = source.blocks("light", ["0.0.1-ab", "0.0.2-cd"], {});
  assert.deepEqual(kernel.sent.map(({ path }) => path), ["card/chunks?isovalue=70&cut=x%3E4", "card/light/0.0.1-ab,0.0.2-cd?"]);
  kernel.answer({ number: 7 }, view("of another page"));
  kernel.answer({ number: kernel.sent[1].number }, view("bytes"));
  kernel.answer({ number: kernel.sent[0].number }, view('{"chunks": [1]}'));
  assert.deepEqual(await chunks, [1]);
  assert.equal(new TextDecoder().decode(await light), "bytes");
});

test("what the server refuses is trouble with its reason", async () => {
  const kernel = model(), { source } = new Bridge(kernel);
  const asked = source.bytes("card/volume/0-1");
  kernel.answer({ number: kernel.sent[0].number, status: 403, detail: "Voxels are kept." });
  await assert.rejects(asked, { message: "Voxels are kept.", status: 403, retry: false });
});
