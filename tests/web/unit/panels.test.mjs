import assert from "node:assert/strict";
import { test } from "node:test";
import { sizesFor } from "../../../web/isogi_web/net/save.js";
import { stripsOf, worstOf } from "../../../web/isogi_web/net/strips.js";
import { isProbe, nameOfAll, ofVolumes, tooLarge, volumeName } from "../../../web/isogi_web/net/upload.js";
import { exposureIn } from "../../../web/isogi_web/panels/environment.js";
import { errorAxis, timeAxis } from "../../../web/isogi_web/panels/chart.js";
import { dividerPlace } from "../../../web/isogi_web/panels/comparison.js";
import { History, courseInWords, legendShare, momentInWords, tailInWords } from "../../../web/isogi_web/panels/error.js";
import { axisOf, momentsOf, outline, percentileOf, solidSpan, stopsInWords, ticksAt, valueAt } from "../../../web/isogi_web/panels/histogram.js";
import { knobInWords, knobSpoken } from "../../../web/isogi_web/panels/knobs.js";
import { pointRows } from "../../../web/isogi_web/panels/point.js";
import { parseKept, scenePresets, toggled } from "../../../web/isogi_web/panels/presets.js";
import { layerInWords, planRows, savingInWords, volumeRows } from "../../../web/isogi_web/panels/scene.js";
import { announcement, badge, doneOf, predictedInWords } from "../../../web/isogi_web/panels/status.js";
import { rateOf, timeRows } from "../../../web/isogi_web/panels/times.js";
import { voxelsOf } from "../../../web/isogi_web/slices/values.js";
import { PAINTED, SCENE, facts } from "./fixtures.mjs";

const labels = ({ ticks }) => ticks.map(({ label }) => label);

test("a time axis ends at a tick no earlier than the time", () => {
  for (const seconds of [0, 0.3, 1, 7.7, 59, 119, 121, 3599, 1e5]) {
    const { end, ticks } = timeAxis(seconds);
    assert.ok(end >= seconds, String(seconds));
    assert.equal(ticks.at(-1).at, end);
    assert.ok(ticks.length >= 2 && ticks.length <= 7);
  }
});

test("a time axis has the unit that fits", () => {
  assert.deepEqual([119, 121, 7199, 7201].map((seconds) => timeAxis(seconds).unit), ["seconds", "minutes", "minutes", "hours"]);
  assert.deepEqual(labels(timeAxis(7.7)), ["0", "2", "4", "6", "8"]);
  assert.deepEqual(timeAxis(240).ticks.map(({ at }) => at), [0, 60, 120, 180, 240]);
});

test("an error axis holds all errors, with room below", () => {
  for (const errors of [[0.02], [1, 0.04, 0.02], [3e-7, 2e-6], [0.5, 0.5]]) {
    const { low, high } = errorAxis(errors);
    assert.ok(low <= 0.8 * Math.min(...errors) && high >= Math.max(...errors) * (1 - 1e-9), String(errors));
  }
});

test("an error axis has ticks at 1, 2 and 5, few enough to read", () => {
  assert.deepEqual(labels(errorAxis([0.04, 0.3])), ["2 %", "5 %", "10 %", "20 %", "50 %"]);
  assert.deepEqual(labels(errorAxis([0.0011, 0.9])), ["0.1 %", "1 %", "10 %", "100 %"]);
});

test("errors that are not above zero have no place on the axis", () => {
  assert.deepEqual(errorAxis([0, NaN, -1]), errorAxis([]));
  assert.deepEqual(errorAxis([0, 0.3]), errorAxis([0.3]));
});

test("a history counts seconds from the last change", () => {
  let now = 1000;
  const history = new History(() => now);
  now = 2500;
  history.add(facts());
  assert.equal(history.latest.seconds, 1.5);
  history.begin();
  assert.deepEqual([history.moments, history.latest], [[], undefined]);
});

test("a history ends with the first final frame", () => {
  const history = new History(() => 0);
  for (const provisional of [true, true, false, false, false]) history.add(facts({ provisional }));
  assert.equal(history.moments.length, 3);
});

test("a frame without an error is no moment", () => {
  const history = new History(() => 0);
  history.add(facts({ error: NaN }));
  assert.deepEqual(history.moments, []);
});

test("a long history keeps its first and its last moments", () => {
  let now = 0;
  const history = new History(() => now);
  for (let i = 0; i < 5000; i++) {
    now = 1000 * i;
    history.add(facts());
  }
  const { moments } = history;
  assert.ok(moments.length <= 600);
  assert.deepEqual([moments[0].seconds, moments.at(-1).seconds], [0, 4999]);
});

test("a moment says its time, and how long is left", () => {
  const left = { low: 12, likely: 20, high: 41 };
  const moment = { seconds: 3, error: 0.1, provisional: true };
  assert.equal(momentInWords(moment, left), "after 3 s · about 20 s left (12 s to 41 s)");
  assert.equal(momentInWords(moment, null), "after 3 s");
  assert.equal(momentInWords({ ...moment, provisional: false }, null), "done after 3 s");
  assert.equal(momentInWords({ ...moment, provisional: false, error: 0 }, null), "done after 3 s · nothing to estimate");
});

test("the worst pixels have a sentence with its interval", () => {
  const said = "1 % of pixels are off by more than 6.2 %";
  assert.equal(tailInWords({ p99: 0.0621, p99_interval: [0.051, 0.0794] }), `${said} (5.1 % to 7.9 %)`);
  assert.equal(tailInWords({ p99: 0.0621, p99_interval: [0.051, 1] }), `${said} (at least 5.1 %)`);
  assert.equal(tailInWords({ p99: null, p99_interval: null }), "");
});

test("the drawing has a sentence from the first to the last", () => {
  const moments = [
    { seconds: 1, error: 1, coverage: { final: 0 } }, { seconds: 41, error: 0.034, coverage: { final: 0.609 } },
  ];
  const words = courseInWords(moments, 0.02);
  assert.equal(words, "Estimated error from 100 % to 3.4 %, target 2 %; surface that is done from 0 % to 60 %; over 41 s");
  assert.ok(courseInWords([], 0.02).endsWith("nothing yet"));
});

test("what is not final is rounded up", () => {
  const coverage = { final: 0.609, converging: 0.391, provisional: 0 };
  assert.deepEqual(["final", "converging", "provisional"].map((state) => legendShare(state, coverage)), ["60 %", "40 %", "0 %"]);
});

test("a histogram is drawn by the logarithm of its counts", () => {
  const path = outline({ counts: [0, 9, 99], edges: [0, 1, 2, 3] }, 0, 3);
  const half = (100 * (1 - 0.94 / 2)).toFixed(1); // log 10 is half of log 100
  assert.equal(path, `M0 100L0.0 100.0L333.3 100.0L333.3 ${half}L666.7 ${half}L666.7 6.0L1000.0 6.0L1000 100Z`);
});

test("bars outside the slider's range do not flatten the rest", () => {
  const path = outline({ counts: [1e9, 9], edges: [0, 1, 2] }, 1, 2);
  assert.ok(path.endsWith("L0.0 6.0L1000.0 6.0L1000 100Z"), path);
});

test("percentiles and values are each other's inverse", () => {
  const histogram = { counts: [10, 0, 30, 60], edges: [0, 1, 2, 3, 5] };
  assert.equal(percentileOf(histogram, 1), 10);
  assert.equal(percentileOf(histogram, 1.5), 10);
  assert.equal(percentileOf(histogram, 4), 70);
  assert.equal(valueAt(histogram, 70), 4);
  for (const percent of [0.5, 10.5, 33, 99, 100])
    assert.ok(Math.abs(percentileOf(histogram, valueAt(histogram, percent)) - percent) < 1e-9);
  assert.equal(valueAt({ counts: [0, 0], edges: [1, 1, 1] }, 50), 1);
});

test("mean and deviation are those of even values", () => {
  const counts = Array(200).fill(5);
  const edges = Array.from({ length: 201 }, (_, i) => 10 + i / 20); // even from 10 to 20
  const { mean, deviation } = momentsOf({ counts, edges });
  assert.ok(Math.abs(mean - 15) < 1e-9);
  assert.ok(Math.abs(deviation - 10 / Math.sqrt(12)) < 1e-3);
});

test("a logarithmic axis gives each power of ten the same width", () => {
  const histogram = { counts: [5, 5, 5], edges: [0, 0.001, 0.1, 10], logarithmic: true };
  const axis = axisOf(histogram, 0, 10);
  assert.deepEqual([0, 0.001, 0.01, 0.1, 1, 10].map((value) => Math.round(1000 * axis.share(value))), [0, 0, 250, 500, 750, 1000]);
  assert.ok(Math.abs(axis.from(axis.to(0.03)) - 0.03) < 1e-12);
  assert.equal(axis.from(axis.to(0)), 0.001);
  assert.ok(outline(histogram, 0, 10, axis).includes("L500.0"));
  assert.ok(!axisOf({ ...histogram, logarithmic: false }, 0, 10).logarithmic);
});

test("a histogram of one value is still a path", () => {
  assert.ok(!outline({ counts: [0, 0], edges: [1, 1, 1] }, 1, 1).includes("NaN"));
});

test("the solid side is above the isovalue, or below", () => {
  assert.deepEqual(solidSpan(0.25, false), { x: 250, width: 750 });
  assert.deepEqual(solidSpan(0.25, true), { x: 0, width: 250 });
  assert.deepEqual(solidSpan(7, false), { x: 1000, width: 0 });
});

test("knobs have their units", () => {
  assert.equal(knobInWords("azimuth", -70.4, 1), "−70°");
  assert.equal(knobInWords("albedo", 0.7, 1), "0.70");
  assert.equal(knobInWords("distance", 3, 1), "3.00 radii");
});

test("another light is as many stops from its own exposure as the former was", () => {
  assert.equal(exposureIn(0.5, 2, 2, 2), 0.5, "the usual one stays the usual one");
  assert.equal(exposureIn(0.5, 4, 4, 2), 1, "one stop above");
  assert.equal(exposureIn(0.5, 3, 4, 2), 3, "chosen together with the light");
});

test("a light probe is told by its name", () => {
  assert.deepEqual(["a.hdr", "B.HDR", "a.nrrd", "hdr"].map(isProbe), [true, true, false, false]);
});

test("exposure is in stops from the scene's own", () => {
  assert.deepEqual([0.5, 1, 2, 8].map((exposure) => knobInWords("exposure", exposure, 2)), ["−2 stops", "−1 stop", "0 stops", "+2 stops"]);
});

test("ticks stand at the stops, as the isovalue does on the slider", () => {
  assert.equal(ticksAt([60, 140], 40, 240), "M100.0 0V100M500.0 0V100");
  assert.equal(ticksAt([], 40, 240), "", "without stops");
});

test("stops say where they are even", () => {
  const note = "In 7% of the range noise makes it even.";
  assert.match(stopsInWords(""), /equally far\.$/);
  assert.ok(stopsInWords(note).endsWith(` ${note}`));
  assert.equal(volumeRows({ ...SCENE, stops_note: note })["Stops of the isovalue"], stopsInWords(note));
  assert.equal(volumeRows({ ...SCENE, stops: [] })["Stops of the isovalue"], null);
});

test("presets begin with where the scene starts", () => {
  const shell = { name: "shell", isovalue: 90, suggested: false };
  assert.deepEqual(scenePresets({ ...SCENE, presets: [shell] }), [{ name: "start", isovalue: 70 }, shell]);
  const same = [{ name: "bone", isovalue: 70, suggested: false }];
  assert.equal(scenePresets({ ...SCENE, presets: same }), same, "unless one of them is that");
});

test("an isovalue is kept in order, and forgotten again", () => {
  const kept = toggled(toggled([], 100), 20);
  assert.deepEqual(kept, [20, 100]);
  assert.deepEqual(toggled(kept, 100), [20]);
});

test("what was kept without sense is passed over", () => {
  const texts = [null, '"x"', "{", '{"a":1}', '[null,7,"8",0.4]'];
  assert.deepEqual(texts.map((text) => parseKept(text, { min: 0.2, max: 0.8 })), [[], [], [], [], [0.4]]);
});

test("a layer says its order, channels and precision", () => {
  const layer = { kind: "direct", order: 5, channels: 3, precision: "float16", coarse: null, nodes: [] };
  assert.equal(layerInWords(layer), "SH order 5 in 3 channels, float16 floats");
  assert.equal(layerInWords({ ...layer, order: 1, channels: 1 }), "one number, float16 floats");
  assert.equal(layerInWords({ ...layer, coarse: 2, channels: 1 }), "SH order 5, half floats, bytes from band 2 on");
  assert.equal(layerInWords({ ...layer, nodes: [0, 0.456] }), "SH order 5 for albedo 0, 0.46, float16 floats");
});

test("savings are whole where they are large", () => {
  assert.equal(savingInWords({ amount: 27328.4, unit: "texels", measured: true }), "27\u202f328 texels (measured)");
  assert.equal(savingInWords({ amount: 0.98765, unit: "s", measured: false }), "0.988 s");
});

test("a plan says its texels, bytes, lobes and errors", () => {
  const plan = {
    representation: "transfer", layers: [], lobes: [{ azimuth: 135.4, elevation: 45, angle: 0.73 }], bytes_per_texel: 45,
    full_bytes_per_texel: 300, texels: { shown: 1234567, total: 2e6 }, bounces: 12, samples: 4096, errors: { harmonics: 0.01738 },
  };
  const rows = planRows({ plan, target_error: 0.02 });
  assert.equal(rows.Lobes, "0.73° across at azimuth 135°, elevation 45°");
  const street = planRows({ plan: { ...plan, lobes: Array(21).fill(plan.lobes[0]) }, target_error: 0.02 });
  assert.match(street.Lobes, /°; and 17 more$/);
  assert.equal(rows["Bytes per texel"], "45, instead of 300");
  assert.equal(rows["Texels shown"], "1\u202f234\u202f567 of 2\u202f000\u202f000");
  assert.equal(rows["Error of harmonics"], "1.74 %");
  assert.equal(rows["Final means"], "error below 2 %");
});

test("a volume says its size, its values and its holes", () => {
  const rows = volumeRows(SCENE);
  assert.deepEqual([rows.Size, rows.Spacing, rows.Values], ["11 × 21 × 31 voxels", "1 × 0.5 × 0.3333", "0 to 255, uint8"]);
  assert.deepEqual([rows["Not finite"], rows.Albedo, rows["Albedos to choose from"], rows.Lights], [null, "0.7", null, "sky"]);
  assert.equal(volumeRows({ ...SCENE, volume: { ...SCENE.volume, holes: 3 } })["Not finite"], "3 voxels, treated as empty");
  assert.equal(volumeRows(PAINTED)["Albedos to choose from"], "0 to 0.9");
  const coloured = volumeRows({ ...SCENE, colours: { name: "flow", map: "magma", low: 0, high: 9, colours: [], outside: "#808080", labels: [] } });
  assert.deepEqual([coloured.Albedo, coloured.Colours, coloured.Labels], [null, "magma of flow", null]);
  const labels = [{ value: 3, name: "liver", colour: "#b5523a", shown: true }, { value: 4, name: "skin", colour: "#ffffff", shown: false }];
  const parts = { name: "seg", map: "labels", low: 3, high: 3, colours: ["#b5523a"], outside: "#b5523a", labels };
  const labelled = volumeRows({ ...SCENE, colours: parts });
  assert.deepEqual([labelled.Colours, labelled.Labels], [null, "1 of 2 shown"]);
  const surfaces = [{ isovalue: 64, name: "skin", albedo: [0.8, 0.5, 0.4], clear: 0.6, transmission: [0, 0, 0] }, { isovalue: 0.5, name: "", albedo: [0, 0, 0], clear: 0, transmission: [0.4, 0.4, 0.4] }];
  const beside = [volumeRows({ ...SCENE, surfaces })["Other surfaces"], rows["Other surfaces"]];
  assert.deepEqual(beside, ["skin at 64, 60 % clear; 0.5, transmission 0.4", ""]);
  assert.deepEqual([rows.Transmission, volumeRows({ ...SCENE, transmission: [0.3, 0.2, 0] }).Transmission], [null, "0.3, 0.2, 0"]);
});

test("screen readers hear stops and degrees in words", () => {
  const [usual, twice, half, some] = [1, 2, 0.5, 2 ** 1.5].map((value) => knobSpoken("exposure", value, 1));
  assert.deepEqual([usual, twice, half, some], ["as the scene has it", "1 stop brighter", "1 stop darker", "1.5 stops brighter"]);
  assert.deepEqual(["azimuth", "yaw"].map((name) => knobSpoken(name, -40.2, 1)), ["minus 40 degrees", "minus 40 degrees"]);
  assert.deepEqual([knobSpoken("distance", 2.5, 1), knobInWords("exposure", 2, 1)], ["2.50 radii", "+1 stop"]);
});

test("the bar tells how much of the time is over", () => {
  const timeLeft = { low: 1, likely: 6, high: 9 };
  assert.equal(doneOf(facts({ timeLeft }), 2), 0.25);
  assert.equal(doneOf(facts({ timeLeft: null }), 2), 0);
  assert.equal(doneOf(facts({ provisional: false, timeLeft: null }), 2), 1);
});

test("screen readers hear of light everywhere, not of every frame", () => {
  const said = [0.9, 0.1, 0].map((provisional) => announcement(facts({ coverage: { final: 0, converging: 1 - provisional, provisional } })));
  assert.deepEqual(said, ["Refining, not lit everywhere yet", said[0], "Refining, lit everywhere"]);
  assert.equal(announcement(facts({ provisional: false })), "Done, about 3.4 % error");
});

test("a badge goes when the picture is within its target", () => {
  assert.equal(badge(facts(), 0.02), "Refining · 3.4 % error");
  assert.equal(badge(facts({ error: 1 }), 0.02), "Preview");
  assert.deepEqual([facts({ error: 0.019 }), facts({ provisional: false })].map((each) => badge(each, 0.02)), ["", ""]);
  assert.equal(badge(facts({ provisional: false, error: 0, surface: 0 }), 0.02), "No surface");
});

test("the rate of drafts is that of their intervals", () => {
  assert.deepEqual([rateOf([]), rateOf([5]), rateOf([0, 50, 100, 150, 200])], [0, 0, 20]);
});

test("stages have names, and their sum is the last but one", () => {
  const rows = timeRows({ shade: 1.25, new_stage: 20 }, 0);
  assert.deepEqual(rows, [["Shading", "1.3 ms"], ["new_stage", "20 ms"], ["All", "21 ms"], ["Drafts a second, last moved", "–"]]);
});

test("pictures are offered in the shape of the one shown", () => {
  const sizes = sizesFor({ width: 900, height: 600 });
  assert.deepEqual(sizes.map(({ width, height }) => [width, height]), [[900, 600], [1800, 1200], [1920, 1280], [3840, 2560], [7680, 5120]]);
  const [first, second] = sizesFor({ width: 2560, height: 1440 }, true);
  assert.deepEqual([first.width, first.name, second.width], [2560, "as seen, at once", 1920], "what is there comes first");
});

test("no picture longer than 8192 is offered", () => {
  assert.deepEqual(sizesFor({ width: 400, height: 1000 }).map(({ width }) => width), [400, 800, 1920]);
});

test("strips of a large picture cover it once, and overlap their neighbours", () => {
  assert.deepEqual(stripsOf({ width: 1920, height: 1200 }), [{ rows: [0, 1200], from: 0, to: 1200 }]);
  const strips = stripsOf({ width: 8192, height: 8192 });
  assert.equal(strips[0].from, 0);
  assert.equal(strips.at(-1)?.to, 8192);
  for (const [n, { rows: [first, last], from, to }] of strips.entries()) {
    assert.ok((last - first) * 8192 <= 1 << 23 && first <= from && last >= to);
    if (n > 0) assert.ok(strips[n - 1].to === from && first < from);
  }
});

test("a picture of strips is as good as its worst", () => {
  const [good, bad, worst] = [{ provisional: false, error: 0.01 }, { provisional: false, error: 0.02 }, { provisional: true, error: 0.001 }];
  assert.equal(worstOf(/** @type {any} */ ([good, bad])), bad);
  assert.equal(worstOf(/** @type {any} */ ([worst, good, bad])), worst);
});

test("files that are too large, or too many, are refused before they are sent", () => {
  const limits = { limit_bytes: 3 << 20, limit_files: 2 };
  const of = (...sizes) => tooLarge(sizes.map((size, n) => ({ name: `${"abc"[n]}.nrrd`, size })), limits);
  assert.equal(of(3 << 20), "");
  assert.equal(of((3 << 20) + 1), "a.nrrd is larger than the 3 MB that an upload may be.");
  assert.equal(of(2 << 20, 1 << 20), "");
  assert.equal(of(2 << 20, 2 << 20), "These 2 files are larger than the 3 MB that an upload may be, together.");
  assert.equal(of(1, 1, 1), "These are 3 files; an upload may have 2 at most.");
});

test("what systems leave in folders is not sent", () => {
  const paths = ["scan/b.dcm", "scan/.DS_Store", "DICOMDIR", "__MACOSX/scan/a.dcm", "scan/a", "Thumbs.db"].map((path) => ({ path }));
  assert.deepEqual(ofVolumes(paths).map(({ path }) => path), ["scan/a", "scan/b.dcm"]);
});

test("several files are called by their folder, or by their header", () => {
  const name = (...paths) => nameOfAll(paths.map((path) => ({ path })));
  assert.equal(name("scan/a", "scan/b"), "scan");
  assert.equal(name("a.raw", "b.nhdr"), "b.nhdr");
  assert.equal(name("a.dcm", "b.dcm"), "a.dcm");
});

test("a volume is named by its file without the ending", () => {
  assert.deepEqual(["My ball.nrrd", "a.NHDR", "a.nrrd.gz", "b\u0000\u200bc.nrrd"].map(volumeName), ["My ball", "a", "a.nrrd.gz", "bc"]);
  assert.equal(volumeName("x".repeat(200)).length, 80);
});

test("keys move the divider, and no further than its ends", () => {
  const place = (key, now, shiftKey = false) => dividerPlace({ key, shiftKey }, now);
  assert.deepEqual([place("ArrowRight", 50), place("ArrowLeft", 50, true), place("PageUp", 95), place("ArrowLeft", 1)], [52, 40, 100, 0]);
  assert.deepEqual([place("Home", 50), place("End", 50), place("x", 50)], [0, 100, null]);
});

const POINT = {
  unit: "mm", sides: "", position: [1.23456, -4.5, 10], voxel: [1.23456, 9, 30], value: 70, wall: null, normal: [0.6, -0.8, -0.001],
  light: [0.123456, 0.5, 1.25], displayed: "#abcdef", state: "final", error: 0.0123,
};

test("a point is told to a part of a voxel", () => {
  const rows = pointRows(SCENE, POINT);
  assert.equal(rows.Position, "1.235, −4.5, 10 mm", "the finest voxel is a third of a millimetre");
  const same = { ...POINT, position: [1, 2, 3], voxel: [1, 2, 3], unit: "" };
  assert.deepEqual([pointRows(SCENE, same).Position, pointRows(SCENE, same).Voxel], ["1, 2, 3", ""], "nothing is told twice");
  assert.deepEqual([rows.Voxel, rows.Value, rows.Wall], ["1.23, 9, 30", "70", ""]);
  assert.deepEqual([rows.Normal, rows.Light], ["0.60, −0.80, 0.00", "0.123, 0.5, 1.25 linear, #abcdef"]);
  assert.equal(pointRows(SCENE, { ...POINT, unit: "" }).Position, "1.235, −4.5, 10");
});

test("a point in a patient is told by sides", () => {
  assert.equal(pointRows(SCENE, { ...POINT, sides: "LAS" }).Position, "L 1.235 · A 4.5 · S 10 mm");
});

test("a point says how far its light is", () => {
  assert.equal(pointRows(SCENE, POINT).Error, "1.2 %");
  assert.equal(pointRows(SCENE, { ...POINT, state: "converging" }).Error, "1.2 %, being refined");
  assert.equal(pointRows(SCENE, { ...POINT, error: 0 }).Error, "", "without global illumination there is none");
  assert.equal(pointRows(SCENE, { ...POINT, state: "provisional", error: 1 }).Error, "not known yet");
  assert.deepEqual([pointRows(SCENE, { ...POINT, wall: 0, value: null })].map(({ Wall, Value }) => [Wall, Value]), [["1", ""]]);
});

test("an error that nobody measured is called predicted", () => {
  assert.equal(predictedInWords(0.0512), " · drawn here, about 5.1 % error (predicted)");
});

test("slices are read again of other voxels alone", () => {
  assert.equal(voxelsOf({ smooth: 0.5 }), "smooth=0.5");
  assert.equal(voxelsOf({ time: 3, smooth: 0 }), "time=3&smooth=0");
  assert.equal(voxelsOf({}), "");
});
