// From linear light to a screen. Kernel: isogi_core/kernels/shading/framebuffer.py; source of sRGB: IEC 61966-2-1.
uniform vec3 curve;       // gain, toe, shoulder
uniform float exposure;

// The tone curve: y = gain x^2 / (x + toe) up to the shoulder s, then s + (1 - s)(1 - exp(-(y - s) / (1 - s))).
float tone(float x) {
  float y = curve.x * x * (x / (x + curve.y));
  return y <= curve.z ? y : 1.0 - (1.0 - curve.z) * exp((curve.z - y) / (1.0 - curve.z));
}

// Light times the exposure, through the tone curve on its largest channel, so that hues stay.
vec3 toned(vec3 light) {
  float peak = exposure * max(max(light.r, light.g), light.b);
  return peak > 0.0 ? exposure * (tone(peak) / peak) * light : vec3(0.0);
}

// The sRGB transfer function of linear light from 0 to 1.
vec3 srgb(vec3 x) {
  return mix(12.92 * x, 1.055 * pow(max(x, 1e-6), vec3(1.0 / 2.4)) - 0.055, greaterThan(x, vec3(0.0031308)));
}

// What the curve takes to y, below 1.
float untone(float y) {
  float s = curve.z, x = y <= s ? y : s - (1.0 - s) * log(1.0 - (y - s) / (1.0 - s));
  return (x + sqrt(x * x + 4.0 * curve.x * x * curve.y)) / (2.0 * curve.x);
}

// The light that the curve shows as this colour.
vec3 untoned(vec3 colour) {
  float peak = min(max(max(colour.r, colour.g), colour.b), 0.999);
  return peak > 0.0 ? untone(peak) / (exposure * peak) * colour : vec3(0.0);
}
