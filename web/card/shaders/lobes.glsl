// Light straight from lobes: small far lights, each seen along shadow rays. Kernel: isogi_core/kernels/shading/lobes.py.
uniform vec3 towards[LOBES + 1];    // unit, in the box
uniform vec3 east[LOBES + 1];       // radii of a lobe's disc, as long as the sine of its half angle
uniform vec3 north[LOBES + 1];
uniform vec3 shine[LOBES + 1];      // light of a cosine of 1
uniform vec2 place;                 // of this picture's rays on all discs, in radii; (0, 0) is the middle
uniform bool resting;               // whether the rays of this picture are one sample of many, all over the discs
uniform float offset;               // voxels along the normal from which rays start

const float PI = 3.14159265358979;
const float SHARP = 0.00436331;     // sine of a quarter of a degree: lobes up to there are seen along one ray

// Where a ray starts that leaves the surface at p; p itself where that place is solid, in a crease or in noise.
// Kernel: launch of isogi_core/kernels/transport/integrator.py.
vec3 launch(vec3 p, vec3 n) {
  vec3 rise = n / spacing, start = p + offset * rise / length(rise);
  bool within = all(greaterThanEqual(start, vec3(0.0))) && all(lessThanEqual(start, vec3(size - 1)));
  return within && value(start) > isovalue ? p : start;
}

// E of a lobe whose half angle has the sine s over that from straight above, where only the horizon hides it:
// the mean cosine over a flat disc of radius s, what is below the horizon being 0.
float irradiance(float cosine, float s) {
  if (cosine >= s) return cosine;
  float x = max(cosine / s, -1.0), root = sqrt(1.0 - x * x);
  return s / PI * (x * (0.5 * PI + x * root + asin(x)) + 2.0 / 3.0 * root * root * root);
}

// The way to the middle of what of lobe k is above the horizon of n, and what it brings where it is free.
vec3 way_to_middle(int k, vec3 n, out float brought) {
  float cosine = dot(n, towards[k]), s = length(east[k]);
  if (s <= SHARP) s = 0.0;
  brought = cosine <= -s ? 0.0 : irradiance(cosine, s);
  return towards[k] + 0.5 * max(s - cosine, 0.0) * n;
}

// The way to a place of lobe k's disc, and what it brings where it is free: a part of the mean over all places.
vec3 way_to_disc(int k, vec3 n, out float brought) {
  vec3 across = place.x * east[k] + place.y * north[k];
  float up = sqrt(max(1.0 - dot(across, across), 0.0));
  vec3 w = across + up * towards[k];
  brought = max(dot(n, w), 0.0) / up;
  return w;
}

// E / pi straight from all lobes at p of normal n.
vec3 lobe_light(vec3 p, vec3 n) {
  vec3 start = launch(p, n), light = vec3(0.0);
  for (int k = 0; k < LOBES; k++) {
    float brought;
    vec3 w = resting ? way_to_disc(k, n, brought) : way_to_middle(k, n, brought);
    if (brought > 0.0 && cast_ray(start, w / spacing, OUTSIDE) < 0.0) light += brought * shine[k];
  }
  return light;
}
