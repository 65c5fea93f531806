// The field along a ray through a cell: a cubic in t, its turning points and its first crossing of
// 0. Kernel: isogi_core/kernels/tracing/intersect.py. The interval is split at the roots of the
// slope; the first part with a change of sign brackets the crossing, which is then refined.
const int REFINEMENTS = 12; // Steps of Newton's method at most: single precision needs no more.
const float CLOSE = 1e-7; // Newton's method ends with a step below this.

// Coefficients (A, B, C, D) of f(t) = A t^3 + B t^2 + C t + D along a + t d in the unit cell; c
// holds the values at corners, x first.
vec4 cubic_along(float c[8], vec3 a, vec3 d) {
  // Expand the trilinear value into monomials of x, y, z, and insert a + t d.
  float x = c[1] - c[0], y = c[2] - c[0], z = c[4] - c[0];
  float xy = c[3] - c[2] - x, xz = c[5] - c[4] - x, yz = c[6] - c[4] - y;
  float xyz = c[7] - c[6] - c[5] + c[4] - (c[3] - c[2] - c[1] + c[0]);
  float dxy = d.x * d.y, dxz = d.x * d.z, dyz = d.y * d.z;
  float A = xyz * dxy * d.z;
  float B = xy * dxy + xz * dxz + yz * dyz + xyz * (a.x * dyz + a.y * dxz + a.z * dxy);
  float C = (x + xy * a.y + xz * a.z + xyz * a.y * a.z) * d.x;
  C += (y + xy * a.x + yz * a.z + xyz * a.x * a.z) * d.y;
  C += (z + xz * a.x + yz * a.y + xyz * a.x * a.y) * d.z;
  float D = c[0] + x * a.x + (y + xy * a.x) * a.y + (z + xz * a.x + (yz + xyz * a.x) * a.y) * a.z;
  return vec4(A, B, C, D);
}

// The value of the cubic at t.
float horner(vec4 q, float t) { return ((q.x * t + q.y) * t + q.z) * t + q.w; }

// The roots of the slope 3A t^2 + 2B t + C, ascending and clamped to [0, 1]; (1, 1) if it has none.
// The stable quadratic formula avoids cancellation, and covers A = 0 and A = B = 0 as well.
vec2 turning_points(vec4 q) {
  float a = 3.0 * q.x, b = q.y, c = q.z, disc = b * b - a * c;
  if (!(disc > 0.0)) return vec2(1.0);
  float s = -(b + (b < 0.0 ? -1.0 : 1.0) * sqrt(disc));
  float r1 = a != 0.0 ? clamp(s / a, 0.0, 1.0) : 1.0, r2 = s != 0.0 ? clamp(c / s, 0.0, 1.0) : 1.0;
  return vec2(min(r1, r2), max(r1, r2));
}

// The crossing in [lo, hi], in which the cubic is monotone and leaves the side `solid`. Newton's
// method starts at the root of the chord, and bisects if a step leaves the bracket.
float refine(vec4 q, float lo, float hi, bool solid) {
  float first = horner(q, lo), last = horner(q, hi);
  float t = first != last ? lo + (hi - lo) * first / (first - last) : lo;
  if (!(lo < t && t < hi)) t = 0.5 * (lo + hi);
  for (int i = 0; i < REFINEMENTS; i++) {
    float f = horner(q, t), slope = (3.0 * q.x * t + 2.0 * q.y) * t + q.z;
    if ((f > 0.0) == solid) lo = t; else hi = t;
    float following = slope != 0.0 ? t - f / slope : lo - 1.0;
    if (!(lo <= following && following <= hi)) following = 0.5 * (lo + hi);
    float moved = abs(following - t);
    t = following;
    if (moved < CLOSE) break;
  }
  return t;
}

// True if the cubic is above 0 at t = 1 by more than rounding.
bool ends_solid(vec4 q, float blur) { return q.x + q.y + q.z + q.w > blur; }

// True if f lies on the side opposite to `solid` by more than `blur`.
bool beyond(float f, bool solid, float blur) { return (solid ? -f : f) > blur; }

// The smallest t in [0, 1] at which the cubic leaves the side `solid`; -1 if it never does. A cubic
// that turns within `blur` of 0 only touches the surface, and keeps its side.
float first_crossing(vec4 q, bool solid, float blur) {
  bool across = ends_solid(q, blur) != solid;
  // The curve lies in the hull of its Bezier points: if all agree, there is no crossing.
  float b1 = q.w + q.z / 3.0, b2 = q.w + (2.0 * q.z + q.y) / 3.0;
  if (!across && (b1 > 0.0) == solid && (b2 > 0.0) == solid) return -1.0;
  // Search the monotone parts between 0, the turning points and 1, in this order.
  vec2 r = turning_points(q);
  float after = r.x > 0.0 ? r.x : 0.0;
  if (r.x > 0.0 && beyond(horner(q, r.x), solid, blur)) return refine(q, 0.0, r.x, solid);
  if (r.y > after && beyond(horner(q, r.y), solid, blur)) return refine(q, after, r.y, solid);
  return across ? refine(q, max(r.y > after && r.y < 1.0 ? r.y : after, 0.0), 1.0, solid) : -1.0;
}
