/**
 * The camera's rays as shaders read them: origin and direction are affine over the picture, and
 * rays start on a plane in front of the volume. All is computed in double precision.
 */

/** @typedef {import("./document.js").CardDocument} CardDocument */
/** @typedef {import("./document.js").Vec3} Vec3 */

/**
 * @typedef {object} Camera in the world
 * @property {Vec3} eye
 * @property {Vec3} target
 * @property {Vec3} up
 * @property {number} fov vertical, degrees
 * @property {boolean} [parallel] true if rays are parallel; objects at the target keep the size
 *   that they have with perspective
 */

/**
 * @typedef {{normal: Vec3, limit: number}} Plane takes away the points p with normal · p > limit
 */

/**
 * Distance of the eye of a parallel camera, in radii of the volume: AFAR in
 * isogi_core/model/view.py.
 */
const AFAR = 1e7;

const DEGREE = Math.PI / 180;

/** Return a + s b. @param {Vec3} a @param {number} s @param {Vec3} b @returns {Vec3} */
const along = (a, s, b) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];

/** Scale a vector to length 1. @param {Vec3} a @returns {Vec3} */
const unit = (a) => along([0, 0, 0], 1 / Math.hypot(...a), a);

/** Return the cross product of two vectors. @param {Vec3} a @param {Vec3} b @returns {Vec3} */
const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];

/**
 * Return the coordinates of a vector of the world in the volume's box.
 * @param {Vec3[]} rotation axes of the box in the world, one per entry
 * @param {Vec3} v
 * @returns {Vec3}
 */
const turnedBack = ([x, y, z], v) => along(along(along([0, 0, 0], v[0], x), v[1], y), v[2], z);

/**
 * Return a camera of the world in the volume's box, always with perspective.
 *
 * A camera with parallel rays becomes one far away with a narrow view, so that shaders need one
 * kind of ray.
 *
 * @param {CardDocument["grid"]} grid
 * @param {Camera} camera
 * @returns {{eye: Vec3, right: Vec3, up: Vec3, forward: Vec3, slope: number}} unit axes, and half
 *   of the picture's height at distance 1
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
  // Move the eye back, and narrow the view so that the picture's height at the target stays the
  // same.
  const radius = Math.hypot(...grid.size.map((n, i) => (n - 1) * grid.spacing[i])) / 2;
  const afar = AFAR * radius;
  return {
    eye: along(target, -afar, forward),
    slope: (slope * Math.hypot(...along(target, -1, eye))) / afar,
    ...axes,
  };
}

/**
 * Return the camera in index space: the ray through pixel (x, y) goes from the eye along corner + x
 * · right + y · down. Kernel: `pinhole` of isogi_core/frame/gbuffer.py.
 * @param {CardDocument["grid"]} grid
 * @param {Camera} camera
 * @param {number} width of the picture, pixels
 * @param {number} height of the picture, pixels
 * @returns {{eye: Vec3, corner: Vec3, right: Vec3, down: Vec3}}
 */
export function pinhole(grid, camera, width, height) {
  const { eye, right, up, forward, slope } = cameraInBox(grid, camera);
  // Pixels are square: the field of view spans the picture's height.
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
 * Return the rays of a picture, which start on a plane in front of the volume.
 *
 * Shaders compute in single precision, which would lose the volume's details if rays started at a
 * distant eye.
 *
 * @param {CardDocument["grid"]} grid
 * @param {Camera} camera
 * @param {number} width pixels
 * @param {number} height pixels
 * @returns {Record<string, Vec3>} uniforms of view.glsl: start and direction of the ray at (0, 0),
 *   and the change of both per pixel
 */
export function raysOf(grid, camera, width, height) {
  const { eye, corner, right, down } = pinhole(grid, camera, width, height);
  const forward = along(along(corner, width / 2, right), height / 2, down);
  const { size, spacing } = grid;
  // Find the corner of the box that is nearest along the viewing direction. Depths are in world
  // units: index space is scaled by the spacing, once for each factor of the product.
  let before = Infinity;
  for (let n = 0; n < 8; n++) {
    const depths = size.map(
      (count, i) => (((n >> i) & 1) * (count - 1) - eye[i]) * forward[i] * spacing[i] ** 2,
    );
    before = Math.min(before, depths[0] + depths[1] + depths[2]);
  }
  // Start one voxel in front of that corner, and never behind the eye. As `forward` has depth 1, s
  // scales directions to points of the plane.
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
 * Return the direction to a light above and to the left of the viewer, in the volume's box. Source
 * in the core: `shoulder_light` of isogi_core/frame/lighting.py.
 * @param {CardDocument["grid"]} grid
 * @param {Camera} camera
 * @returns {Vec3} unit vector
 */
export function shoulderLight(grid, camera) {
  const { right, up, forward } = cameraInBox(grid, camera);
  return unit(along(along(along([0, 0, 0], -1, forward), 0.5, up), -0.4, right));
}

/**
 * Return the uniforms of local models that depend on the camera: the eye, and the fog, which
 * thickens from the nearest to the farthest point of the volume's sphere. Source in the core:
 * `fog_depths` of isogi_core/frame/shading.py.
 * @param {CardDocument["grid"]} grid
 * @param {Camera} camera
 * @returns {{eye: Vec3, centre: Vec3, fog: [number, number]}} eye and middle of the volume in index
 *   space; distance from the beginning of the fog to the middle, and to its end, in world units
 */
export function depthsOf(grid, camera) {
  const { eye } = cameraInBox(grid, camera);
  const half = /** @type {Vec3} */ (grid.size.map((n, i) => ((n - 1) * grid.spacing[i]) / 2));
  const radius = Math.hypot(...half);
  const before = Math.min(radius, Math.hypot(...along(eye, -1, half)));
  const index = (/** @type {Vec3} */ v) =>
    /** @type {Vec3} */ (v.map((x, i) => x / grid.spacing[i]));
  return { eye: index(eye), centre: index(half), fog: [before, before + radius] };
}

/**
 * Return the planes of a window in index space: the visible part has n · p + w ≥ 0.
 * @param {CardDocument["grid"]} grid
 * @param {readonly Plane[]} planes in the world
 * @returns {number[]} n and w of each plane, four numbers
 */
export function windowOf({ rotation, origin, spacing }, planes) {
  return planes.flatMap(({ normal, limit }) => {
    const n = turnedBack(rotation, normal);
    // Express normal · p ≤ limit in the box: its origin is moved into the limit, and its spacing
    // into the normal.
    const w = limit - normal.reduce((sum, x, i) => sum + x * origin[i], 0);
    return [...n.map((x, i) => -x * spacing[i]), w];
  });
}
