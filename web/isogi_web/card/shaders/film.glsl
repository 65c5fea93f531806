// From linear light to the colours of a screen. Kernel: isogi_core/kernels/shading/framebuffer.py;
// source of sRGB: IEC 61966-2-1.
uniform vec3 curve;       // gain, toe, shoulder
uniform float exposure;

// The tone curve: y = gain x^2 / (x + toe) up to the shoulder s, and s + (1 - s)(1 - exp(-(y - s) /
// (1 - s))) above.
float tone(float x) {
  float y = curve.x * x * (x / (x + curve.y));
  return y <= curve.z ? y : 1.0 - (1.0 - curve.z) * exp((curve.z - y) / (1.0 - curve.z));
}

// Exposed light, scaled by the tone curve of its largest channel, so that hues are kept.
vec3 toned(vec3 light) {
  float peak = exposure * max(max(light.r, light.g), light.b);
  return peak > 0.0 ? exposure * (tone(peak) / peak) * light : vec3(0.0);
}

// The sRGB transfer function of linear light, 0 to 1.
vec3 srgb(vec3 x) {
  return mix(12.92 * x, 1.055 * pow(max(x, 1e-6), vec3(1.0 / 2.4)) - 0.055, greaterThan(x, vec3(0.0031308)));
}

// The inverse of `tone`, for y below 1.
float untone(float y) {
  // Invert the shoulder, then solve gain x^2 - y x - y toe = 0 for its positive root.
  float s = curve.z, x = y <= s ? y : s - (1.0 - s) * log(1.0 - (y - s) / (1.0 - s));
  return (x + sqrt(x * x + 4.0 * curve.x * x * curve.y)) / (2.0 * curve.x);
}

// The linear light that is shown as this colour.
vec3 untoned(vec3 colour) {
  float peak = min(max(max(colour.r, colour.g), colour.b), 0.999);
  return peak > 0.0 ? untone(peak) / (exposure * peak) * colour : vec3(0.0);
}
