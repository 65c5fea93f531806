/**
 * The camera's rays as shaders take them: affine over the picture, and begun on a plane before the
 * volume, in double.
 */

/** @typedef {import("./document.js").CardDocument} CardDocument */
/** @typedef {import("./document.js").Vec3} Vec3 */

/**
 * @typedef {object} Camera in the world
 * @property {Vec3} eye
 * @property {Vec3} target
 * @property {Vec3} up
 * @property {number} fov vertical, degrees
 * @property {boolean} [parallel] whether rays are parallel: what is at the target is as large as
 *   else
 */

/**
 * @typedef {{normal: Vec3, limit: number}} Plane takes away the points p with normal · p > limit
 */

/**
 * Radii of the volume from which a camera of parallel rays looks: AFAR in isogi_core/model/view.py.
 */
const AFAR = 1e7;

const DEGREE = Math.PI / 180;

/** a + s b. @param {Vec3} a @param {number} s @param {Vec3} b @returns {Vec3} */
const along = (a, s, b) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];

/** @param {Vec3} a @returns {Vec3} */
const unit = (a) => along([0, 0, 0], 1 / Math.hypot(...a), a);

/** @param {Vec3} a @param {Vec3} b @returns {Vec3} */
const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];

/**
 * A vector of the world in the box, whose axes are the columns of `rotation`.
 * @param {Vec3[]} rotation
 * @param {Vec3} v
 * @returns {Vec3}
 */
const turnedBack = ([x, y, z], v) => along(along(along([0, 0, 0], v[0], x), v[1], y), v[2], z);

/**
 * A camera of the world in the box of a volume, with perspective: one of parallel rays looks from
 * afar.
 * @param {CardDocument["grid"]} grid
 * @param {Camera} camera
 * @returns {{eye: Vec3, right: Vec3, up: Vec3, forward: Vec3, slope: number}} unit axes, and half
 *   the height at distance 1
 */
function cameraInBox(grid, camera) {
  const [eye, target] = [camera.eye, camera.target].map((point) =>
    turnedBack(grid.rotation, along(point, -1, grid.origin)),
  );
  const forward = unit(along(target, -1, eye));
  const right = unit(cross(forward, turnedBack(grid.rotation, camera.up)));
  const axes = { right, up: cross(right, forward), forward };
  const slope = Math.tan((camera.fov * DEGREE) / 2);
  if (!camera.parallel) return { eye, slope, ...axes };
  const radius = Math.hypot(...grid.size.map((n, i) => (n - 1) * grid.spacing[i])) / 2;
  const afar = AFAR * radius;
  return {
    eye: along(target, -afar, forward),
    slope: (slope * Math.hypot(...along(target, -1, eye))) / afar,
    ...axes,
  };
}

/**
 * The camera in index space for a picture: the ray through (x, y) is corner + x · right + y · down
 * from the eye.
 * Kernel: `pinhole` of isogi_core/frame/gbuffer.py.
 * @param {CardDocument["grid"]} grid
 * @param {Camera} camera
 * @param {number} width pixels
 * @param {number} height pixels
 * @returns {{eye: Vec3, corner: Vec3, right: Vec3, down: Vec3}}
 */
export function pinhole(grid, camera, width, height) {
  const { eye, right, up, forward, slope } = cameraInBox(grid, camera);
  const pixel = (2 * slope) / height;
  const corner = along(along(forward, (-pixel * width) / 2, right), (pixel * height) / 2, up);
  const index = (/** @type {Vec3} */ v, s = 1) =>
    /** @type {Vec3} */ (v.map((x, i) => (s * x) / grid.spacing[i]));
  return {
    eye: index(eye),
    corner: index(corner),
    right: index(right, pixel),
    down: index(up, -pixel),
  };
}

/**
 * Rays of a picture, begun on a plane before the box: from an eye far away single floats would lose
 * what they meet.
 * @param {CardDocument["grid"]} grid
 * @param {Camera} camera
 * @param {number} width pixels
 * @param {number} height pixels
 * @returns {Record<string, Vec3>} uniforms of view.glsl: where rays start and go at (0, 0), and
 *   what a pixel adds
 */
export function raysOf(grid, camera, width, height) {
  const { eye, corner, right, down } = pinhole(grid, camera, width, height);
  const forward = along(along(corner, width / 2, right), height / 2, down);
  const { size, spacing } = grid;
  let before = Infinity;
  for (let n = 0; n < 8; n++) {
    const depths = size.map(
      (count, i) => (((n >> i) & 1) * (count - 1) - eye[i]) * forward[i] * spacing[i] ** 2,
    );
    before = Math.min(before, depths[0] + depths[1] + depths[2]);
  }
  const s = Math.max(before - Math.min(...spacing), 0);
  const from = (/** @type {Vec3} */ v) => along([0, 0, 0], s, v);
  return {
    start: along(eye, s, corner),
    startRight: from(right),
    startDown: from(down),
    corner,
    right,
    down,
  };
}

/**
 * The planes of a window in index space: what is left to see has n · p + w ≥ 0.
 * @param {CardDocument["grid"]} grid
 * @param {readonly Plane[]} planes in the world
 * @returns {number[]} four numbers of each, n and w
 */
export function windowOf({ rotation, origin, spacing }, planes) {
  return planes.flatMap(({ normal, limit }) => {
    const n = turnedBack(rotation, normal);
    const w = limit - normal.reduce((sum, x, i) => sum + x * origin[i], 0);
    return [...n.map((x, i) => -x * spacing[i]), w];
  });
}
