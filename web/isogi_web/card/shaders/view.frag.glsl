// Draws a sample of a picture: linear light, and in alpha 1 if the surface is seen. Sample 0 is
// taken at the middles of pixels. Later samples move only at edges, which smooths them, and send
// other shadow rays to lobes and other rays of shine everywhere.
#include "view.glsl"
#include "edges.glsl"
uniform bool again; // True for all samples but the first.
uniform vec2 jitter; // Offset of this sample from the middles of pixels.
uniform bool marked; // True if pixels whose texels have no light are hatched.
out vec4 sampled;

const vec3 MARK = vec3(0.95, 0.42, 0.05);    // MARK of isogi_core/frame/film.py

// Light under the broad hatching of a pixel. Kernel: mark of
// isogi_core/kernels/shading/framebuffer.py.
vec3 hatched(vec3 light, ivec2 pixel) {
  float veil = (pixel.x + pixel.y) % 12 < 6 ? 0.55 : 0.15;
  return untoned(mix(toned(light), MARK, veil));
}

void main() {
  // Fragments count rows from below, pictures from above.
  vec2 at = vec2(gl_FragCoord.x, float(drawn.y) - gl_FragCoord.y);
  if (again) {
    // Away from edges another sample shows the same, unless lobes or shine are sampled.
    bool edge = is_edge(ivec2(gl_FragCoord.xy));
    if (!edge && LOBES + SHINE == 0) discard;
    if (edge) at += jitter;
  }
  Seen seen = see(at);
  // Hatch in picture coordinates, as the server does.
  if (marked && seen.lacking > 0.0) seen.light = hatched(seen.light, ivec2(gl_FragCoord.x, float(drawn.y) - gl_FragCoord.y));
  sampled = vec4(min(seen.light, vec3(6e4)), seen.cover);
}
