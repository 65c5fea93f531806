// Draws a sample of a picture: linear light, and in alpha whether the surface is seen. The first sample is of the pixels'
// middles. The others change places at edges alone, which they make smooth, and draw other rays to lobes everywhere.
#include "view.glsl"
#include "edges.glsl"
uniform bool again;      // whether this is not the first sample
uniform vec2 jitter;     // of this sample from the pixels' middles
uniform bool marked;     // whether what lacks light of its texels is hatched
out vec4 sampled;

const vec3 MARK = vec3(0.95, 0.42, 0.05);    // MARK of isogi_core/frame/film.py

// Light under the broad hatching of a pixel. Kernel: mark of isogi_core/kernels/shading/framebuffer.py.
vec3 hatched(vec3 light, ivec2 pixel) {
  float veil = (pixel.x + pixel.y) % 12 < 6 ? 0.55 : 0.15;
  return untoned(mix(toned(light), MARK, veil));
}

void main() {
  vec2 at = vec2(gl_FragCoord.x, float(drawn.y) - gl_FragCoord.y);
  if (again) {
    bool edge = is_edge(ivec2(gl_FragCoord.xy));
    if (!edge && LOBES == 0) discard;
    if (edge) at += jitter;
  }
  Seen seen = see(at);
  if (marked && seen.lacking > 0.0) seen.light = hatched(seen.light, ivec2(gl_FragCoord.x, float(drawn.y) - gl_FragCoord.y));
  sampled = vec4(min(seen.light, vec3(6e4)), seen.cover);
}
