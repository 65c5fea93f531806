// Direct light of lobes: small distant lights, each sampled by shadow rays. Kernel:
// isogi_core/kernels/shading/lobes.py.
#include "constants.glsl"
#include "launch.glsl"
uniform vec3 towards[LOBES + 1]; // Unit vectors to the middles, in the box.
uniform vec3 east[LOBES + 1]; // Radii of a lobe's disc, as long as the sine of its half angle.
uniform vec3 north[LOBES + 1];
uniform vec3 shine[LOBES + 1]; // Light at a cosine of 1.
// Point of all discs that this sample's rays go to, in radii; (0, 0) is the middle.
uniform vec2 place;
uniform bool resting; // True if this picture is one sample of many, spread over the discs.

const float SHARP = 0.00436331; // Sine of a quarter of a degree: smaller lobes are points.

// E of a lobe whose half angle has the sine s, relative to that from straight above, if only the
// horizon hides it: the mean cosine over a flat disc of radius s, with 0 below the horizon.
float irradiance(float cosine, float s) {
  if (cosine >= s) return cosine;
  float x = max(cosine / s, -1.0), root = sqrt(1.0 - x * x);
  return s / PI * (x * (0.5 * PI + x * root + asin(x)) + 2.0 / 3.0 * root * root * root);
}

// Direction to the middle of the part of lobe k above the horizon of n, and the light that it
// brings unless something blocks it.
vec3 way_to_middle(int k, vec3 n, out float brought) {
  float cosine = dot(n, towards[k]), s = length(east[k]);
  if (s <= SHARP) s = 0.0;
  brought = cosine <= -s ? 0.0 : irradiance(cosine, s);
  return towards[k] + 0.5 * max(s - cosine, 0.0) * n;
}

// Direction to the sampled point of lobe k's disc, and the light that it brings unless something
// blocks it: a sample of the mean over the disc.
vec3 way_to_disc(int k, vec3 n, out float brought) {
  vec3 across = place.x * east[k] + place.y * north[k];
  float up = sqrt(max(1.0 - dot(across, across), 0.0));
  vec3 w = across + up * towards[k];
  brought = max(dot(n, w), 0.0) / up;
  return w;
}

// E / pi from all lobes at p with normal n.
vec3 lobe_light(vec3 p, vec3 n) {
  vec3 start = launch(p, n), light = vec3(0.0);
  for (int k = 0; k < LOBES; k++) {
    float brought;
    vec3 w = resting ? way_to_disc(k, n, brought) : way_to_middle(k, n, brought);
    if (brought > 0.0 && cast_ray(start, w / spacing, OUTSIDE) < 0.0) light += brought * shine[k];
  }
  return light;
}
