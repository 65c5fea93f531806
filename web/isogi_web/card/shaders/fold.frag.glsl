// Folds raw transfer of texels with the rotated light, one fragment per record: radiance is their
// dot product (S1, eq. 9). Kernels: light_texels of isogi_core/kernels/shading/lattice.py,
// fill_records of irradiance_ratio.py. Without raw transfer, a texel is taken to keep the
// irradiance ratio that it had when the server folded it.
#include "irradiance_ratio.glsl"
#include "noise.glsl"
// Four numbers a layer: the columns of one channel, then of the next, then the logarithms of
// scatter and samples.
uniform highp sampler2DArray transfer;
// The light that each number is multiplied with, in the plan's unit, and in alpha its luminance
// squared.
uniform highp sampler2D turned;
uniform int firsts[TERMS]; // Number of the green channel with which each term begins.
uniform bool raw; // True if these records have raw transfer.
// Unshadowed light under the rotation by which the server folded the records.
uniform vec3 quadric_then[9];
layout(location = 0) out uvec4 folded;
layout(location = 1) out uint noise;

// Variance that paths are taken to have at least, as a share of their second moment.
const float LEAST_SPREAD = 0.2;

// Number k of a texel's raw transfer.
float number_at(ivec2 at, int k) { return texelFetch(transfer, ivec3(at, k >> 2), 0)[k & 3]; }

// The variance of the luminance of one path, from the means of all paths and of their squares.
float spread(ivec2 at, float mean, float second) {
  float even = 0.0;
  for (int k = 0; k < TERMS; k++) even += max(number_at(at, firsts[k]) * texelFetch(turned, ivec2(firsts[k], 0), 0).a, 0.0);
  return max(second - mean * mean, 0.0) + LEAST_SPREAD * even;
}

// The record of a texel from its raw transfer, and its noise.
uvec4 fold(ivec2 at, uint word, out uint noise) {
  // Multiply four numbers of a layer at a time. Columns from STRAIGHT on carry reflected light.
  vec4 sums = vec4(0.0);
  vec3 reflected = vec3(0.0);
  for (int i = 0; i < NUMBERS; i += 4) {
    vec4 four = texelFetch(transfer, ivec3(at, i >> 2), 0);
    for (int k = 0; k < 4; k++) {
      vec4 part = i + k < NUMBERS ? four[k] * texelFetch(turned, ivec2(i + k, 0), 0) : vec4(0.0);
      sums += part;
      if ((i + k) % COLUMNS >= STRAIGHT) reflected += part.rgb;
    }
  }
  // The variance of the mean over paths: that of one path, scaled by the squared scatter.
  float scatter = exp2(number_at(at, NUMBERS));
  noise = noise_of(scatter * scatter * spread(at, luminance(sums.rgb), sums.a), number_at(at, NUMBERS + 1));
  vec3 light = max(sums.rgb, 0.0);
  reflected = clamp(reflected, vec3(0.0), light);
  // The plan keeps direct and reflected light in one sum: what exceeds unshadowed light must be
  // reflected.
  if (WHOLE == 1) reflected = max(reflected, light - unshadowed_light(octahedral(word)));
  return record_of(light - reflected, reflected, word);
}

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  folded = texelFetch(records, at, 0);
  noise = 0u;
  if (folded.w == BURIED || folded.w == VOID) return;
  if (raw) {
    folded = fold(at, folded.w, noise);
    return;
  }
  // Scale direct light by the change of unshadowed light, and keep reflected light.
  vec3 m = octahedral(folded.w), change = unshadowed_light(m) / max(unshadowed_by(quadric_then, m), DARKEST);
  vec2 rg = unpackHalf2x16(folded.x), br = unpackHalf2x16(folded.y), gb = unpackHalf2x16(folded.z);
  folded = record_of(change * vec3(rg, br.x), vec3(br.y, gb), folded.w);
}
