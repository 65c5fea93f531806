// Shine: rays of a microfacet lobe, and the light at their ends, of the surroundings or of the
// surface. Kernels: isogi_core/kernels/transport/microfacets.py and shading/shine.py.
//
// Each ray stands for a solid angle, over which the surroundings are blurred. Source: Krivanek and
// Colbert 2008. Directions are local, with z along the normal, unless they are named w.
#include "lobes.glsl"
uniform float alpha;          // GGX's alpha
uniform vec3 facing;          // reflectance head on
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
uniform float together;       // Rays that the picture is a mean of.

const float LEAST_VIEW = 1e-3; // MIN_VIEW_COSINE

// Tangents of Duff and others 2017 and the unit vector n, as columns.
mat3 frame_about(vec3 n) {
  float side = n.z < 0.0 ? -1.0 : 1.0, a = -1.0 / (side + n.z), b = n.x * n.y * a;
  return mat3(1.0 + side * n.x * n.x * a, side * b, -side * n.x, b, side + n.y * n.y * a, -n.y, n);
}

// Density of facets with normals at a cosine to the surface normal.
float facets_facing(float cosine) {
  float square = alpha * alpha, width = cosine * cosine * (square - 1.0) + 1.0;
  return square / (PI * width * width);
}

// Smith's masking of a direction at a cosine to the normal.
float hidden(float cosine) {
  float square = cosine * cosine;
  return 0.5 * (sqrt(1.0 + alpha * alpha * max(1.0 - square, 0.0) / square) - 1.0);
}

float seen_from(float cosine) { return 1.0 / (1.0 + hidden(cosine)); }

float seen_and_lit(float to_viewer, float to_light) { return 1.0 / (1.0 + hidden(to_viewer) + hidden(to_light)); }

// A point of the unit disc from one of the unit square. Source: Shirley and Chiu 1997.
vec2 sample_disc(vec2 at) {
  vec2 p = 2.0 * at - 1.0;
  bool wide = abs(p.x) > abs(p.y);
  vec2 q = wide ? p : p.yx;
  float angle = q.x != 0.0 ? 0.25 * PI * q.y / q.x : 0.0;
  vec2 found = q.x * vec2(cos(angle), sin(angle));
  return wide ? found : found.yx;
}

// A direction to which a facet visible from v mirrors it, by a point of the unit square; some lie
// below the surface. Source: Heitz 2018.
vec3 sample_reflected(vec3 v, vec2 at) {
  vec3 around = normalize(vec3(alpha * v.xy, v.z));
  float flat_part = length(around.xy);
  vec3 s = flat_part > 0.0 ? vec3(-around.y, around.x, 0.0) / flat_part : vec3(1.0, 0.0, 0.0), t = cross(around, s);
  vec2 p = sample_disc(at);
  float share = 0.5 * (1.0 + around.z);
  p.y = (1.0 - share) * sqrt(max(1.0 - p.x * p.x, 0.0)) + share * p.y;
  vec3 facet = p.x * s + p.y * t + sqrt(max(1.0 - dot(p, p), 0.0)) * around;
  vec3 h = normalize(vec3(alpha * facet.xy, max(facet.z, 1e-12)));
  return 2.0 * dot(v, h) * h - v;
}

// Density of `sample_reflected`, per steradian.
float reflected_pdf(vec3 v, vec3 l) { return seen_from(v.z) * facets_facing(normalize(v + l).z) / (4.0 * v.z); }

// Reflectance head on, with the albedo that is shown.
vec3 facing_shown() { return metal ? facing * albedo : facing; }

// Schlick's Fresnel reflectance of facets that mirror v to l.
vec3 schlick_fresnel(vec3 v, vec3 l) {
  float rest = 1.0 - clamp(dot(v, normalize(v + l)), 0.0, 1.0), square = rest * rest;
  return mix(facing_shown(), vec3(1.0), square * square * rest);
}

// Light of a sampled direction counts as much: the lobe over its density.
vec3 weight_of(vec3 v, vec3 l) { return strength * seen_and_lit(v.z, l.z) / seen_from(v.z) * schlick_fresnel(v, l); }

// Share of diffuse light that the lobe leaves to the eye at a cosine.
vec3 light_below(float cosine) {
  if (metal) return vec3(1.0 - strength);
  int steps = textureSize(energy, 0).x - 1;
  float place = float(steps) * sqrt(clamp(cosine, 0.0, 1.0));
  int k = min(int(place), steps - 1);
  vec2 shares = mix(texelFetch(energy, ivec2(k, 0), 0).rg, texelFetch(energy, ivec2(k + 1, 0), 0).rg, place - float(k));
  return 1.0 - strength * (shares.x * facing_shown() + shares.y);
}

// Radiance of the surroundings along w in the box, as the mean over the solid angle of a ray whose
// direction has this density.
vec3 far_light(vec3 w, float density) {
  vec3 q = w.x * turned[0] + w.y * turned[1] + w.z * turned[2];
  vec2 at = vec2(0.5 * atan(q.y, q.x), atan(length(q.xy), q.z)) / PI;
  // A normal distribution of this width has the solid angle of the ray.
  float width = sqrt(1.0 / (4.0 * PI * together * density));
  float level = log2(max(width * float(textureSize(surroundings, 0).y) / PI, 1.0));
  return brightness * textureLod(surroundings, at, level).rgb;
}
