// Origins of shadow rays. Kernel: launch of isogi_core/kernels/tracing/intersect.py.
uniform float offset; // Voxels along the normal from the surface to the origin of rays.

// Origin of a ray that leaves the surface at p: offset along the normal, or p itself if the offset
// point is on the surface's other side, in a crease or in noise.
vec3 launch(vec3 p, vec3 n) {
  vec3 rise = n / spacing, start = p + offset * rise / length(rise);
  bool within = all(greaterThanEqual(start, vec3(0.0))) && all(lessThanEqual(start, vec3(size - 1)));
  return within && (value(start) > isovalue) == (facing == OUTSIDE) ? p : start;
}
