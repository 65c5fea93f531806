/** The menu that shows the view as a link, as a line for a shell and as a line of Python, and copies them. */

import { frameAddress, wantsToken } from "./api.js";
import { curlLine, pythonLine, tellingParts } from "./lines.js";

const WAIT_MS = 10_000; // the longest that a request may wait for light
const COPIED_MS = 1600;

/**
 * Tie the menu to the view.
 * @param {HTMLElement} menu a popover that holds `#share-link`, `#share-curl`, `#share-python`, each with its button
 * @param {object} scene answer of `readScene`
 * @param {import("./view.js").ViewModel} view
 * @param {{link: () => string, query: () => Record<string, string|number>, file: () => string}} told the address of
 *   the page with the view in it, the parameters of the picture shown, and the name of its file without an ending
 */
export function attachShare(menu, scene, view, { link, query, file }) {
  let token = null;
  const write = async () => {
    token ??= await wantsToken().catch(() => null);
    const [telling, name] = [tellingParts(scene, query()), `${file()}.png`];
    const address = frameAddress(scene.id, { ...telling, f: "png", wait_ms: WAIT_MS });
    const server = new URL(".", document.baseURI).href.replace(/\/$/, "");
    menu.querySelector("#share-link").textContent = link();
    menu.querySelector("#share-curl").textContent = curlLine(address, name, token);
    menu.querySelector("#share-python").textContent = pythonLine(server, scene.id, telling, name);
  };
  menu.addEventListener("beforetoggle", ({ newState }) => newState === "open" && write());
  view.subscribe(() => menu.matches(":popover-open") && write());
  for (const line of menu.querySelectorAll(".line")) attachCopy(line, menu.querySelector(".note"));
}

function attachCopy(line, note) {
  const [button, text] = [line.querySelector("button"), line.querySelector("code")];
  const name = button.textContent;
  button.addEventListener("click", async () => {
    const copied = await navigator.clipboard?.writeText(text.textContent).then(() => true, () => false);
    if (!copied) getSelection().selectAllChildren(text);
    note.textContent = copied ? `${text.ariaLabel} copied` : "The browser lets no page copy here: it is selected, copy it by keys.";
    if (!copied) return;
    button.textContent = "Copied";
    setTimeout(() => { button.textContent = name; }, COPIED_MS);
  });
}
