// Microfacets: the GGX lobe of a rough mirror and its sampling. Kernel:
// isogi_core/kernels/transport/microfacets.py. Directions have z along the normal.
#include "constants.glsl"
uniform float alpha; // GGX's alpha

const float LEAST_VIEW = 1e-3; // MIN_VIEW_COSINE

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

// (1 - cos)^5 of Schlick's Fresnel term, for facets that mirror v to l.
float grazing(vec3 v, vec3 l) {
  float rest = 1.0 - clamp(dot(v, normalize(v + l)), 0.0, 1.0), square = rest * rest;
  return square * square * rest;
}

// Density of `sample_reflected`, per steradian.
float reflected_pdf(vec3 v, vec3 l) { return seen_from(v.z) * facets_facing(normalize(v + l).z) / (4.0 * v.z); }
