// Edges of a picture: pixels that differ from a neighbour. Kernel: isogi_core/kernels/shading/edges.py.
#include "film.glsl"
// Linear light at the middles of pixels; alpha is 1 if the pixel shows the surface.
uniform highp sampler2D first;
uniform ivec2 drawn;              // pixels of the picture

const float LEAST = 12.0 / 255.0; // Difference of neighbours, of 1, that makes an edge.

// The difference of two pixels as a screen shows them, 0 to 1; 1 if only one of them shows the
// surface.
float difference(vec4 one, vec4 other) {
  if ((one.a > 0.0) != (other.a > 0.0)) return 1.0;
  if (one.a == 0.0) return 0.0;
  vec3 apart = abs(srgb(toned(one.rgb)) - srgb(toned(other.rgb)));
  return max(max(apart.r, apart.g), apart.b);
}

// True if a pixel differs from one of its eight neighbours.
bool is_edge(ivec2 pixel) {
  vec4 own = texelFetch(first, pixel, 0);
  for (int k = 0; k < 9; k++) {
    ivec2 beside = clamp(pixel + ivec2(k % 3, k / 3) - 1, ivec2(0), drawn - 1);
    if (difference(own, texelFetch(first, beside, 0)) >= LEAST) return true;
  }
  return false;
}
