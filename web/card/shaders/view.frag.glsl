// Draws a picture of linear light: what its pixels' samples show, and in alpha how much of them the surface covers.
#include "view.glsl"
uniform float rows;      // of the picture
uniform vec2 jitter;     // of this sample from the pixels' middles
out vec4 sampled;

void main() {
  Seen seen = see(vec2(gl_FragCoord.x, rows - gl_FragCoord.y) + jitter);
  sampled = vec4(min(seen.light, vec3(6e4)), seen.cover);
}
