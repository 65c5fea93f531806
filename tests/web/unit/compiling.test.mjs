import assert from "node:assert/strict";
import { test } from "node:test";

import { CompilingLine, compilingWords, progressWords } from "../../../web/net/compiling.js";

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
