// What a place of the picture shows: a ray from the camera, the surface that it meets, and the light that leaves it.
// Kernels: isogi_core/kernels/tracing/camera.py, isogi_core/kernels/shading/local_models.py; rays: web/card/rays.js.
#include "intersect.glsl"
#include "field.glsl"
#include "sight.glsl"
#if SHADING == 1
#include "irradiance_ratio.glsl"
#include "lobes.glsl"
#endif
uniform vec3 start, startRight, startDown;    // where rays start: a plane before the box, affine over the picture
uniform vec3 corner, right, down;             // which way they go
uniform vec3 key, sun, ambient;               // Lambert: towards the light, and its light and the rest, times the albedo
uniform float unit;                           // the radiance that the light of texels is counted in

struct Seen { vec3 light, point, normal; float cover, lacking; };

// Outward unit normal at p; towards the eye, against the ray d, where the field is flat.
vec3 find_normal(vec3 p, vec3 d) {
  vec3 n = normal(p);
  return n == vec3(0.0) ? -normalize(d * spacing) : n;
}

// The light that leaves the surface at p.
vec3 shade(vec3 p, vec3 n, out float lacking) {
#if SHADING == 1
  vec3 light = texel_light(p, n, lacking);
  if (LOBES > 0) light += lobe_light(p, n);
  return unit * albedo * light;
#else
  lacking = 0.0;
  return ambient + max(dot(n, key), 0.0) * sun;
#endif
}

// What the picture shows at a place, in pixels from its upper left corner.
Seen see(vec2 at) {
  vec3 o = start + at.x * startRight + at.y * startDown, d = corner + at.x * right + at.y * down;
  vec2 part = look_through(o, d);
  Seen seen = Seen(vec3(0.0), vec3(0.0), vec3(0.0), 0.0, 0.0);
  if (part.x > part.y) return seen;
  o += part.x * d;
  bool opened = part.x > 0.0 && is_solid(o);
  float t = opened ? 0.0 : cast_ray(o, d, UNKNOWN);
  if (t < 0.0 || part.x + t > part.y) return seen;
  seen.point = o + t * d;
  if (!opened) seen.normal = find_normal(seen.point, d);
  seen.light = opened ? paint(seen.point) : shade(seen.point, seen.normal, seen.lacking);
  seen.cover = 1.0;
  return seen;
}
