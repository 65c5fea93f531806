// The volume and its active-cell map as textures, see web/card/volume.js and web/card/cells.js.
// Kernels: isogi_core/kernels/tracing/field.py and active_cells.py. Places are in index space, x first.
#include "bricks.glsl"
uniform VOXELS voxels;       // usampler3D of integers, or sampler3D of floats: codes, which grow with the voxels
uniform ivec3 size;          // voxels along x, y, z
uniform float isovalue;      // as a code
uniform vec3 spacing;        // world units per voxel
uniform highp usampler3D tops;   // bricks: the place of their cells, or EMPTY with the distance to the next marked one
uniform highp usampler2D cells;  // marked bricks, ROW in a row: 64 bits, one a cell

const uint EMPTY = 0x80000000u;
const float HOLE = -1e38;        // codes below stand for no value: NaN may be any number to GLSL

float voxel(ivec3 c) { return float(texelFetch(voxels, c, 0).r); }

// Whether cell c may hold the surface; else [low, low + edge) is a cube of idle cells about it.
// Empty-space skipping by distances: Zuiderveld, Koning and Viergever, "Acceleration of Ray-Casting Using 3-D Distance
// Transforms", 1992.
bool look_up(ivec3 c, out ivec3 low, out int edge) {
  uint top = texelFetch(tops, c >> 2, 0).r;
  low = c;
  edge = 1;
  if ((top & EMPTY) != 0u) {
    int reach = int(top & 255u) - 1;
    low = ((c >> 2) - reach) * BRICK;
    edge = (2 * reach + 1) * BRICK;
    return false;
  }
  uvec2 words = texelFetch(cells, ivec2(int(top) % ROW, int(top) / ROW), 0).rg;
  int bit = bit_of(c);
  if (((half_of(words, bit) >> (bit & 31)) & 1u) == 1u) return true;
  ivec3 even = c & ~1;
  int first = bit_of(even);
  if ((half_of(words, first) & (0x00330033u << (first & 31))) == 0u) {
    low = even;
    edge = 2;
  }
  return false;
}
