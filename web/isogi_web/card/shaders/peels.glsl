// All surfaces along a ray, front to back, until hardly any light is left for those behind. Kernel:
// isogi_core/kernels/tracing/peels.py.
const int LAYERS = 64; // Surfaces on a ray at most; the last of them is an opaque one.
const float LEAST_SHARE = 1.0 / 512.0; // What is behind is left out once less than this passes.

// True if p lies inside of an opaque surface, which a window's face then cuts open.
bool opens(vec3 p) {
  for (int k = 0; k < SURFACES; k++) {
    turn_to(k);
    if (clears[k] <= 0.0 && is_solid(p)) return true;
  }
  return false;
}

// The surface with the nearest crossing at t, or -1; only opaque ones if `opaque`.
int nearest_of(float t[SURFACES], bool opaque) {
  int best = -1;
  for (int k = 0; k < SURFACES; k++) {
    if (t[k] < 0.0 || (opaque && clears[k] > 0.0)) continue;
    if (best < 0 || t[k] < t[best]) best = k;
  }
  return best;
}

// Add the light of a surface of which the ray d meets the side `came` at p: it has the weight in
// the light that is seen.
void add_layer(inout Seen seen, int k, float came, vec3 p, vec3 d, float weight) {
  float lacking;
  stand_on(k, came);
  vec3 light = shade(p, find_normal(p, d), lacking);
#if SHADING == 0
  light *= shares[k];
#endif
  seen.light += weight * light;
  seen.lacking += weight * lacking;
}

// Sample the picture at a place, in pixels from its upper left corner. Its cover is the share of
// light from behind that no surface lets pass.
Seen see(vec2 at) {
  vec3 o, d;
  vec2 part;
  Seen seen = Seen(vec3(0.0), vec3(0.0), vec3(0.0), 0.0, 0.0);
  if (!find_ray(at, o, d, part)) return seen;
  if (part.x > 0.0 && opens(o)) {
    seen.light = paint(o);
    seen.cover = 1.0;
    return seen;
  }
  // Find the first crossing with each surface, and the side that the ray arrives on.
  float t[SURFACES], came[SURFACES], far = part.y - part.x, left = 1.0;
  for (int k = 0; k < SURFACES; k++) {
    turn_to(k);
    float side = UNKNOWN, way = clears[k] < 1.0 ? cast_from(o, d, side) : MISS;
    came[k] = side;
    t[k] = way > far ? MISS : way;
  }
  for (int layer = 0; layer < LAYERS; layer++) {
    int k = nearest_of(t, layer == LAYERS - 1);
    if (k < 0) break;
    // The surface keeps 1 - clear of the light that is left; a small rest is dropped.
    vec3 p = o + t[k] * d;
    add_layer(seen, k, came[k], p, d, left * (1.0 - clears[k]));
    left *= clears[k];
    if (left < LEAST_SHARE) {
      left = 0.0;
      break;
    }
    // Go on to the next crossing with the same surface, on whose other side the ray leaves it.
    float side = -came[k], way = cast_from(p, d, side);
    came[k] = side;
    t[k] = way < 0.0 || t[k] + way > far ? MISS : t[k] + way;
  }
  seen.cover = 1.0 - left;
  return seen;
}
