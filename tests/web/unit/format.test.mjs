import assert from "node:assert/strict";
import { test } from "node:test";
import {
  errorInWords, frameInWords, leftInWords, millisecondsInWords, niceStep, rangeInWords, shadingName, shareInWords,
  showNumber, timeInWords,
} from "../../../web/view/format.js";
import { facts } from "./fixtures.mjs";

test("a step is 1, 2 or 5 times a power of ten", () => {
  for (const [span, step] of [[500, 1], [501, 2], [1000, 2], [1250, 5], [3000, 10], [0.5, 0.001], [5e-7, 1e-9]]) {
    assert.ok(Math.abs(niceStep(span) / step - 1) < 1e-12, `${span}: ${niceStep(span)}`);
  }
});

test("a step cuts a span into no more parts than asked for", () => {
  for (let span = 0.013; span < 1e5; span *= 1.7) {
    for (const parts of [5, 100, 500]) assert.ok(span / niceStep(span, parts) <= parts * 1.0011);
  }
});

test("a number has the digits that its step can tell apart", () => {
  assert.equal(showNumber(127.5, 0.5), "127.5");
  assert.equal(showNumber(1234.56789, 1), "1234.57");
  assert.equal(showNumber(0.1 + 0.2, 0.001), "0.3");
  assert.equal(showNumber(1.5e-7, 1e-9), "1.5e-7");
  assert.equal(showNumber(1e-12, 0.1), "0");
});

test("a share is rounded down, so that 100 % means all", () => {
  assert.deepEqual([0, 0.6099, 0.29, 0.99999, 1].map(shareInWords), ["0 %", "60 %", "29 %", "99 %", "100 %"]);
});

test("an error has two digits", () => {
  assert.deepEqual([0.0342, 0.5, 0, 0.000456, 1].map(errorInWords), ["3.4 %", "50 %", "0 %", "0.046 %", "100 %"]);
});

test("a time is in the unit that a person would use", () => {
  const times = [0.44, 1, 41.4, 119, 120, 3600, 7199, 7200];
  assert.deepEqual(times.map(timeInWords), ["0.4 s", "1 s", "41 s", "119 s", "2 min", "60 min", "120 min", "2 h"]);
});

test("milliseconds below ten have one decimal", () => {
  assert.deepEqual([3.44, 9.94, 10, 120.6].map(millisecondsInWords), ["3.4 ms", "9.9 ms", "10 ms", "121 ms"]);
});

test("time left is never less than a second", () => {
  assert.equal(leftInWords({ likely: 0.2 }), "about 1 s left");
});

test("time left has its range, where that is one", () => {
  assert.equal(rangeInWords({ low: 12, likely: 20, high: 41 }), "about 20 s left (12 s to 41 s)");
  assert.equal(rangeInWords({ low: 0.1, likely: 0.2, high: 0.4 }), "about 1 s left");
});

test("a frame says how good it is, and how long is left", () => {
  const left = { low: 12, likely: 40, high: 60 };
  assert.equal(frameInWords(facts({ error: 0.018, timeLeft: left })), "Refining, about 1.8 % error, about 40 s left");
  assert.equal(frameInWords(facts({ error: 0.018, controls: 256 })), "Refining, 1.8 % error");
  assert.equal(frameInWords(facts({ error: 1, timeLeft: left })), "Preview, about 40 s left", "an error of all the light says nothing");
});

test("a finished frame says its error, if there is any", () => {
  assert.equal(frameInWords(facts({ provisional: false })), "Done, about 3.4 % error");
  assert.equal(frameInWords(facts({ provisional: false, controls: 256 })), "Done, 3.4 % error");
  assert.equal(frameInWords(facts({ provisional: false, error: NaN })), "Done");
});

test("a finished frame without a surface says so", () => {
  const coverage = { final: 0, converging: 0, provisional: 0 };
  assert.equal(frameInWords(facts({ provisional: false, error: 0, coverage })), "Done, no surface in view");
});

test("an unknown shading is called by its id", () => {
  assert.deepEqual(["gi", "new_one"].map(shadingName), ["Global illumination", "new_one"]);
});
