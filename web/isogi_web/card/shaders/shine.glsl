// Shine: rays of a microfacet lobe, and the light at their ends, of the surroundings or of the
// surface. Kernel: isogi_core/kernels/shading/shine.py.
//
// Each ray stands for a solid angle, over which the surroundings are blurred. Source: Krivanek and
// Colbert 2008.
#include "microfacets.glsl"
uniform vec3 head_on;         // reflectance head on
uniform float strength;       // factor of the lobe
uniform bool metal;           // True if the lobe takes the place of diffuse light.
uniform highp sampler2D energy; // Two shares of even light that the lobe mirrors, by the cosine.
// Light from far away over its brightness, lat-long. Each level is blurred by the height of its
// pixels, except the first one.
uniform highp sampler2D surroundings;
uniform float brightness;
uniform vec3 turned[3];       // rows of the light's rotation in the box
uniform int strata;           // Rays along each side of the square that maps to the lobe.
uniform vec2 spot;            // Place of this sample's rays in their strata, 0 to 1.
uniform int first_ray;        // Number of the first ray of this sample.
uniform float together;       // Rays among which the lobe is divided.
uniform vec3 reflecting;      // albedo of the surface
// Share of the facets that are steepest, for which no ray stands: they mirror the surroundings
// about all rays.
uniform float tail;

const int LONGEST = 3; // Rays of a path at most, the one of the lobe included.
// Widths in alpha of two normal distributions, and the share of the second, by which steep facets
// mirror: a fit to GGX on the flat, for the steepest two fifths of the facets.
const vec2 STEEP = vec2(3.0, 8.0);
const float STEEPEST = 0.15;

// Tangents of Duff and others 2017 and the unit vector n, as columns.
mat3 frame_about(vec3 n) {
  float side = n.z < 0.0 ? -1.0 : 1.0, a = -1.0 / (side + n.z), b = n.x * n.y * a;
  return mat3(1.0 + side * n.x * n.x * a, side * b, -side * n.x, b, side + n.y * n.y * a, -n.y, n);
}

// The place of ray k of this sample in the square that maps to the lobe.
vec2 place_of(int k) {
  vec2 at = (vec2(k % strata, k / strata) + spot) / float(strata);
  return mix(at, vec2(0.5), 1.0 - sqrt(1.0 - tail));
}

// Reflectance head on, with the albedo that is shown.
vec3 head_on_shown() { return metal ? head_on * albedo : head_on; }

// Schlick's Fresnel reflectance of facets that mirror v to l.
vec3 schlick_fresnel(vec3 v, vec3 l) { return mix(head_on_shown(), vec3(1.0), grazing(v, l)); }

// Light of a sampled direction l counts as much: the lobe over its density.
vec3 weight_of(vec3 v, vec3 l) { return strength * seen_and_lit(v.z, l.z) / seen_from(v.z) * schlick_fresnel(v, l); }

// Share of even light that the lobe mirrors to the eye at a cosine.
vec3 energy_at(float cosine) {
  int steps = textureSize(energy, 0).x - 1;
  float place = float(steps) * sqrt(clamp(cosine, 0.0, 1.0));
  int k = min(int(place), steps - 1);
  vec2 shares = mix(texelFetch(energy, ivec2(k, 0), 0).rg, texelFetch(energy, ivec2(k + 1, 0), 0).rg, place - float(k));
  return strength * (shares.x * head_on_shown() + shares.y);
}

// Share of diffuse light that the lobe leaves to the eye at a cosine.
vec3 light_below(float cosine) { return metal ? vec3(1.0 - strength) : 1.0 - energy_at(cosine); }

// Factor of the rays of a moving view towards v: few rays then mirror as much of even light as the
// lobe does, of which a larger share is below the horizon than of them.
vec3 kept_energy(vec3 v) {
  if (resting) return vec3(1.0);
  vec3 sum = vec3(0.0);
  for (int k = 0; k < strata * strata; k++) {
    vec3 l = sample_reflected(v, place_of(k));
    if (l.z > 0.0) sum += weight_of(v, l);
  }
  return float(strata * strata) * energy_at(v.z) / max(sum, 1e-6);
}

// Direction of a path's next ray about the normal n, by the cosine, and its density. Source of the
// points: Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences", 2018.
vec3 scatter(vec3 n, int k, int step, out float density) {
  int number = (first_ray + k) * LONGEST + step;
  vec2 p = sample_disc(fract(0.5 + float(number) * vec2(0.7548776662, 0.5698402910)));
  float up = sqrt(max(1.0 - dot(p, p), 1e-6));
  density = up / PI;
  return frame_about(n) * vec3(p, up);
}

// Radiance of the surroundings along w in the box, blurred by this width.
vec3 far_light(vec3 w, float width) {
  vec3 q = w.x * turned[0] + w.y * turned[1] + w.z * turned[2];
  vec2 at = vec2(0.5 * atan(q.y, q.x), atan(length(q.xy), q.z)) / PI;
  float level = log2(max(width * float(textureSize(surroundings, 0).y) / PI, 1.0));
  return brightness * textureLod(surroundings, at, level).rgb;
}

// The width of a normal distribution with the solid angle of a ray whose direction has this
// density.
float width_of(float density) { return sqrt(1.0 / (4.0 * PI * together * density)); }

// Radiance of the surroundings for a ray of the lobe along w: the mean over its solid angle, and
// that of steep facets.
vec3 mirrored_light(vec3 w, float density) {
  vec3 steep = mix(far_light(w, STEEP.x * alpha), far_light(w, STEEP.y * alpha), STEEPEST);
  return mix(far_light(w, sqrt(1.0 - tail) * width_of(density)), steep, tail);
}
