// The shares of even light that a lobe mirrors, F0 x + y, one fragment for each view; fragment k of
// n + 1 is at the cosine (k / n)^2. Kernel: mean_energy of
// isogi_core/kernels/transport/microfacets.py.
#include "microfacets.glsl"
uniform int steps; // Fragments less one.
out vec4 energy;

const int GRID = 40; // Facets along each side of the square over which an entry is a mean.

// A place in [0, 1], denser towards both ends, and its weight.
vec2 towards_ends(int k) {
  float t = (float(k) + 0.5) / float(GRID);
  return t * vec2(t * (3.0 - 2.0 * t), 6.0 * (1.0 - t));
}

void main() {
  float place = floor(gl_FragCoord.x) / float(steps), cosine = max(place * place, LEAST_VIEW), total = 0.0;
  vec3 v = vec3(sqrt(1.0 - cosine * cosine), 0.0, cosine);
  vec2 sum = vec2(0.0);
  for (int i = 0; i < GRID * GRID; i++) {
    vec2 x = towards_ends(i % GRID), y = towards_ends(i / GRID);
    vec3 l = sample_reflected(v, vec2(x.x, y.x));
    float weight = x.y * y.y, edge = grazing(v, l);
    total += weight;
    if (l.z > 0.0) sum += weight * seen_and_lit(v.z, l.z) / seen_from(v.z) * vec2(1.0 - edge, edge);
  }
  energy = vec4(sum / total, 0.0, 1.0);
}
