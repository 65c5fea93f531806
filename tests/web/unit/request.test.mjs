import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { test } from "node:test";
import { complaints, readAddress, writeAddress } from "../../../web/isogi_web/net/address.js";
import { deleteUpload, frameAddress, readFrame, readScene, readSurfacePoint, surfacePoint, wantsToken } from "../../../web/isogi_web/net/api.js";
import { changedParameters, curlLine, describe, fileName, nameOfFiles, frameQuery, pointQuery, pythonLine, sceneText } from "../../../web/isogi_web/net/request.js";
import { parsePairs, parseTiming, readFacts, streamedFrame } from "../../../web/isogi_web/net/schemas.js";
import { Trouble, retryDelay, troubleOf } from "../../../web/isogi_web/net/trouble.js";
import { ViewModel } from "../../../web/isogi_web/view/model.js";
import { PAINTED, POLISHED, SCENE, knobs } from "./fixtures.mjs";

globalThis.document = { baseURI: "http://host/behind/a/prefix/" };
const SIZE = { width: 600, height: 400 };

/** What the page asks for while the server gives these answers; a `status`, `headers` and `body` each. */
async function asking(answers, run) {
  const asked = [];
  const real = globalThis.fetch;
  globalThis.fetch = async (address, options = {}) => {
    asked.push({ address: String(address), ...options });
    const answer = answers.shift();
    if (answer instanceof Error) throw answer;
    return new Response(answer.body ?? null, { status: 200, ...answer });
  };
  try {
    return { asked, result: await run().then((value) => ({ value }), (error) => ({ error })) };
  } finally {
    globalThis.fetch = real;
  }
}

test("an address that was written reads back as the same view", () => {
  const start = { isovalue: 0.1 + 0.2 + 99, azimuth: -70.5, distance: 2.345, target: [1, 2.5, 3], shading: "phong", overlay: "error", compare: "gi" };
  const view = new ViewModel(SCENE, start);
  const read = readAddress(writeAddress(SCENE, view.values));
  assert.equal(read.scene, "small");
  assert.deepEqual(new ViewModel(SCENE, read.start).values, view.values);
});

test("an address holds no choice that is none", () => {
  const query = new URLSearchParams(writeAddress(SCENE, knobs()));
  for (const name of ["overlay", "compare", "target", "tint", "albedo"]) assert.ok(!query.has(name), name);
});

test("an address holds a tint that is not the scene's", () => {
  const { values } = new ViewModel(PAINTED, { tint: "#ff0000" });
  assert.equal(new URLSearchParams(writeAddress(PAINTED, values)).get("tint"), "#ff0000");
  assert.ok(!writeAddress(PAINTED, { ...values, tint: "#ffffff" }).includes("tint"));
});

test("what is no number in an address is left out", () => {
  const { scene, start } = readAddress("?isovalue=&azimuth=abc&pitch=1e999&fov=%2040%20&target=4,x,6");
  assert.equal(scene, null);
  assert.deepEqual(start, { fov: 40, target: [4, NaN, 6] });
  assert.equal(new ViewModel(SCENE, start).values.target, null);
});

test("a link says what of it cannot be shown", () => {
  assert.deepEqual(complaints("?scene=small&isovalue=70&azimuth=5&shading=gi&compare=&target=1,2,3&overlay=none", SCENE), []);
  assert.deepEqual(complaints("?scene=brain&isovalue=9999&pitch=abc&shading=none&fov=&colour=red", SCENE), [
    "There is no scene “brain”: this is Small.", "No surface at 9999: this scene shows 40 to 240.",
    "“abc” is no number for pitch.", "There is no shading “none”.", "“” is no number for fov.",
    "The link says colour, which this page does not know.",
  ]);
  const whole = { ...SCENE, ranges: { isovalue: { min: 0, max: 255 } } };
  assert.deepEqual(complaints("?isovalue=9999", whole), ["No surface at 9999: values go from 0 to 255."]);
});

test("a frame is asked for by all knobs and its size", () => {
  const query = frameQuery(SCENE, knobs({ target: [1, 2, 3] }), SIZE);
  assert.deepEqual(query, {
    isovalue: 70, azimuth: 30, elevation: 20, distance: 3, fov: 30, yaw: 0, pitch: 0, roll: 0,
    target: "1,2,3", ...SIZE, shading: "gi", overlay: "none", background: "dark", f: "png",
  });
});

test("a link is short, and shows what the scene starts with exactly", () => {
  const digits = (text) => text.replace(/\D/g, "").replace(/^0+/, "").length;
  for (const [isovalue, min, max] of [[1136.4285714285713, -1024, 3071], [0.20312500000000003, 0, 0.8], [1.5000000000000003e-7, 0, 2e-6]]) {
    const scene = { ...SCENE, defaults: { ...SCENE.defaults, isovalue, exposure: 2.295855113204665 }, ranges: { ...SCENE.ranges, isovalue: { min, max } } };
    const { values } = new ViewModel(scene), link = writeAddress(scene, values);
    assert.ok(!link.includes("exposure"), link);
    assert.ok([...new URLSearchParams(link).values()].every((text) => digits(text) <= 6), link);
    assert.deepEqual(new ViewModel(scene, readAddress(link).start).values, values);
    const other = new ViewModel(scene, { ...readAddress(link).start, exposure: 2.2958551 * 2 });
    assert.equal(new URLSearchParams(writeAddress(scene, other.values)).get("exposure"), "4.592");
  }
});

test("an isovalue that is typed keeps its digits in a link", () => {
  const { values } = new ViewModel(SCENE, { isovalue: 70.123456 });
  assert.equal(new URLSearchParams(writeAddress(SCENE, values)).get("isovalue"), "70.123456");
});

test("the light's own exposure is left to the server, another is asked for", () => {
  assert.ok(!("exposure" in frameQuery(SCENE, knobs({ environment: "studio" }), SIZE)));
  assert.equal(frameQuery(SCENE, knobs({ environment: "studio", exposure: 2 }), SIZE).exposure, 2);
});

test("an environment is part of the request and of the address", () => {
  const lit = { ...SCENE, environments: [{ id: "studio", name: "Studio", href: null }] };
  assert.equal(frameQuery(lit, knobs({ environment: "studio" }), SIZE).environment, "studio");
  assert.ok(!("environment" in frameQuery(lit, knobs({ environment: "" }), SIZE)));
  const address = writeAddress(lit, knobs({ environment: "studio" }));
  assert.equal(readAddress(address).start.environment, "studio");
  assert.deepEqual(complaints(address, lit), []);
  assert.deepEqual(complaints("?environment=moon", lit), ["There is no light “moon” here."]);
});

test("a light that cannot be turned is no part of a request", () => {
  const query = frameQuery({ ...SCENE, turns: false }, knobs({ yaw: 40 }), SIZE);
  assert.ok(!["yaw", "pitch", "roll"].some((name) => name in query));
});

test("a light that is baked for each turn is asked for in steps", () => {
  const baked = { ...SCENE, turn_step: 5 };
  const angles = ({ yaw, pitch, roll }) => [yaw, pitch, roll];
  assert.deepEqual(angles(frameQuery(baked, knobs({ yaw: 41.9, pitch: -2.4, roll: 3 }), SIZE)), [40, 0, 5]);
  assert.deepEqual(angles(frameQuery(baked, knobs({ yaw: 320 }), SIZE)), [-40, 0, 0]);
  assert.deepEqual(angles(frameQuery(SCENE, knobs({ yaw: 41.9 }), SIZE)), [41.9, 0, 0]);
  assert.ok(!("yaw" in frameQuery({ ...baked, turns: false }, knobs({ yaw: 41.9 }), SIZE)));
});

test("an albedo is asked for only where the view changed it", () => {
  const view = new ViewModel(PAINTED);
  assert.ok(!("albedo" in frameQuery(PAINTED, view.values, SIZE)));
  view.set({ albedo: 0.25 });
  assert.equal(frameQuery(PAINTED, view.values, SIZE).albedo, 0.25);
});

test("a picture's words say the isovalue, the side and the shading", () => {
  const words = describe(SCENE, knobs({ isovalue: 70.123456789, azimuth: 29.6 }));
  assert.equal(words, "Isosurface of Small at 70.1234568, seen from azimuth 30°, elevation 20°; Global illumination");
});

test("a file is named by its scene and isovalue", () => {
  assert.equal(fileName(SCENE, { isovalue: 0.1 + 0.2 }), "small-0.3");
});

test("a line holds what differs from the defaults", () => {
  const query = frameQuery(SCENE, knobs({ azimuth: -70.5, overlay: "error", background: "light" }), { width: 512, height: 400 });
  const changed = { isovalue: 70, azimuth: -70.5, height: 400, overlay: "error" };
  assert.deepEqual(changedParameters(SCENE, query), changed);
  assert.deepEqual(changedParameters(SCENE, { ...query, background: "dark" }), { ...changed, background: "dark" });
});

test("a shell line names the token's variable where one is wanted", () => {
  const address = new URL("http://host/v1/frame?a=1&b=2");
  assert.equal(curlLine(address, "small-0.3.png", false), "curl -f 'http://host/v1/frame?a=1&b=2' -o small-0.3.png");
  assert.ok(curlLine(address, "x.png", true).includes('-H "Authorization: Bearer $ISOGI_TOKEN"'));
});

for (const file of ["it's.png", "a b;$(touch x).png", "`id`.png", '"; rm -r x #.png']) {
  test(`the name ${file} does not escape its quotes`, () => {
    const line = curlLine(new URL("http://host/?a=1&b=2"), file, false).replace("curl -f", "printf '%s\\n'");
    const words = execFileSync("sh", ["-c", line], { encoding: "utf8" }).trimEnd().split("\n");
    assert.deepEqual(words, ["http://host/?a=1&b=2", "-o", file]);
    const python = pythonLine("http://host", file, { isovalue: 1e-7, shading: file }, file);
    const text = JSON.stringify(file);
    assert.ok(python.endsWith(`frame(${text}, isovalue=1e-7, shading=${text}, wait="final").save(${text})`));
  });
}

test("an address of a frame keeps the prefix of the page", () => {
  const address = frameAddress("a/b", { isovalue: 1, target: "1,2,3" });
  assert.equal(address.href, "http://host/behind/a/prefix/v1/scenes/a%2Fb/frame?isovalue=1&target=1%2C2%2C3");
});

test("shares in a header are read as numbers", () => {
  assert.deepEqual(parsePairs("final=0.81, converging=0.12,provisional=0.07"), { final: 0.81, converging: 0.12, provisional: 0.07 });
  assert.deepEqual(parsePairs(null), {});
  assert.deepEqual(parsePairs("final=, =3, x"), { "": 3 });
});

test("stages in a header are read without their total", () => {
  assert.deepEqual(parseTiming("primary;dur=3.5, shade;dur=0, total;dur=9, cache"), { primary: 3.5, shade: 0 });
});

test("a frame's facts are read from its headers", () => {
  const headers = new Headers({
    "Isogi-Provisional": "?1", "Isogi-Coverage": "final=0.5, converging=0.5", "Isogi-Chunks": "needed=4, final=3", "Isogi-Surface": "1200",
    "Isogi-Error": "0.018; noise=0.006; low=0.015; high=0.021; controls=256; p99=0.062; p99-low=0.051; p99-high=0.079", "Isogi-Time-Left": "low=1, likely=2, high=3", "Server-Timing": "shade;dur=2",
  });
  assert.deepEqual(readFacts(headers), {
    provisional: true, coverage: { final: 0.5, converging: 0.5, provisional: 0 }, surface: 1200, error: 0.018, interval: [0.015, 0.021], controls: 256, p99: 0.062, p99_interval: [0.051, 0.079],
    chunks: { needed: 4, final: 3 }, timeLeft: { low: 1, likely: 2, high: 3, overdue: false }, timing: { shade: 2 },
  });
  headers.set("Isogi-Overdue", "?1");
  assert.equal(readFacts(headers).timeLeft.overdue, true);
});

test("an answer without facts has none, and no error is NaN", () => {
  assert.equal(readFacts(new Headers()), null);
  const { error, controls, p99, p99_interval: ends, timeLeft } = readFacts(new Headers({ "Isogi-Provisional": "?0" }));
  assert.deepEqual([error, controls, p99, ends, timeLeft], [NaN, 0, null, null, null]);
});

test("a streamed picture has its type and its facts", async () => {
  const message = { media_type: "image/png", timing: { shade: 2 }, facts: { provisional: false, pixels: { surface: 7 }, time_left: null } };
  const { blob, facts } = streamedFrame(message, new Blob(["abc"]));
  assert.deepEqual([blob.type, await blob.text()], ["image/png", "abc"]);
  assert.deepEqual(facts, { provisional: false, surface: 7, timeLeft: null, timing: { shade: 2 } });
});

test("a position is read from the last pixel of an npy frame", () => {
  const frame = new ArrayBuffer(128 + 36);
  const pixel = new DataView(frame, 128);
  [0.1, 0.2, 0.3, 1, 3, 0, 1.5, 2.5, 3.5].forEach((x, i) => pixel.setFloat32(4 * i, x, true));
  assert.deepEqual(surfacePoint(frame), [1.5, 2.5, 3.5]);
  pixel.setFloat32(12, 0, true);
  assert.equal(surfacePoint(frame), null);
});

test("an unchanged frame has no picture and keeps its etag", async () => {
  const { asked, result } = await asking([{ status: 304 }], () => readFrame("small", { f: "png" }, { etag: '"a"' }));
  assert.deepEqual(asked[0].headers, { "If-None-Match": '"a"' });
  assert.deepEqual(result.value, { blob: null, etag: '"a"', facts: null });
});

test("a refusal is a trouble with the server's own sentence", async () => {
  const body = JSON.stringify({ detail: "albedo must be at most 0.9" });
  const { result } = await asking([{ status: 422, body }], () => readScene("small", { width: 4, height: 3 }));
  assert.ok(result.error instanceof Trouble);
  assert.deepEqual([result.error.detail, result.error.retry], ["albedo must be at most 0.9", false]);
});

test("a busy server says when to ask again", async () => {
  const { result } = await asking([{ status: 503, headers: { "Retry-After": "7" } }], () => readScene("small", { width: 4, height: 3 }));
  assert.deepEqual([result.error.retry, result.error.after, result.error.status], [true, 7, 503]);
});

test("no answer can be asked for again, an abort stays an abort", async () => {
  const { result: gone } = await asking([new TypeError("failed to fetch")], () => readScene("small", { width: 4, height: 3 }));
  assert.deepEqual([gone.error.title, gone.error.retry], ["The server does not answer", true]);
  const abort = new DOMException("stopped", "AbortError");
  const { result: stopped } = await asking([abort], () => readScene("small", { width: 4, height: 3 }));
  assert.equal(stopped.error, abort);
});

test("a volume is deleted below the prefix of the page", async () => {
  const { asked } = await asking([{ status: 204 }], () => deleteUpload("/v1/volumes/7"));
  assert.deepEqual([asked[0].method, asked[0].address], ["DELETE", "http://host/behind/a/prefix/v1/volumes/7"]);
});

test("a token is wanted where answers are private", async () => {
  for (const [cache, wanted] of [["private, no-cache", true], ["no-cache", false]]) {
    const { result } = await asking([{ headers: { "Cache-Control": cache } }], wantsToken);
    assert.equal(result.value, wanted);
  }
});

test("only failures of the server can be asked for again", () => {
  assert.deepEqual([400, 404, 422, 429, 500, 503].map((status) => troubleOf({ status }).retry), [false, false, false, true, true, true]);
  assert.equal(troubleOf({ status: 500, detail: { no: "text" } }).detail, "It answered with status 500.");
});

test("the server's own wait goes before the page's", () => {
  assert.equal(retryDelay(troubleOf({ status: 429 }, 7), 0, [300]), 7000);
});

test("what cannot be cured is not asked for again", () => {
  assert.equal(retryDelay(troubleOf({ status: 422 }, 7), 0, [300]), null);
  assert.equal(retryDelay(new TypeError("a mistake of the page"), 0, [300]), null);
});

test("shine is part of requests and addresses where the scene shines", () => {
  const view = new ViewModel(POLISHED);
  assert.equal(view.values.shine, "plastic");
  view.set({ shine: "metal", roughness: 0.05, strength: 7 });
  const query = frameQuery(POLISHED, view.values, SIZE);
  assert.deepEqual([query.shine, query.roughness, query.strength], ["metal", 0.05, 1], "limits are the scene's");
  view.set({ shine: "glass" });
  assert.equal(view.values.shine, "metal", "what no scene offers is left as it is");
  const { start } = readAddress(writeAddress(POLISHED, view.values));
  assert.deepEqual([start.shine, start.roughness], ["metal", 0.05]);
  const dull = new ViewModel(SCENE, { shine: "metal", roughness: 0.5 });
  for (const name of ["shine", "roughness", "strength"]) assert.ok(!(name in frameQuery(SCENE, dull.values, SIZE)), name);
});

test("glow is part of requests and addresses where something glows", () => {
  const glowing = { ...SCENE, defaults: { ...SCENE.defaults, glow: 1 }, ranges: { ...SCENE.ranges, glow: { min: 0, max: 16 } } };
  const view = new ViewModel(glowing);
  assert.equal(view.values.glow, 1);
  view.set({ glow: 2.5 });
  assert.equal(frameQuery(glowing, view.values, SIZE).glow, 2.5);
  assert.equal(readAddress(writeAddress(glowing, view.values)).start.glow, 2.5);
  assert.ok(!("glow" in frameQuery(SCENE, new ViewModel(SCENE, { glow: 3 }).values, SIZE)));
});

test("a point is asked for by pixels of the same picture", () => {
  const { overlay, background, f, ...view } = frameQuery(SCENE, knobs({ overlay: "error" }), SIZE);
  assert.deepEqual(pointQuery({ ...view, overlay, background, f }, 0.25, -0.1), { ...view, x: 400, y: 240 });
  assert.deepEqual(pointQuery({ ...view, overlay, background, f }, -1, -0.5), { ...view, x: 0, y: 399.5 }, "no pixel is outside");
});

test("the projection is asked for where it is not the scene's own", () => {
  const flat = { ...SCENE, defaults: { ...SCENE.defaults, projection: "orthographic" } };
  const parallel = knobs({ projection: "orthographic" });
  assert.equal(frameQuery(SCENE, parallel, SIZE).projection, "orthographic");
  assert.ok(!("projection" in frameQuery(SCENE, knobs(), SIZE)) && !("projection" in frameQuery(flat, parallel, SIZE)));
  assert.equal(frameQuery(flat, knobs(), SIZE).projection, "perspective");
  assert.equal(new ViewModel(flat).values.projection, "orthographic");
  assert.equal(new ViewModel(flat, readAddress(writeAddress(flat, knobs())).start).values.projection, "perspective");
});

test("a scene is fitted for the isovalue and the projection of the link", async () => {
  const answers = () => [{ body: JSON.stringify(SCENE) }, { body: "{}" }];
  const { asked } = await asking(answers(), () => readScene("small", { width: 4, height: 3 }, { isovalue: 99, projection: "orthographic" }));
  assert.match(asked[1].address, /fit\?width=4&height=3&isovalue=99&projection=orthographic$/);
  const { asked: odd } = await asking(answers(), () => readScene("small", { width: 4, height: 3 }, { isovalue: 999, projection: "fisheye" }));
  assert.match(odd[1].address, /fit\?width=4&height=3$/);
});

test("the surface at a place is met by one ray, wherever the view has it", async () => {
  const pixel = new Uint8Array(new Float32Array([0, 0, 0, 1, 3, 0, 1, 2, 3]).buffer);
  const { asked, result } = await asking([{ body: pixel }], () => readSurfacePoint(SCENE, knobs({ isovalue: 99 }), 0.1, -0.2));
  assert.deepEqual(result.value, [1, 2, 3]);
  const query = new URL(asked[0].address).searchParams;
  assert.deepEqual([...query.keys()].sort(), ["eye", "f", "height", "isovalue", "shading", "target", "up", "width"]);
  assert.deepEqual([query.get("isovalue"), query.get("width"), query.get("f")], ["99", "1", "npy"]);
  const { result: lost } = await asking([{ status: 422, body: "{}" }], () => readSurfacePoint(SCENE, knobs(), 0, 0));
  assert.equal(lost.value, null, "the picture's own requests say what is wrong");
});

test("a click is answered also where the server is busy", async () => {
  const pixel = new Uint8Array(new Float32Array([0, 0, 0, 1, 3, 0, 1, 2, 3]).buffer);
  const busy = { status: 503, body: "{}" };
  const { asked, result } = await asking([busy, new TypeError("away"), { body: pixel }], () => readSurfacePoint(SCENE, knobs(), 0, 0));
  assert.deepEqual([result.value, asked.length], [[1, 2, 3], 3]);
});

test("an address may say who draws", () => {
  assert.deepEqual(["?draw=card", "?draw=server", "?draw=me", ""].map((search) => readAddress(search).draw), ["card", "server", null, null]);
  assert.deepEqual(complaints("?draw=me", SCENE), ["“me” draws nothing here: choose card or server."]);
  assert.deepEqual(complaints("?draw=card", SCENE), []);
});

test("links and files of an upload have its name", () => {
  const upload = { ...SCENE, id: "0123456789abcdef0123456789abcdef", name: "My skull (CT), ä/1.nii" };
  assert.deepEqual([nameOfFiles(SCENE), nameOfFiles(upload)], ["small", "My-skull-CT-ä-1.nii"]);
  assert.equal(fileName(upload, { isovalue: 70 }), "My-skull-CT-ä-1.nii-70");
  assert.equal(nameOfFiles({ ...upload, name: "../.." }), upload.id);
  const query = writeAddress(upload, knobs());
  assert.deepEqual([new URLSearchParams(query).get("name"), new URLSearchParams(writeAddress(SCENE, knobs())).get("name")], [upload.name, null]);
  assert.deepEqual(complaints(query, SCENE), ["There is no scene “My skull (CT), ä/1.nii”: this is Small."]);
  assert.deepEqual(complaints(query, upload), []);
});

test("a view is lines of a scene file", () => {
  const query = {
    isovalue: 70.5, azimuth: 35, elevation: -18, distance: 2.6, fov: 30, exposure: 6, target: "1,-2.5,3",
    environment: "gallery", cut: "z>12", material: "glass,index=1.3,absorption=0.1,0.2,0.3",
    width: 9, height: 9, shading: "gi", overlay: "none", background: "dark", f: "png",
  };
  assert.deepEqual(sceneText(query).split("\n"), [
    "isovalue = 70.5", 'environment = "gallery"', 'cut = "z>12"',
    'material = "glass"', "index = 1.3", "absorption = [0.1, 0.2, 0.3]",
    "[view]", "azimuth = 35", "elevation = -18", "distance = 2.6", "target = [1, -2.5, 3]", "fov = 30",
    "exposure = 6", 'background = "dark"',
  ]);
});

test("an isovalue in words and file names gives the same surface", () => {
  const volume = { value_range: [1e9, 1e9 + 1e-4] };
  const scene = /** @type {any} */ ({ id: "small", name: "Small", volume });
  const near = [1e9 + 5e-5, 1e9 + 5.012e-5];
  assert.notEqual(fileName(scene, { isovalue: near[0] }), fileName(scene, { isovalue: near[1] }));
  assert.equal(fileName(scene, { isovalue: 1e9 + 2 ** -15 }), `small-${1e9 + 2 ** -15}`);
  const plain = { ...scene, volume: { value_range: [0, 100] } };
  assert.equal(fileName(plain, { isovalue: 70.5 }), "small-70.5");
});
