// Records of light and their noise, as folding writes and filtering changes them.

// Pack a record from direct and reflected light and the word of the normal.
uvec4 record_of(vec3 direct, vec3 reflected, uint word) {
  vec3 d = min(direct, vec3(65504.0)), r = min(reflected, vec3(65504.0));
  return uvec4(packHalf2x16(d.rg), packHalf2x16(vec2(d.b, r.r)), packHalf2x16(r.gb), word);
}

// Pack a texel's standard error, the root of the variance of its luminance, and the logarithm of
// its samples, as halves. The logarithm is 0 without samples, and negative if the texel is not
// filtered.
uint noise_of(float variance, float samples) { return packHalf2x16(vec2(min(sqrt(variance), 65504.0), samples)); }

float luminance(vec3 light) { return dot(light, vec3(0.2126, 0.7152, 0.0722)); }
