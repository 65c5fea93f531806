/** The six sides: looking at the volume along an axis, from as far as before and at the same target. */

const CLOSE = 0.05; // degrees

/** Azimuth and elevation of each side; from above and from below, x goes to the right. */
export const SIDES = {
  "+x": { azimuth: 0, elevation: 0 }, "-x": { azimuth: 180, elevation: 0 },
  "+y": { azimuth: 90, elevation: 0 }, "-y": { azimuth: -90, elevation: 0 },
  "+z": { azimuth: -90, elevation: 90 }, "-z": { azimuth: -90, elevation: -90 },
};

/**
 * Tie the buttons to the view: each turns it to its side, and that of the present side is pressed.
 * @param {HTMLElement} group holds a button with `data-side` for each side
 * @param {import("./view.js").ViewModel} view
 */
export function attachSides(group, view) {
  const buttons = [...group.querySelectorAll("[data-side]")];
  const mirror = (values) => {
    for (const button of buttons) button.setAttribute("aria-pressed", looksFrom(SIDES[button.dataset.side], values));
  };
  for (const button of buttons) button.addEventListener("click", () => view.set(SIDES[button.dataset.side]));
  mirror(view.values);
  view.subscribe(mirror);
}

function looksFrom({ azimuth, elevation }, values) {
  const turned = Math.abs(((values.azimuth - azimuth + 540) % 360) - 180);
  return turned < CLOSE && Math.abs(values.elevation - elevation) < CLOSE;
}
