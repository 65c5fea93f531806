// Windows: what planes leave to the eye, and the faces that they open in what is solid.
// Kernels: isogi_core/kernels/tracing/camera.py, paint_faces of isogi_core/frame/framing.py.
const int PLANES = 12;
uniform vec4 window[PLANES];    // in index space: n . p + w >= 0 is left to see
uniform int planes;             // how many there are
uniform vec2 greys;             // the grey of a code is x times it, plus y
uniform float paper;            // what the greatest value reflects

const float FAR = 1e30;

// Part (near, far) of the ray o + t d, t >= 0, that the window leaves to see; empty where near > far.
vec2 look_through(vec3 o, vec3 d) {
  vec2 part = vec2(0.0, FAR);
  for (int k = 0; k < planes; k++) {
    float height = dot(window[k].xyz, o) + window[k].w, slope = dot(window[k].xyz, d);
    if (slope > 0.0) part.x = max(part.x, -height / slope);
    else if (slope < 0.0) part.y = min(part.y, -height / slope);
    else if (height < 0.0) part.y = -1.0;
  }
  return part;
}

// Whether p is in the volume's box, and above the isovalue there; never beside a hole.
bool is_solid(vec3 p) {
  bool within = all(greaterThanEqual(p, vec3(0.0))) && all(lessThanEqual(p, vec3(size - 1)));
  return within && value(p) > isovalue;
}

// The light of a face at p: greys over the core of the volume's values, evenly lit.
vec3 paint(vec3 p) {
  float code = clamp(greys.x * value(p) + greys.y, 0.0, 1.0);
  return vec3(paper * (code <= 0.04045 ? code / 12.92 : pow((code + 0.055) / 1.055, 2.4)));
}
