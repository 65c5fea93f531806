// Values, gradients and normals of the trilinear field. Kernel:
// isogi_core/kernels/tracing/field.py.

// Index of the cell that holds p; points on the volume's last faces belong to the last cells.
ivec3 clamp_cell(vec3 p) { return clamp(ivec3(floor(p)), ivec3(0), size - 2); }

// The eight corner values of cell c.
void cube(ivec3 c, out float v[8]) {
  for (int k = 0; k < 8; k++) v[k] = voxel(c + ivec3(k & 1, (k >> 1) & 1, k >> 2));
}

// Trilinear value at p. Source: S1, section 4.1.
float value(vec3 p) {
  ivec3 c = clamp_cell(p);
  vec3 f = p - vec3(c);
  float v[8];
  cube(c, v);
  vec4 along = mix(vec4(v[0], v[2], v[4], v[6]), vec4(v[1], v[3], v[5], v[7]), f.x);
  vec2 across = mix(along.xz, along.yw, f.y);
  return mix(across.x, across.y, f.z);
}

// Gradient of the trilinear field at p, per voxel step. Source: S1, figure 5, 'gradient'.
vec3 gradient(vec3 p) {
  ivec3 c = clamp_cell(p);
  vec3 f = p - vec3(c);
  float v[8];
  cube(c, v);
  vec4 low = vec4(v[0], v[2], v[4], v[6]), rise = vec4(v[1], v[3], v[5], v[7]) - low, along = low + f.x * rise;
  vec2 slope = mix(rise.xz, rise.yw, f.y), across = mix(along.xz, along.yw, f.y), lift = along.yw - along.xz;
  return vec3(mix(slope.x, slope.y, f.z), mix(lift.x, lift.y, f.z), across.y - across.x);
}

// The four weights of the cubic B-spline at fraction f, of voxels -1, 0, 1, 2.
vec4 bspline(float f) {
  float g = 1.0 - f;
  return vec4(g * g * g, 4.0 + f * f * (3.0 * f - 6.0), 4.0 + g * g * (3.0 * g - 6.0), f * f * f) / 6.0;
}

// Derivatives of these weights.
vec4 bspline_slope(float f) {
  float g = 1.0 - f;
  return vec4(-0.5 * g * g, f * (1.5 * f - 2.0), -g * (1.5 * g - 2.0), 0.5 * f * f);
}

// Gradient of the field smoothed with the tricubic B-spline over 4x4x4 voxels; voxels at the border
// are repeated beyond it. Source: S1, section 4.1.1 and figure 5.
vec3 smooth_gradient(vec3 p) {
  ivec3 c = clamp_cell(p), last = size - 1;
  vec3 f = p - vec3(c), sum = vec3(0.0);
  vec4 wx = bspline(f.x), wy = bspline(f.y), wz = bspline(f.z);
  vec4 sx = bspline_slope(f.x), sy = bspline_slope(f.y), sz = bspline_slope(f.z);
  for (int k = 0; k < 4; k++) {
    for (int j = 0; j < 4; j++) {
      ivec3 q = clamp(c + ivec3(0, j - 1, k - 1), ivec3(0), last);
      float a = voxel(ivec3(max(c.x - 1, 0), q.yz)), b = voxel(q);
      float e = voxel(ivec3(c.x + 1, q.yz)), g = voxel(ivec3(min(c.x + 2, last.x), q.yz));
      vec4 row = vec4(a, b, e, g);
      float here = dot(wx, row);
      sum += vec3(dot(sx, row) * wy[j] * wz[k], here * sy[j] * wz[k], here * wy[j] * sz[k]);
    }
  }
  return sum;
}

// Unit outward normal from a gradient per voxel step; (0, 0, 0) if the gradient vanishes or is not
// finite.
vec3 to_world_normal(vec3 g) {
  vec3 n = -g / spacing;
  // Divide by the largest component first: its square may overflow.
  float most = max(max(abs(n.x), abs(n.y)), abs(n.z));
  return most > 0.0 && most < 1e30 ? normalize(n / most) : vec3(0.0);
}

// Unit outward world normal at p from the smoothed gradient, or from the plain one if that
// vanishes; (0, 0, 0) on a plateau.
vec3 normal(vec3 p) {
  vec3 n = SMOOTH == 1 ? to_world_normal(smooth_gradient(p)) : vec3(0.0);
  return n == vec3(0.0) ? to_world_normal(gradient(p)) : n;
}
