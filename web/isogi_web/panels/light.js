/**
 * The light in a mirror ball, which shows the light and its rotation as the camera sees them, and
 * rotates the light.
 */

import { find } from "../dom.js";
import { readSky } from "../net/api.js";
import { ARROWS } from "../view/keys.js";
import { cameraAxes, fromAngles, inSteps, rollLight, turnVector } from "../view/rotation.js";

/** @typedef {import("../net/schemas.js").Scene} Scene */
/** @typedef {import("../view/model.js").ViewModel} ViewModel */
/** @typedef {import("../view/rotation.js").LightAndCamera} LightAndCamera */
/** @typedef {{data: Uint8ClampedArray, width: number, height: number}} Pixels RGBA, row by row */

const DEGREES_ACROSS = 720 / Math.PI; // at the middle, mirrored things follow the pointer
const KEY_STEP = 10; // degrees
const SKY_WIDTH = 128; // pixels of the light's picture, about as large as those of the ball
const HIGHEST_RATIO = 1.5; // pixels per CSS pixel: more would cost much and show little

/** Types of distant lights. */
const FROM_AFAR = new Set(["sky", "probe", "environment", "directional"]);
const RIM = 0.62; // brightness of the rim over the middle, so that the ball looks round

/** Numbers per pixel of the ball: direction right, up and towards the eye, and shade. */
const RAY = 4;

/**
 * Show the ball, and tie it to the view. If rotating the light would change nothing, say so.
 * @param {HTMLElement} section holds `#globe`, its knobs and `#light-note`
 * @param {Scene} scene
 * @param {ViewModel} view
 * @param {() => void} onRest is called when a drag ends
 * @returns {() => void} shows the ball again, in another light of the scene
 */
export function attachLight(section, scene, view, onRest) {
  const globe = find(section, "#globe", HTMLCanvasElement);
  /** @type {MirrorBall|null} */
  let ball = null;
  /** Return a view in the turn of the light that its picture has. @param {LightAndCamera} values */
  const asLit = (values) => ({ ...values, ...inSteps(values, scene.turn_step) });
  const show = async () => {
    explain(section, scene);
    if (find(section, ".light").hidden) return;
    const painted = await makeBall(globe, scene, view.values.environment);
    if (!painted) return; // the knobs replace the ball
    ball = painted;
    ball.draw(asLit(view.values));
    globe.dataset.painted = "";
  };
  // Draw the ball only while it is in sight.
  let seen = false;
  new IntersectionObserver((changes) => {
    seen = changes.at(-1)?.isIntersecting ?? seen;
    if (seen) ball?.draw(asLit(view.values));
  }).observe(globe);
  view.subscribe((values) => seen && ball?.draw(asLit(values)));
  attachDrag(globe, scene, view, onRest);
  attachArrows(globe, scene, view);
  show();
  return show;
}

/** Attributes of a ball that rotates the light. */
const TURNED = {
  tabindex: "0",
  role: "application",
  "aria-roledescription": "mirror ball",
  "aria-label": "Light, seen in a mirror ball. Arrow keys turn it.",
};

/** Attributes of a ball that only shows the light. */
const FIXED = { role: "img", "aria-label": "The light, seen in a mirror ball" };

/**
 * Say if the light can be rotated, and hide controls that would rotate nothing.
 * @param {HTMLElement} section
 * @param {Scene} scene
 */
function explain(section, { turns, rotating, lights, turn_step }) {
  const [note, ball, globe] = ["#light-note", ".light", "#globe"].map((each) =>
    find(section, each),
  );
  note.textContent = noteOf({ turns, rotating, turn_step });
  note.hidden = !note.textContent;
  ball.hidden = !turns && (rotating || !lights.some(({ type }) => FROM_AFAR.has(type)));
  find(ball, "div").hidden = !turns;
  for (const name of Object.keys(TURNED)) globe.removeAttribute(name);
  for (const [name, text] of Object.entries(turns ? TURNED : FIXED)) globe.setAttribute(name, text);
}

/**
 * Return the sentence that says how the light can be turned; "" if it turns at once.
 * @param {Pick<Scene, "turns"|"rotating"|"turn_step">} scene
 * @returns {string}
 */
export function noteOf({ turns, rotating, turn_step }) {
  if (turns) return turn_step ? `Turns in steps of ${turn_step}°: each is baked when it is shown.` : "";
  return rotating ? "The light is the same from all sides." : "The light of this scene is fixed.";
}

/**
 * Make the ball with a picture of the light.
 * @param {HTMLCanvasElement} globe
 * @param {Scene} scene
 * @param {string} environment that the scene is shown in; "" for the scene's light
 * @returns {Promise<MirrorBall|null>} null if there is no picture of the light
 */
async function makeBall(globe, scene, environment) {
  const ratio = Math.min(window.devicePixelRatio || 1, HIGHEST_RATIO);
  const light = await readSky(scene.id, SKY_WIDTH * Math.ceil(ratio), environment).then(
    pixelsOf,
    () => null,
  );
  if (!light) return null;
  globe.width = globe.height = Math.round(globe.clientWidth * ratio);
  return new MirrorBall(contextOf(globe), globe.width, light);
}

/** Return the pixels of a picture. @param {Blob} blob */
async function pixelsOf(blob) {
  const picture = await createImageBitmap(blob);
  const canvas = Object.assign(document.createElement("canvas"), {
    width: picture.width,
    height: picture.height,
  });
  const paint = contextOf(canvas);
  paint.drawImage(picture, 0, 0);
  return paint.getImageData(0, 0, canvas.width, canvas.height);
}

/**
 * Return the context of a canvas.
 * @param {HTMLCanvasElement} canvas
 * @throws {Error} if the browser has none
 */
function contextOf(canvas) {
  const context = canvas.getContext("2d");
  if (!context) throw new Error("This browser cannot draw on a canvas.");
  return context;
}

/**
 * Let a drag over the ball rotate the light.
 * @param {HTMLElement} globe
 * @param {Scene} scene
 * @param {ViewModel} view
 * @param {() => void} onRest
 */
function attachDrag(globe, scene, view, onRest) {
  globe.addEventListener("pointerdown", (event) => {
    if (!scene.turns) return;
    globe.setPointerCapture(event.pointerId);
    globe.dataset.dragging = "light";
  });
  globe.addEventListener("pointermove", (event) => {
    if (!globe.hasPointerCapture(event.pointerId)) return;
    const degrees = DEGREES_ACROSS / globe.clientWidth;
    view.set(rollLight(view.values, event.movementX * degrees, event.movementY * degrees));
  });
  globe.addEventListener("lostpointercapture", () => {
    delete globe.dataset.dragging;
    onRest();
  });
}

/**
 * Let arrows rotate the light.
 * @param {HTMLElement} globe
 * @param {Scene} scene
 * @param {ViewModel} view
 */
function attachArrows(globe, scene, view) {
  globe.addEventListener("keydown", (event) => {
    if (!scene.turns || !(event.key in ARROWS) || event.ctrlKey || event.altKey || event.metaKey)
      return;
    event.preventDefault();
    const [right, down] = ARROWS[event.key];
    view.set(rollLight(view.values, right * KEY_STEP, down * KEY_STEP));
  });
}

/** Paints the ball on a square canvas. */
export class MirrorBall {
  #paint;
  #picture;
  #light;
  #places;
  #rays;

  /**
   * @param {CanvasRenderingContext2D} paint of the canvas
   * @param {number} size of the canvas, pixels
   * @param {Pixels} light latitude and longitude: the top row is +z, column 0 starts at azimuth 0
   */
  constructor(paint, size, light) {
    this.#paint = paint;
    this.#picture = paint.createImageData(size, size);
    this.#light = light;
    const pixels = ballPixels(size);
    for (const { place, cover } of pixels) this.#picture.data[place + 3] = 255 * cover;
    this.#places = Uint32Array.from(pixels, ({ place }) => place);
    this.#rays = Float32Array.from(pixels.flatMap(({ ray }) => ray));
  }

  /**
   * Paint the ball as the view's camera sees it in the view's light.
   * @param {LightAndCamera} values knobs of the view
   */
  draw(values) {
    const [w, x, y, z] = fromAngles(values);
    const { right, up, out } = cameraAxes(values.azimuth, values.elevation);
    // Rotate the camera's axes into the frame of the light, instead of rotating the light.
    const axes = Float64Array.from(
      [right, up, out].flatMap((direction) => turnVector([w, -x, -y, -z], direction)),
    );
    for (let i = 0; i < this.#places.length; i++) {
      mirror(this.#light, axes, this.#rays, RAY * i, this.#picture.data, this.#places[i]);
    }
    this.#paint.putImageData(this.#picture, 0, 0);
  }
}

/**
 * Return the pixels of a ball that fills a square picture.
 * @param {number} size of the picture, pixels
 * @returns {{place: number, cover: number, ray: number[]}[]} `place` of the pixel's first byte;
 *   `cover`, the share of it that the ball covers; `ray`, the direction that it mirrors (right, up,
 *   towards the eye; a unit vector on the ball) and its shade
 */
export function ballPixels(size) {
  const pixels = [];
  for (let row = 0; row < size; row++) {
    for (let column = 0; column < size; column++) {
      const [right, up] = [(2 * column + 1) / size - 1, 1 - (2 * row + 1) / size];
      // Distance from the ball's middle, in radii; `cover` fades over one pixel at the rim.
      const away = Math.hypot(right, up);
      const cover = Math.min(1, (1 - away) * (size / 2) + 0.5);
      const depth = Math.sqrt(Math.max(0, 1 - away * away));
      // The eye's direction e = (0, 0, 1), reflected at the normal n: 2 (n · e) n - e.
      const ray = [
        2 * depth * right,
        2 * depth * up,
        2 * depth * depth - 1,
        RIM + (1 - RIM) * depth,
      ];
      if (cover > 0) pixels.push({ place: 4 * (row * size + column), cover, ray });
    }
  }
  return pixels;
}

/**
 * Write the light that one pixel mirrors as three bytes, interpolated between the four nearest
 * pixels of the light.
 * @param {Pixels} light
 * @param {Float64Array} axes of the camera, in the frame of the light
 * @param {Float32Array} rays of the ball
 * @param {number} ray index of the pixel's direction in `rays`
 * @param {Uint8ClampedArray} into
 * @param {number} place of the pixel's first byte
 */
function mirror({ data, width, height }, axes, rays, ray, into, place) {
  const x = axes[0] * rays[ray] + axes[3] * rays[ray + 1] + axes[6] * rays[ray + 2];
  const y = axes[1] * rays[ray] + axes[4] * rays[ray + 1] + axes[7] * rays[ray + 2];
  const z = axes[2] * rays[ray] + axes[5] * rays[ray + 1] + axes[8] * rays[ray + 2];
  // Azimuth and polar angle of the direction are column and row of the light's picture.
  const column = (Math.atan2(y, x) / (2 * Math.PI) + 1) * width - 0.5;
  const row = Math.min(
    height - 1,
    Math.max(0, (Math.acos(Math.min(1, Math.max(-1, z))) / Math.PI) * height - 0.5),
  );
  const left = Math.floor(column);
  const top = Math.floor(row);
  const first = 4 * top * width;
  const last = 4 * Math.min(top + 1, height - 1) * width;
  const near = 4 * (left % width);
  const far = 4 * ((left + 1) % width);
  for (let i = 0; i < 3; i++) {
    const above =
      data[first + near + i] + (data[first + far + i] - data[first + near + i]) * (column - left);
    const below =
      data[last + near + i] + (data[last + far + i] - data[last + near + i]) * (column - left);
    into[place + i] = rays[ray + 3] * (above + (below - above) * (row - top));
  }
}
