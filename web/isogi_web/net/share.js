/**
 * The menu that shows the view as a link, as lines of a scene file, as a line for a shell and as a
 * line of Python, and copies them.
 */

import { find } from "../dom.js";
import { frameAddress, wantsToken } from "./api.js";
import { changedParameters, curlLine, pythonLine, sceneText } from "./request.js";

/** @typedef {import("./request.js").Description} Description */
/** @typedef {import("./schemas.js").Scene} Scene */

const WAIT_MS = 10_000; // longest time that a request may wait for light
const COPIED_MS = 1600; // time that a button says “Copied”
const REFUSED = "The browser does not let this page copy: the text is selected, copy it with the keyboard.";

/**
 * Keep the menu's lines up to date with the view while it is open.
 * @param {HTMLElement} menu a popover that holds `#share-link`, `#share-scene`, `#share-curl`,
 *   `#share-python`, each with its button
 * @param {Scene} scene
 * @param {import("../view/model.js").ViewModel} view
 * @param {Description} description of the view
 */
export function attachShare(menu, scene, view, { link, query, file }) {
  /** True if the server asks for a token; null until it has answered. @type {boolean|null} */
  let token = null;
  const write = async () => {
    token ??= await wantsToken().catch(() => null);
    const changed = changedParameters(scene, query());
    const name = `${file()}.png`;
    const address = frameAddress(scene.id, { ...changed, f: "png", wait_ms: WAIT_MS });
    const server = new URL(".", document.baseURI).href.replace(/\/$/, "");
    find(menu, "#share-link").textContent = link();
    find(menu, "#share-scene").textContent = sceneText(query());
    find(menu, "#share-curl").textContent = curlLine(address, name, token ?? false);
    find(menu, "#share-python").textContent = pythonLine(server, scene.id, changed, name);
  };
  menu.addEventListener("beforetoggle", ({ newState }) => newState === "open" && write());
  view.subscribe(() => menu.matches(":popover-open") && write());
  for (const line of menu.querySelectorAll(".line")) attachCopy(line, find(menu, ".note"));
}

/**
 * Let a line's button copy its text. If the browser refuses, select the text for the keyboard.
 * @param {Element} line
 * @param {HTMLElement} note
 */
function attachCopy(line, note) {
  const [button, text] = [find(line, "button"), find(line, "code")];
  const name = button.textContent;
  button.addEventListener("click", async () => {
    const copied = await navigator.clipboard?.writeText(text.textContent ?? "").then(
      () => true,
      () => false,
    );
    if (!copied) getSelection()?.selectAllChildren(text);
    note.textContent = copied ? `${text.ariaLabel} copied` : REFUSED;
    if (!copied) return;
    button.textContent = "Copied";
    setTimeout(() => {
      button.textContent = name;
    }, COPIED_MS);
  });
}
