// The light at a place of the picture: a ray from the camera, the surface that it hits, and the
// light that leaves the surface. Kernel: isogi_core/kernels/tracing/camera.py; rays:
// web/isogi_web/card/rays.js.
#include "intersect.glsl"
#include "field.glsl"
#include "sight.glsl"
#include "colours.glsl"
#include "launch.glsl"
#if SHADING == 1
#include "irradiance_ratio.glsl"
#include "lobes.glsl"
#if SHINE == 1
#include "shine.glsl"
#endif
#else
#include "local_models.glsl"
uniform vec3 albedo; // Albedo that is shown, relative to that of the document.
#endif
// Origins of rays, on a plane in front of the box: affine over the picture.
uniform vec3 start, startRight, startDown;
uniform vec3 corner, right, down; // Directions of rays, affine as well.
uniform float unit; // Radiance of 1 in the light of texels.

struct Seen { vec3 light, point, normal; float cover, lacking; };

// Unit normal at p on the side that is seen; if the field is flat there, against the ray d.
vec3 find_normal(vec3 p, vec3 d) {
  vec3 n = normal(p);
  return n == vec3(0.0) ? -normalize(d * spacing) : facing * n;
}

// The ray o + t d at a place of the picture, in pixels from its upper left corner, from where it
// enters what a window leaves; `part` is where it enters and leaves that. False if it misses.
bool find_ray(vec2 at, out vec3 o, out vec3 d, out vec2 part) {
  o = start + at.x * startRight + at.y * startDown;
  d = corner + at.x * right + at.y * down;
  part = look_through(o, d);
  o += part.x * d;
  return part.x <= part.y;
}

#if SHINE == 1
#include "shade_shiny.glsl"
#endif
// Light that leaves the surface at p with normal n.
vec3 shade(vec3 p, vec3 n, out float lacking) {
#if SHADING == 1
  vec3 light = texel_light(p, n, lacking);
  if (LOBES > 0) light += lobe_light(p, n);
  return unit * albedo * tint(p) * light;
#else
  lacking = 0.0;
  return albedo * tint(p) * local_light(p, n);
#endif
}

#ifdef SURFACES
#include "peels.glsl"
#else
// Sample the picture at a place, in pixels from its upper left corner.
Seen see(vec2 at) {
  vec3 o, d;
  vec2 part;
  Seen seen = Seen(vec3(0.0), vec3(0.0), vec3(0.0), 0.0, 0.0);
  if (!find_ray(at, o, d, part)) return seen;
  // If the first point is solid, it is on a face of the window; otherwise look for the surface.
  bool opened = part.x > 0.0 && is_solid(o);
  float t = opened ? 0.0 : cast_ray(o, d, UNKNOWN);
  if (t < 0.0 || part.x + t > part.y) return seen;
  seen.point = o + t * d;
  if (!opened) seen.normal = find_normal(seen.point, d);
  if (opened) seen.light = face_tint(seen.point) * paint(seen.point);
#if SHINE == 1
  else seen.light = shade_shiny(seen.point, seen.normal, d, seen.lacking);
#else
  else seen.light = shade(seen.point, seen.normal, seen.lacking);
#endif
  seen.cover = 1.0;
  return seen;
}
#endif
