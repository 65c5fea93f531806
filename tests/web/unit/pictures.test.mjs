import assert from "node:assert/strict";
import { test } from "node:test";
import zlib from "node:zlib";
import { withNotes } from "../../../web/isogi_web/net/bytes.js";
import { MirrorBall, ballPixels, noteOf } from "../../../web/isogi_web/panels/light.js";
import { emptyInWords, errorInWords, frameInWords, leftAfter, leftInWords, millisecondsInWords, niceStep, rangeInWords, shadingName, shareInWords, showNumber, timeInWords } from "../../../web/isogi_web/view/format.js";
import { SCENE, facts, knobs } from "./fixtures.mjs";

const SIZE = 64;
const STILL = { azimuth: 0, elevation: 0, yaw: 0, pitch: 0, roll: 0 };

/** A PNG of one grey pixel. */
function png() {
  const chunk = (type, data) => {
    const body = Buffer.concat([Buffer.from(type), data]);
    const [length, check] = [Buffer.alloc(4), Buffer.alloc(4)];
    length.writeUInt32BE(data.length);
    check.writeUInt32BE(crc(body));
    return Buffer.concat([length, body, check]);
  };
  const header = Buffer.from([0, 0, 0, 1, 0, 0, 0, 1, 8, 0, 0, 0, 0]);
  const signature = Buffer.from([0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a]);
  return Buffer.concat([signature, chunk("IHDR", header), chunk("IDAT", zlib.deflateSync(Buffer.from([0, 128]))), chunk("IEND", Buffer.alloc(0))]);
}

/** CRC-32, as zlib writes it at the end of a gzip file: after that, the length. */
function crc(bytes) {
  return zlib.gzipSync(bytes).subarray(-8).readUInt32LE();
}

/** The chunks of a PNG: type, data, and whether the checksum is right. */
function chunksOf(bytes) {
  const chunks = [];
  for (let at = 8; at < bytes.length;) {
    const length = bytes.readUInt32BE(at);
    const body = bytes.subarray(at + 4, at + 8 + length);
    const right = crc(body) === bytes.readUInt32BE(at + 8 + length);
    chunks.push({ type: body.toString("latin1", 0, 4), text: body.toString("latin1", 4), right });
    at += length + 12;
  }
  return chunks;
}

test("notes are chunks with checksums, behind the header", async () => {
  const noted = await withNotes(new Blob([png()], { type: "image/png" }), { Title: "Grüße × 3", Software: "isogi" });
  const chunks = chunksOf(Buffer.from(await noted.arrayBuffer()));
  assert.deepEqual(chunks.map(({ type }) => type), ["IHDR", "tEXt", "tEXt", "IDAT", "IEND"]);
  assert.deepEqual(chunks.slice(1, 3).map(({ text }) => text), ["Title\0Grüße × 3", "Software\0isogi"]);
  assert.ok(chunks.every(({ right }) => right));
  assert.equal(noted.type, "image/png");
});

test("without notes a picture stays what it is", async () => {
  const noted = await withNotes(new Blob([png()]), {});
  assert.deepEqual(Buffer.from(await noted.arrayBuffer()), png());
});

test("a mirror ball reflects by twice the angle of its normal", () => {
  const edge = Math.SQRT1_2; // a normal 45° from the eye reflects to the side
  const pixels = ballPixels(SIZE);
  const at = (right, up) => {
    const [column, row] = [Math.round(((right + 1) * SIZE - 1) / 2), Math.round(((1 - up) * SIZE - 1) / 2)];
    return pixels.find(({ place }) => place === 4 * (row * SIZE + column)).ray;
  };
  const near = (ray, wanted) => ray.slice(0, 3).forEach((x, i) => assert.ok(Math.abs(x - wanted[i]) < 3 / SIZE, `[${ray}] is not [${wanted}]`));
  near(at(0, 0), [0, 0, 1]);
  near(at(edge, 0), [1, 0, 0]);
  near(at(0, -edge), [0, -1, 0]);
});

test("a mirror ball covers pi quarters of its square", () => {
  const cover = ballPixels(SIZE).reduce((sum, pixel) => sum + pixel.cover, 0);
  assert.ok(Math.abs(cover / SIZE ** 2 - Math.PI / 4) < 2e-3);
});

test("all rays of the ball are unit vectors", () => {
  for (const { ray: [x, y, z], cover } of ballPixels(SIZE)) if (cover === 1) assert.ok(Math.abs(Math.hypot(x, y, z) - 1) < 1e-12);
});

/** The ball's picture under a light whose pixels are a function of azimuth and elevation, in degrees. */
function painted(light, values) {
  const [width, height] = [360, 180];
  const data = new Uint8ClampedArray(4 * width * height);
  for (let row = 0; row < height; row++) {
    for (let column = 0; column < width; column++) data[4 * (row * width + column)] = light(column + 0.5, 89.5 - row);
  }
  let picture;
  const paint = {
    createImageData: (w, h) => ({ data: new Uint8ClampedArray(4 * w * h), width: w, height: h }),
    putImageData: (image) => { picture = image; },
  };
  new MirrorBall(paint, SIZE, { data, width, height }).draw(values);
  return (right, up) => picture.data[4 * (Math.floor(((1 - up) / 2) * SIZE) * SIZE + Math.floor(((right + 1) / 2) * SIZE))];
}

/** Red on the half of the sky around an azimuth. */
const around = (centre) => (azimuth) => (Math.cos(((azimuth - centre) * Math.PI) / 180) > 0 ? 200 : 0);

test("the middle of the ball mirrors what is behind the eye", () => {
  for (const azimuth of [0, 90, 200]) {
    assert.ok(painted(around(azimuth), { ...STILL, azimuth })(0, 0) > 190);
    assert.equal(painted(around(azimuth + 180), { ...STILL, azimuth })(0, 0), 0);
  }
});

test("the right of the ball mirrors what is to the right", () => {
  const ball = painted(around(90), STILL); // from +x, the right is +y
  assert.ok(ball(0.7, 0) > 100);
  assert.equal(ball(-0.7, 0), 0);
});

test("the top of the ball mirrors the sky's zenith", () => {
  const ball = painted((_, elevation) => (elevation > 45 ? 200 : 0), STILL);
  assert.ok(ball(0, 0.7) > 100);
  assert.equal(ball(0, -0.7), 0);
});

test("a light turned by its yaw is mirrored where it went", () => {
  const ball = painted(around(0), { ...STILL, yaw: 90 });
  assert.ok(ball(0.7, 0) > 100);
  assert.equal(ball(-0.7, 0), 0);
});

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

test("a time left passes, and then doubles", () => {
  const left = { low: 5, likely: 10, high: 20 };
  assert.equal(leftAfter(null, 5), null);
  assert.deepEqual(leftAfter(left, 4), { low: 3, likely: 6, high: 12, overdue: false });
  assert.deepEqual(leftAfter(left, 10), { low: 10, likely: 20, high: 40, overdue: true });
  assert.deepEqual(leftAfter(left, 25), { low: 2.5, likely: 5, high: 10, overdue: true });
  assert.deepEqual(leftAfter({ ...left, overdue: true }, 4), { low: 3, likely: 6, high: 12, overdue: true });
  assert.equal(leftInWords(leftAfter(left, 12)), "longer than expected, about 18 s left");
  assert.equal(rangeInWords(leftAfter(left, 10)), "longer than expected, about 20 s left (10 s to 40 s)");
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

test("a frame without a surface says so, whatever its error", () => {
  const empty = facts({ provisional: false, error: 0.022, surface: 0, coverage: { final: 1, converging: 0, provisional: 0 } });
  assert.equal(frameInWords(empty), "No surface in view");
  assert.equal(frameInWords(empty, { empty: "No surface at 255: values go from 0 to 255" }), "No surface at 255: values go from 0 to 255");
});

test("a view without a surface says why", () => {
  const said = (values, volume = SCENE.volume) => emptyInWords({ volume }, knobs(values));
  assert.equal(said({ isovalue: 255 }), "No surface at 255: values go from 0 to 255");
  assert.equal(said({ isovalue: 1 }, { ...SCENE.volume, value_range: [1.66e-11, 1] }), "No surface at 1: values go from 0 to 1");
  assert.equal(said({ isovalue: 70 }, { ...SCENE.volume, value_range: [5, 5] }), "No surface: all values are 5");
  assert.equal(said({ isovalue: 70, planes: "x>0" }), "No surface at 70 in what the cut leaves: show all of it, or change either");
  assert.match(said({ isovalue: 70 }), /^No surface at 70 in view: reset/);
});

test("a frame below its target says why it is not done", () => {
  const said = (values) => frameInWords(facts({ error: 0.018, controls: 256, interval: [0.015, 0.019], ...values }), { target: 0.02 });
  assert.equal(said({ interval: [0.015, 0.023] }), "Refining, 1.8 % error, between 1.5 % and 2.3 %");
  assert.equal(said({ p99: 0.12 }), "Refining, 1.8 % error, 1 % of pixels off by more than 12 %");
  assert.equal(said({}), "Refining, 1.8 % error, not all of its light is there yet");
  assert.equal(said({ controls: 0, interval: null }), "Refining, about 1.8 % error, not measured yet");
  assert.deepEqual([said({ error: 0.021 }), said({ provisional: false })], ["Refining, 2.1 % error", "Done, 1.8 % error"]);
});

test("an unknown shading is called by its id", () => {
  assert.deepEqual(["gi", "new_one"].map(shadingName), ["Global illumination", "new_one"]);
});

test("the page says how the light turns", () => {
  assert.equal(noteOf({ turns: true, rotating: true, turn_step: null }), "");
  assert.match(noteOf({ turns: true, rotating: true, turn_step: 5 }), /in steps of 5°: each is baked/);
  assert.match(noteOf({ turns: false, rotating: true, turn_step: null }), /the same from all sides/);
  assert.match(noteOf({ turns: false, rotating: false, turn_step: null }), /is fixed/);
});
