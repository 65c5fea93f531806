/** A mirror ball: the light around the scene, reflected to the camera. */

import { cameraAxes, fromAngles, turnVector } from "./rotation.js";

const RIM = 0.62; // how bright the rim is beside the middle, so that the ball is seen as one
const RAY = 4; // numbers of a pixel: where its mirror looks, to the right, up and to the eye, and its shade

/** Paints the ball onto a square canvas. */
export class MirrorBall {
  #paint;
  #picture;
  #light;
  #places;
  #rays;

  /**
   * @param {HTMLCanvasElement} canvas
   * @param {ImageData} light latitude and longitude: the top row is +z, column 0 starts at azimuth 0
   */
  constructor(canvas, light) {
    this.#paint = canvas.getContext("2d");
    this.#picture = this.#paint.createImageData(canvas.width, canvas.height);
    this.#light = light;
    const pixels = ballPixels(canvas.width);
    for (const { place, cover } of pixels) this.#picture.data[place + 3] = 255 * cover;
    this.#places = Uint32Array.from(pixels, ({ place }) => place);
    this.#rays = Float32Array.from(pixels.flatMap(({ ray }) => ray));
  }

  /**
   * Paint it as the view's camera sees it in the view's light.
   * @param {object} values knobs of the view
   */
  draw(values) {
    const [w, ...axis] = fromAngles(values);
    const back = [w, ...axis.map((x) => -x)];
    const { right, up, out } = cameraAxes(values.azimuth, values.elevation);
    const axes = Float64Array.from([right, up, out].flatMap((direction) => turnVector(back, direction)));
    for (let i = 0; i < this.#places.length; i++) {
      mirror(this.#light, axes, this.#rays, RAY * i, this.#picture.data, this.#places[i]);
    }
    this.#paint.putImageData(this.#picture, 0, 0);
  }
}

/** For each pixel on the ball: its place in the picture, how much the ball covers it, and its ray. */
function ballPixels(size) {
  const pixels = [];
  for (let row = 0; row < size; row++) {
    for (let column = 0; column < size; column++) {
      const [right, up] = [(2 * column + 1) / size - 1, 1 - (2 * row + 1) / size];
      const away = Math.hypot(right, up);
      const cover = Math.min(1, (1 - away) * (size / 2) + 0.5);
      const depth = Math.sqrt(Math.max(0, 1 - away * away));
      const ray = [2 * depth * right, 2 * depth * up, 2 * depth * depth - 1, RIM + (1 - RIM) * depth];
      if (cover > 0) pixels.push({ place: 4 * (row * size + column), cover, ray });
    }
  }
  return pixels;
}

/** Write what one pixel mirrors, between the four nearest of the light's pixels, as three bytes. */
function mirror({ data, width, height }, axes, rays, ray, into, place) {
  const x = axes[0] * rays[ray] + axes[3] * rays[ray + 1] + axes[6] * rays[ray + 2];
  const y = axes[1] * rays[ray] + axes[4] * rays[ray + 1] + axes[7] * rays[ray + 2];
  const z = axes[2] * rays[ray] + axes[5] * rays[ray + 1] + axes[8] * rays[ray + 2];
  const column = (Math.atan2(y, x) / (2 * Math.PI) + 1) * width - 0.5;
  const row = Math.min(height - 1, Math.max(0, (Math.acos(Math.min(1, Math.max(-1, z))) / Math.PI) * height - 0.5));
  const left = Math.floor(column);
  const top = Math.floor(row);
  const first = 4 * top * width;
  const last = 4 * Math.min(top + 1, height - 1) * width;
  const near = 4 * (left % width);
  const far = 4 * ((left + 1) % width);
  for (let i = 0; i < 3; i++) {
    const above = data[first + near + i] + (data[first + far + i] - data[first + near + i]) * (column - left);
    const below = data[last + near + i] + (data[last + far + i] - data[last + near + i]) * (column - left);
    into[place + i] = rays[ray + 3] * (above + (below - above) * (row - top));
  }
}
