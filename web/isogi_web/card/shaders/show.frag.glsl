// Shows a picture of linear light on the screen, enlarged if it has fewer pixels than the screen.
#include "film.glsl"
uniform highp sampler2D picture;
uniform ivec2 drawn;     // pixels of the picture that are drawn
uniform vec2 screen;     // pixels of the screen
uniform vec3 ground;     // linear light behind the surface
out vec4 shown;

void main() {
  vec2 size = vec2(drawn), at = clamp(gl_FragCoord.xy / screen * size, vec2(0.5), size - 0.5);
  // Alpha is the share of samples that met the surface: tone the surface alone, then mix in the
  // ground.
  vec4 mean = texture(picture, at / vec2(textureSize(picture, 0)));
#ifdef SURFACES
  // Surfaces that let light pass show the ground behind, which is a colour of the screen.
  shown = vec4(srgb(min(toned(mean.rgb) + max(1.0 - mean.a, 0.0) * ground, 1.0)), 1.0);
#else
  vec3 surface = toned(mean.rgb / max(mean.a, 1e-6));
  shown = vec4(srgb(min(mix(ground, surface, min(mean.a, 1.0)), 1.0)), 1.0);
#endif
}
