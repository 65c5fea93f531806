import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { test } from "node:test";
import { zipOf } from "../../../web/isogi_web/net/bytes.js";

test("files become a ZIP file that others read", async () => {
  const folder = mkdtempSync(join(tmpdir(), "zip-"));
  try {
    const contents = { "scan/ä.dcm": "voxels", "b.raw": "\u0000\u0001", "empty": "" };
    const files = Object.entries(contents).map(([path, text]) => ({ path, file: new Blob([text]) }));
    writeFileSync(join(folder, "a.zip"), Buffer.from(await (await zipOf(files)).arrayBuffer()));
    const read = "import sys, json, zipfile; whole = zipfile.ZipFile(sys.argv[1]); assert whole.testzip() is None; print(json.dumps({name: whole.read(name).decode() for name in whole.namelist()}))";
    assert.deepEqual(JSON.parse(execFileSync("python3", ["-c", read, join(folder, "a.zip")], { encoding: "utf8" })), contents);
  } finally {
    rmSync(folder, { recursive: true });
  }
});
