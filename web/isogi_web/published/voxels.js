/**
 * Voxels of a published page: those that draw its isosurfaces, as differences from a prediction.
 * The format is described in docs/card.md. Source in the core:
 * isogi_core/frame/card/coded_voxels.py.
 */

/** @typedef {import("../card/cells.js").Voxels} Voxels */
/** @typedef {import("../card/document.js").CardDocument} CardDocument */

const VALUES = { uint8: Uint8Array, uint16: Uint16Array, float32: Float32Array };
const BITS = { uint8: Uint8Array, uint16: Uint16Array, float32: Uint32Array };

/**
 * Unpack the slabs of a scene, in the order of `slabsOf`: those of the volume, while others stay.
 * @param {CardDocument} document
 * @param {ArrayBuffer[]} slabs
 * @returns {ArrayBuffer[]}
 */
export function unpackSlabs({ grid, volume }, slabs) {
  const [nx, ny] = grid.size;
  const unpacked = volume.slabs.map(({ first, last }, i) =>
    unpackVoxels(slabs[i], volume.type, [nx, ny, last - first]),
  );
  return [...unpacked, ...slabs.slice(unpacked.length)];
}

/**
 * Unpack some layers of a volume.
 * @param {ArrayBuffer} file
 * @param {CardDocument["volume"]["type"]} type of the codes of voxels
 * @param {[number, number, number]} size voxels along x, y, z
 * @returns {ArrayBuffer} codes, x fastest, then y
 */
export function unpackVoxels(file, type, [nx, ny, nz]) {
  const layer = nx * ny;
  const values = new VALUES[type](layer * nz);
  const bits = new BITS[type](values.buffer);
  const width = values.BYTES_PER_ELEMENT;
  const [low, high] = new VALUES[type](file, 0, 2);
  const marks = new Uint8Array(file, 2 * width, layer * Math.ceil(nz / 8));
  const steps = new Uint8Array(file, 2 * width + marks.length);
  const count = steps.length / width;
  const stated = new Uint8Array(layer); // 1 in columns whose voxels are stated
  let next = 0;
  for (let z = 0, i = 0; z < nz; z++) {
    for (let y = 0; y < ny; y++) {
      for (let x = 0; x < nx; x++, i++) {
        const column = nx * y + x;
        stated[column] ^= (marks[layer * (z >> 3) + column] >> (z & 7)) & 1;
        if (stated[column]) {
          // A stated voxel is its prediction plus a step; the array cuts it to the type's range.
          bits[i] = predict(bits, i, x && 1, y && nx, z && layer) + stepAt(steps, next++, count);
        } else {
          // Any other one has the value of its side, which is that of the voxel before it.
          const before = x ? i - 1 : y ? i - nx : i - layer;
          values[i] = (values[before] ?? 0) <= low ? low : high;
        }
      }
    }
  }
  return values.buffer;
}

/**
 * Return a step of the prediction, which may be negative.
 * @param {Uint8Array} planes bytes of all steps: all first ones, then all second ones, …
 * @param {number} n number of the step
 * @param {number} count steps
 * @returns {number}
 */
function stepAt(planes, n, count) {
  let code = 0;
  for (let at = n, shift = 0; at < planes.length; at += count, shift += 8)
    code |= planes[at] << shift;
  return (code >>> 1) ^ -(code & 1);
}

const GUESSES = new Float64Array(7);

/**
 * Predict a voxel by the seven before it: the median of three neighbours, and of what three planes
 * and a trilinear function through them give. Neighbours outside of the layers are 0.
 * @param {Uint8Array|Uint16Array|Uint32Array} v
 * @param {number} i number of the voxel
 * @param {number} dx distance to the neighbour along x, 0 if it is outside; `dy`, `dz` alike
 * @param {number} dy
 * @param {number} dz
 * @returns {number}
 */
function predict(v, i, dx, dy, dz) {
  const x = dx ? v[i - dx] : 0;
  const y = dy ? v[i - dy] : 0;
  const z = dz ? v[i - dz] : 0;
  const xy = dx && dy ? v[i - dx - dy] : 0;
  const xz = dx && dz ? v[i - dx - dz] : 0;
  const yz = dy && dz ? v[i - dy - dz] : 0;
  const xyz = dx && dy && dz ? v[i - dx - dy - dz] : 0;
  insert(0, x);
  insert(1, y);
  insert(2, z);
  insert(3, x + y - xy);
  insert(4, x + z - xz);
  insert(5, y + z - yz);
  insert(6, x + y + z - xy - xz - yz + xyz);
  return GUESSES[3];
}

/**
 * Insert a guess into the first `count` ones, which are sorted.
 * @param {number} count
 * @param {number} guess
 */
function insert(count, guess) {
  let at = count;
  for (; at > 0 && GUESSES[at - 1] > guess; at--) GUESSES[at] = GUESSES[at - 1];
  GUESSES[at] = guess;
}
