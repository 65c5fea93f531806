// Folds the raw transfer of texels with the turned light, a fragment a record: radiance is their dot product (S1, eq. 9).
// Kernels: light_texels of isogi_core/kernels/shading/lattice.py, fill_records of irradiance_ratio.py.
// Without raw transfer, light is taken to keep the irradiance ratio that it had when the server folded it.
#include "irradiance_ratio.glsl"
uniform highp sampler2DArray transfer;    // four numbers a layer: the columns of a channel, then of the next
uniform highp sampler2D turned;           // the light that each number meets, in the plan's unit
uniform bool raw;                         // whether there is raw transfer of these records
uniform vec3 quadric_then[9];             // unshadowed light of the light that the server folded them by
layout(location = 0) out uvec4 folded;

// A record of light, of which some is reflected, with the word of its normal.
uvec4 record_of(vec3 direct, vec3 reflected, uint word) {
  vec3 d = min(direct, vec3(65504.0)), r = min(reflected, vec3(65504.0));
  return uvec4(packHalf2x16(d.rg), packHalf2x16(vec2(d.b, r.r)), packHalf2x16(r.gb), word);
}

// The record of a texel by its raw transfer.
uvec4 fold(ivec2 at, uint word) {
  vec3 light = vec3(0.0), reflected = vec3(0.0);
  for (int i = 0; i < NUMBERS; i += 4) {
    vec4 four = texelFetch(transfer, ivec3(at, i >> 2), 0);
    for (int k = 0; k < 4; k++) {
      vec3 part = i + k < NUMBERS ? four[k] * texelFetch(turned, ivec2(i + k, 0), 0).rgb : vec3(0.0);
      light += part;
      if ((i + k) % COLUMNS >= STRAIGHT) reflected += part;
    }
  }
  light = max(light, 0.0);
  reflected = clamp(reflected, vec3(0.0), light);
  if (WHOLE == 1) reflected = max(reflected, light - unshadowed_light(octahedral(word)));
  return record_of(light - reflected, reflected, word);
}

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  folded = texelFetch(records, at, 0);
  if (folded.w == BURIED || folded.w == VOID) return;
  if (raw) {
    folded = fold(at, folded.w);
    return;
  }
  vec3 m = octahedral(folded.w), change = unshadowed_light(m) / max(unshadowed_by(quadric_then, m), DARKEST);
  vec2 rg = unpackHalf2x16(folded.x), br = unpackHalf2x16(folded.y), gb = unpackHalf2x16(folded.z);
  folded = record_of(change * vec3(rg, br.x), vec3(br.y, gb), folded.w);
}
