import assert from "node:assert/strict";
import { test } from "node:test";
import { beginExport, readJob, stopJob } from "../../../web/net/api.js";
import { exportQuery, jobInWords } from "../../../web/net/export.js";
import { frameQuery } from "../../../web/net/request.js";
import { keyframe, keyframeInWords, parseViews, viewsFile } from "../../../web/panels/views.js";
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
