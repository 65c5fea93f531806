import assert from "node:assert/strict";
import { test } from "node:test";
import { Bridge } from "../../../web/notebook/bridge.js";

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
