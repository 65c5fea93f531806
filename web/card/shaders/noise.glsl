// Records of light and how noisy each is, as folding writes them and filtering changes them.

// A record of light, of which some is reflected, with the word of its normal.
uvec4 record_of(vec3 direct, vec3 reflected, uint word) {
  vec3 d = min(direct, vec3(65504.0)), r = min(reflected, vec3(65504.0));
  return uvec4(packHalf2x16(d.rg), packHalf2x16(vec2(d.b, r.r)), packHalf2x16(r.gb), word);
}

// The word of a texel's variance of luminance and of its samples' logarithm, 0 where it has none and negative where it is
// not filtered: as halves, of which the first is the standard error.
uint noise_of(float variance, float samples) { return packHalf2x16(vec2(min(sqrt(variance), 65504.0), samples)); }

float luminance(vec3 light) { return dot(light, vec3(0.2126, 0.7152, 0.0722)); }
