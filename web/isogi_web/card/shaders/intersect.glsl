// Rays against the isosurface of the trilinear field. Kernels:
// isogi_core/kernels/tracing/intersect.py (rules), slabs.py (boxes), traversal.py (skipping).
//
// Four rules keep the surface closed: solid means value > isovalue; a cell whose corners agree has
// no surface; the side on which a ray leaves a cell is the side on which it enters the next; a ray
// that starts on a surface is given its side.
#include "volume.glsl"
#include "cubic.glsl"

const float MISS = -1.0;
// Voxels behind the surface at which a ray of unknown side may begin and still count as outside.
const float SKIN = 2e-5;
const float BLUR = 5e-7; // Rounding of a cubic's values, relative to the largest corner value.
// Cells or skips of a ray at most: a volume of 512 cells a side needs no more.
const int STEPS = 2048;

struct Ray { vec3 o, d, inv; };

// A ray with the inverse of its direction; components that vanish are replaced by tiny ones.
Ray ray_of(vec3 o, vec3 d) {
  vec3 safe = mix(d, vec3(1e-20), lessThan(abs(d), vec3(1e-20)));
  return Ray(o, d, 1.0 / safe);
}

// The part (near, far) of the ray, t >= 0, inside the volume's box; empty if near > far.
vec2 clip_box(Ray ray) {
  vec3 a = -ray.o * ray.inv, b = (vec3(size - 1) - ray.o) * ray.inv;
  vec3 first = min(a, b), last = max(a, b);
  return vec2(max(max(max(first.x, first.y), first.z), 0.0), min(min(last.x, last.y), last.z));
}

// The t at which the ray leaves the cube [low, low + edge); c becomes the next cell. The cell
// across an exit face follows from the face, never from a rounded point; `left` marks the axes of
// exit faces.
float leave(Ray ray, ivec3 low, int edge, inout ivec3 c, out bvec3 left) {
  ivec3 ahead = ivec3(step(0.0, ray.d)), high = low + edge - 1;
  vec3 t = (vec3(low + ahead * edge) - ray.o) * ray.inv;
  float nearest = min(min(t.x, t.y), t.z);
  ivec3 there = clamp(ivec3(floor(ray.o + nearest * ray.d)), low, high);
  left = lessThanEqual(t, vec3(nearest));
  c = ivec3(mix(vec3(there), mix(vec3(low - 1), vec3(high + 1), vec3(ahead)), left));
  return nearest;
}

// The side of voxel c; UNKNOWN if it has no value.
float side_of(ivec3 c) {
  float v = voxel(c);
  return v < HOLE ? UNKNOWN : v > isovalue ? SOLID : OUTSIDE;
}

// The first crossing in cell c between t = near and far, or MISS; `side` becomes the side at the
// exit. `entered` and `left` mark the axes of the faces that the ray enters and leaves through:
// there its local coordinates are set to the face, without rounding.
float cross_cell(Ray ray, ivec3 c, float near, float far, bvec3 entered, bvec3 left, inout float side) {
  // Read the corners; a cell with a hole has no surface, and the side behind it is unknown.
  float corners[8], least = 0.0, largest = 0.0;
  for (int k = 0; k < 8; k++) {
    float v = voxel(c + ivec3(k & 1, (k >> 1) & 1, k >> 2));
    corners[k] = v - isovalue;
    least = min(least, v);
    largest = max(largest, abs(corners[k]));
  }
  if (least < HOLE) {
    side = UNKNOWN;
    return MISS;
  }
  float span = far - near;
  vec3 ahead = step(0.0, ray.d), local = ray.o - vec3(c);
  // Restrict the field to the ray: a cubic on t = 0 to 1 between entry and exit.
  vec3 a = mix(clamp(local + near * ray.d, 0.0, 1.0), 1.0 - ahead, entered);
  vec3 b = mix(clamp(local + far * ray.d, 0.0, 1.0), ahead, left);
  vec4 q = cubic_along(corners, a, b - a);
  // Choose the side of a ray that starts here: solid, unless the start lies less than SKIN behind
  // the surface.
  if (side == UNKNOWN) {
    float through = span * max(max(abs(ray.d.x), abs(ray.d.y)), abs(ray.d.z));
    side = q.w * through > SKIN * abs(q.z) ? SOLID : OUTSIDE;
  }
  float t = first_crossing(q, side == SOLID, BLUR * largest);
  if (t >= 0.0) return near + t * span;
  side = ends_solid(q, BLUR * largest) ? SOLID : OUTSIDE;
  return MISS;
}

// The first crossing of the isosurface by the ray o + t d, t >= 0, or MISS. `side` is the side of
// the start, and becomes that on which the ray arrives. Kernel: cast, a word that GLSL reserves.
//
// Places are counted from the point at which the ray enters the box, as single precision is finest
// near 0.
float cast_from(vec3 o, vec3 d, inout float side) {
  Ray ray = ray_of(o, d);
  vec2 part = clip_box(ray);
  if (!(part.x < part.y)) return MISS;
  if (part.x > 0.0) side = UNKNOWN;
  ray.o += part.x * d;
  float t = 0.0, far = part.y - part.x;
  ivec3 last = size - 2, c = clamp(ivec3(floor(ray.o)), ivec3(0), last);
  bool asked = side == UNKNOWN;
  bvec3 entered = bvec3(false), left;
  // Walk from cell to cell, and skip cubes of idle cells.
  for (int i = 0; i < STEPS; i++) {
    ivec3 here = c, low;
    int edge;
    bool marked = look_up(c, low, edge);
    float end = max(t, leave(ray, low, edge, c, left));
    if (end > far) {
      end = far;
      left = bvec3(false);
    }
    if (marked && end > t) {
      // An active cell: look for a crossing.
      float hit = cross_cell(ray, here, t, end, entered, left, side);
      if (hit >= 0.0) return part.x + hit;
    } else if (!marked && asked) {
      float agreed = side_of(here);
      // An idle cell has one side: if it is the other one, rounding lost a surface at the face.
      if (agreed != UNKNOWN && side == -agreed) return part.x + t;
      side = agreed;
    }
    asked = marked || side == UNKNOWN;
    t = end;
    entered = left;
    if (t >= far || any(lessThan(c, ivec3(0))) || any(greaterThan(c, last))) return MISS;
  }
  return MISS;
}

// The first crossing by a ray that starts on a `side`, whichever side it arrives on.
float cast_ray(vec3 o, vec3 d, float side) { return cast_from(o, d, side); }
