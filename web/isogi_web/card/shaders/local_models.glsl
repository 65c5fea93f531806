// Local illumination models: Lambert's and Phong's under a key light and ambient light, with a hard
// shadow or fog. Kernel: isogi_core/kernels/shading/local_models.py.
#include "launch.glsl"
// Direction to the key light, its light, and ambient light, both times the albedo.
uniform vec3 key, sun, ambient;
uniform float gloss, exponent; // Strength and exponent of Phong's highlight.
uniform vec3 eye, centre;      // Eye and middle of the volume, in index space.
// Distance from the beginning of the fog to the middle of the volume, and to its end, world units.
uniform vec2 fog;

// Transmittance of fog from the eye to p: exp(-(2 u)^2), u being 0 where it begins and 1 at its end.
float fog_to(vec3 p) {
  // |p - eye| - |centre - eye|, as a product of a sum and a difference: an eye may be so far away
  // that distances have no digits left for the volume.
  vec3 here = (p - eye) * spacing, middle = (centre - eye) * spacing;
  float behind = dot((p - centre) * spacing, here + middle) / (length(here) + length(middle));
  float u = max(behind + fog.x, 0.0) / fog.y;
  return exp(-4.0 * u * u);
}

// Phong's (r.v)^e: the key light mirrored at the normal, against the direction to the eye.
float highlight(vec3 p, vec3 n) {
  vec3 v = normalize((eye - p) * spacing);
  return pow(max(dot(2.0 * dot(n, key) * n - key, v), 0.0), exponent);
}

// Light that leaves the surface at p with normal n.
vec3 local_light(vec3 p, vec3 n) {
  float cosine = dot(n, key), direct = max(cosine, 0.0);
  if (HIGHLIGHT == 1 && cosine > 0.0) direct += gloss * highlight(p, n);
  if (SHADOW == 1 && direct > 0.0 && cast_ray(launch(p, n), key / spacing, facing) >= 0.0)
    direct = 0.0;
  vec3 light = ambient + direct * sun;
  return FOG == 1 ? fog_to(p) * light : light;
}
