import assert from "node:assert/strict";
import { readFileSync, readdirSync } from "node:fs";
import { test } from "node:test";

const WEB = new URL("../../../web/isogi_web/", import.meta.url);
const LOWER = { view: ["view"], card: ["card"], net: ["net", "view"], panels: ["panels", "net", "view"], slices: ["slices", "view"], live: ["live", "card", "net", "view"], published: ["published", "live", "panels", "card", "net", "view"], notebook: ["notebook", "live", "card", "net", "view"] };
const modules = readdirSync(WEB, { recursive: true }).filter((file) => file.endsWith(".js"));
const textOf = (file) => readFileSync(new URL(file, WEB), "utf8");

/** The modules that a module imports, as paths below `web/`. Types alone are no imports. */
function imports(file) {
  const found = [...textOf(file).matchAll(/^(?:import|export) .*?from "([^"]+)";$/gms)].map(([, path]) => path);
  return found.map((path) => new URL(path, new URL(file, WEB)).href.slice(WEB.href.length));
}

test("every module is found", () => {
  assert.ok(modules.length > 20);
});

test("rooms import one way: published or notebook, panels, live, net, card, view; slices, view", () => {
  for (const [room, lower] of Object.entries(LOWER)) {
    for (const file of modules.filter((each) => each.startsWith(`${room}/`))) {
      const outside = imports(file).filter((path) => path !== "dom.js" && !lower.includes(path.split("/")[0]));
      assert.deepEqual(outside, [], file);
    }
  }
});

test("no module imports itself, however far round", () => {
  const done = new Set();
  const visit = (file, path) => {
    assert.ok(!path.includes(file), [...path, file].join(" → "));
    if (done.has(file)) return;
    imports(file).forEach((each) => visit(each, [...path, file]));
    done.add(file);
  };
  modules.forEach((file) => visit(file, []));
});

test("every module is reached from a page's first one", () => {
  const reached = new Set();
  const visit = (file) => reached.has(file) || (reached.add(file), imports(file).forEach(visit));
  ["main.js", "published/published.js", "notebook/notebook.js"].forEach(visit);
  assert.deepEqual(modules.filter((file) => !reached.has(file)), []);
});

test("everything that is exported is documented", () => {
  for (const file of modules) {
    const lines = textOf(file).split("\n");
    assert.ok(lines[0].startsWith("/**"), `${file} does not say what it is`);
    const bare = lines.filter((line, i) => line.startsWith("export ") && !lines[i - 1].endsWith("*/"));
    assert.deepEqual(bare, [], file);
  }
});

test("every exported function says what it returns, if anything", () => {
  for (const file of modules) {
    for (const [, doc, signature, body] of textOf(file).matchAll(/\/\*\*((?:(?!\*\/).)*)\*\/\nexport (?:async )?function\*? (\w+)[^\n]*\n(.*?)^}/gms)) {
      if (/^ {2}(?:return|throw) [^;]/m.test(body)) assert.match(doc, /@returns/, `${file}: ${signature}`);
    }
  }
});
