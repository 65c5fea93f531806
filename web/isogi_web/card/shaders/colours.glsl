// Colours by data: the albedo of the surface by a grid of codes of values, or of labels. Kernel:
// isogi_core/kernels/transport/colours.py; layout: web/isogi_web/card/colours.js.
#if COLOURS > 0
uniform highp usampler3D codes; // Codes of values, or two labels and the share of the second.
uniform highp sampler2D albedos; // Albedo of each code.
uniform ivec3 places;       // places along x, y, z
uniform vec3 step_between;  // voxels from one place to the next
uniform vec3 brightest;     // albedo that the light of texels is of

const uint NO_VALUE = 0u, LAST_CODE = 255u;

vec3 albedo_of(uint code) { return texelFetch(albedos, ivec2(int(code), 0), 0).rgb; }

// The codes at the corners of the cell of places at p, in voxels, and their trilinear weights.
void corners_at(vec3 p, out uvec3 found[8], out float weights[8]) {
  vec3 q = p / step_between;
  ivec3 base = clamp(ivec3(floor(q)), ivec3(0), places - 2);
  vec3 f = clamp(q - vec3(base), 0.0, 1.0);
  for (int c = 0; c < 8; c++) {
    ivec3 corner = ivec3(c & 1, (c >> 1) & 1, c >> 2);
    vec3 share = mix(1.0 - f, f, vec3(corner));
    found[c] = texelFetch(codes, base + corner, 0).rgb;
    weights[c] = share.x * share.y * share.z;
  }
}
#endif

#if COLOURS == 1
// Albedo at p by values: codes are interpolated over corners that have a value, and the table
// between two codes; code 0 stands for the rest of the weights.
vec3 albedo_at(vec3 p) {
  uvec3 found[8];
  float weights[8], known = 0.0, total = 0.0;
  corners_at(p, found, weights);
  for (int c = 0; c < 8; c++) {
    if (found[c].r == NO_VALUE) continue;
    known += weights[c];
    total += weights[c] * float(found[c].r);
  }
  float code = known > 0.0 ? total / known : 1.0;
  uint low = clamp(uint(code), 1u, LAST_CODE - 1u);
  vec3 albedo = mix(albedo_of(low), albedo_of(low + 1u), code - float(low));
  return mix(albedo_of(NO_VALUE), albedo, known);
}
#endif

#if COLOURS == 2
const float LABEL_SHARE = 1.0 / 510.0;

// The least label above `after` at the corners, and its trilinear weight; LAST_CODE + 1 if there is
// none.
uint next_label(uvec3 found[8], float weights[8], uint after, out float total) {
  uint least = LAST_CODE + 1u;
  total = 0.0;
  for (int c = 0; c < 8; c++) {
    float second = LABEL_SHARE * float(found[c].z);
    for (int k = 0; k < 2; k++) {
      uint label = found[c][k];
      if (label <= after || label > least) continue;
      // A lower label begins the sum again.
      if (label < least) total = 0.0;
      total += weights[c] * (k == 1 ? second : 1.0 - second);
      least = label;
    }
  }
  return least;
}

// Albedo at p by labels: W sum w^8 c / sum w^8 + (1 - W) c0 over their weights w, W being the sum
// of these.
vec3 albedo_at(vec3 p) {
  uvec3 found[8];
  float weights[8], share, known = 0.0, total = 0.0;
  vec3 sum = vec3(0.0);
  corners_at(p, found, weights);
  uint label = next_label(found, weights, NO_VALUE, share);
  while (label <= LAST_CODE) {
    float squared = share * share, fourth = squared * squared, weight = fourth * fourth;
    sum += weight * albedo_of(label);
    known += share;
    total += weight;
    label = next_label(found, weights, label, share);
  }
  if (!(total > 0.0)) return albedo_of(NO_VALUE);
  return known / total * sum + (1.0 - known) * albedo_of(NO_VALUE);
}
#endif

// Albedo of the surface at p over that of the light of texels.
vec3 tint(vec3 p) {
#if COLOURS > 0
  return albedo_at(p) / brightest;
#else
  return vec3(1.0);
#endif
}

// Albedo of the face of a window at p over that of white paper: labels colour faces.
vec3 face_tint(vec3 p) {
#if COLOURS == 2
  return albedo_at(p) / PAPER;
#else
  return vec3(1.0);
#endif
}
