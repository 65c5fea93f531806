/** Letters at the picture's edges: which side of a patient is there. */

import { find } from "../dom.js";
import { sidesOf } from "./camera.js";

/**
 * Keep the letters as the camera turns; none where the volume is of no patient.
 * @param {HTMLElement} root holds an element for each side
 * @param {import("../net/schemas.js").Scene} scene
 * @param {import("./model.js").ViewModel} view
 */
export function attachSides(root, scene, view) {
  root.hidden = !scene.volume.letters;
  const draw = (/** @type {import("./model.js").Knobs} */ values) => {
    for (const [side, letter] of Object.entries(sidesOf(scene, values))) find(root, `.${side}`).textContent = letter;
  };
  view.subscribe(draw);
  draw(view.values);
}
