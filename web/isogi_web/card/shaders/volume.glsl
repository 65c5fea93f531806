// The volume and its active-cell map as textures, see web/isogi_web/card/volume.js and web/isogi_web/card/cells.js.
// Kernels: isogi_core/kernels/tracing/field.py and active_cells.py. Places are in index space, x
// first.
#include "bricks.glsl"
#include "surfaces.glsl"
// usampler3D of integers, or sampler3D of floats: codes, which grow with the voxels.
uniform VOXELS voxels;
uniform ivec3 size;          // voxels along x, y, z
uniform vec3 spacing;        // world units per voxel
// Per brick: the number of its cells' words, or EMPTY plus the distance to the next brick with
// active cells.
uniform highp usampler3D tops;
// Two words per brick with active cells, ROW in a row: 64 bits, one per cell.
uniform highp usampler2D cells;

const uint EMPTY = 0x80000000u;
const float HOLE = -1e38; // Codes below stand for no value: GLSL does not promise to keep NaN.

float voxel(ivec3 c) { return float(texelFetch(voxels, c, 0).r); }

// True if cell c may hold the surface; otherwise [low, low + edge) becomes a cube of idle cells
// around it. Source of empty-space skipping by distances: Zuiderveld, Koning and Viergever,
// "Acceleration of Ray-Casting Using 3-D Distance Transforms", 1992.
bool look_up(ivec3 c, out ivec3 low, out int edge) {
  uint top = texelFetch(tops, (c >> 2) + ivec3(0, 0, map_layer), 0).r;
  low = c;
  edge = 1;
  if ((top & EMPTY) != 0u) {
    // All bricks within distance - 1 are idle.
    int reach = int(top & 255u) - 1;
    low = ((c >> 2) - reach) * BRICK;
    edge = (2 * reach + 1) * BRICK;
    return false;
  }
  uvec2 words = texelFetch(cells, ivec2(int(top) % ROW, int(top) / ROW), 0).rg;
  int bit = bit_of(c);
  if (((half_of(words, bit) >> (bit & 31)) & 1u) == 1u) return true;
  // An idle cell of a brick with active ones: skip its block of 2x2x2 cells if the block is idle.
  ivec3 even = c & ~1;
  int first = bit_of(even);
  if ((half_of(words, first) & (0x00330033u << (first & 31))) == 0u) {
    low = even;
    edge = 2;
  }
  return false;
}
