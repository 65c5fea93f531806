// Windows: the part of rays that planes leave visible, and the faces that planes cut into solid
// matter. Kernels: isogi_core/kernels/tracing/camera.py, paint_faces of
// isogi_core/frame/framing.py.
const int PLANES = 12;
uniform vec4 window[PLANES]; // In index space: the part with n . p + w >= 0 is visible.
uniform int planes; // Number of planes.
uniform vec2 greys; // Factor and offset that turn a code into a grey.
uniform float paper; // Light of the brightest grey.

const float FAR = 1e30;
const float PAPER = 0.8; // PAPER of isogi_core/frame/framing.py.

// The part (near, far) of the ray o + t d, t >= 0, that the window leaves visible; empty if near >
// far.
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

// True if p lies in the volume's box and above the isovalue; false next to a hole.
bool is_solid(vec3 p) {
  bool within = all(greaterThanEqual(p, vec3(0.0))) && all(lessThanEqual(p, vec3(size - 1)));
  return within && value(p) > isovalue;
}

// Light of a face at p: sRGB greys over the core of the volume's values, evenly lit.
vec3 paint(vec3 p) {
  float code = clamp(greys.x * value(p) + greys.y, 0.0, 1.0);
  return vec3(paper * (code <= 0.04045 ? code / 12.92 : pow((code + 0.055) / 1.055, 2.4)));
}
