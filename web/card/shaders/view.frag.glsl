// Draws a sample of a picture: linear light, and in alpha whether the surface is seen. The first sample is of the pixels'
// middles. The others change places at edges alone, which they make smooth, and draw other rays to lobes everywhere.
#include "view.glsl"
#include "edges.glsl"
uniform bool again;      // whether this is not the first sample
uniform vec2 jitter;     // of this sample from the pixels' middles
out vec4 sampled;

void main() {
  vec2 at = vec2(gl_FragCoord.x, float(drawn.y) - gl_FragCoord.y);
  if (again) {
    bool edge = is_edge(ivec2(gl_FragCoord.xy));
    if (!edge && LOBES == 0) discard;
    if (edge) at += jitter;
  }
  Seen seen = see(at);
  sampled = vec4(min(seen.light, vec3(6e4)), seen.cover);
}
