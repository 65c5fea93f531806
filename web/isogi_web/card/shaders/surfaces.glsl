// The surface that rays meet, and the side of it that is lit. A scene with one surface has uniforms
// and constants here; among several, `turn_to` and `stand_on` choose. Layout:
// web/isogi_web/card/surfaces.js.
const float OUTSIDE = 1.0, SOLID = -1.0, UNKNOWN = 0.0;
#ifndef SURFACES
uniform float isovalue;             // as a code
uniform vec3 quadric[9];            // unshadowed light over 1, y, z, x, xy, yz, z^2, xz, x^2 - y^2
uniform vec3 least;                 // Lower bound of unshadowed light.
const int map_layer = 0;            // First layer of `tops`.
const int light_layer = 0;          // First layer of `bricks`.
const float facing = OUTSIDE;       // The side that is lit.
#else
uniform float isovalues[SURFACES];  // as codes
uniform float clears[SURFACES];     // Share of rays that pass; 1 if a surface is not seen.
uniform vec3 shares[SURFACES];      // Albedo over that of local models.
uniform vec3 skies[18 * SURFACES];  // `quadric` of the outer and of the inner side of each surface
uniform vec3 darkest[2 * SURFACES]; // `least` of these sides
uniform int map_layers, light_layers; // Layers of `tops` for a surface, and of `bricks` for a side.
float isovalue, facing;
vec3 quadric[9], least;
int map_layer, light_layer;

// Have rays meet surface k.
void turn_to(int k) {
  isovalue = isovalues[k];
  map_layer = k * map_layers;
}

// Light the outer or the inner side of surface k.
void stand_on(int k, float which) {
  int side = 2 * k + int(which == SOLID);
  turn_to(k);
  facing = which;
  light_layer = side * light_layers;
  least = darkest[side];
  for (int i = 0; i < 9; i++) quadric[i] = skies[9 * side + i];
}
#endif
