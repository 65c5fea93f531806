// Shading of surfaces that shine, which needs that of others, `shade`.
vec3 shade(vec3 p, vec3 n, out float lacking);

// Light that leaves a shiny surface at p with normal n against the ray d: what the lobe leaves of
// diffuse light, and what its rays bring. A surface that they meet is diffuse. Where most of its
// texels are not here, a path goes on from there at rest (`paths_from` of
// isogi_core/frame/rays/shine.py); in a moving view it would be noise.
vec3 shade_shiny(vec3 p, vec3 n, vec3 d, out float lacking) {
  mat3 frame = frame_about(n);
  vec3 v = -normalize(d * spacing) * frame, start = launch(p, n), light = vec3(0.0);
  v = normalize(vec3(v.xy, max(abs(v.z), LEAST_VIEW)));
  vec3 factor = kept_energy(v) / float(strata * strata);
  // Ray -1 is the surface itself: as one loop shades all points, drivers compile `shade` once.
  for (int k = -1; k < strata * strata; k++) {
    bool mirrored = k >= 0;
    vec3 share = light_below(v.z), at = p, facing_at = n, w = n;
    float density = 1.0, lacks;
    if (mirrored) {
      vec3 l = sample_reflected(v, place_of(k));
      if (!(l.z > 0.0)) continue;
      share = factor * weight_of(v, l);
      w = frame * l;
      at = start;
      density = reflected_pdf(v, l);
    }
    for (int step = 0; step < LONGEST; step++) {
      float t = mirrored ? cast_ray(at, w / spacing, OUTSIDE) : 0.0;
      if (t < 0.0) {
        light += share * (step == 0 ? mirrored_light(w, density) : far_light(w, width_of(density)));
        break;
      }
      if (mirrored) {
        at += t * w / spacing;
        facing_at = find_normal(at, w / spacing);
      }
      vec3 there = shade(at, facing_at, lacks);
      if (!mirrored) lacking = lacks;
      if (!mirrored || !resting || lacks < 0.5 || step == LONGEST - 1) {
        light += share * there;
        break;
      }
      share *= reflecting * albedo * tint(at);
      at = launch(at, facing_at);
      w = scatter(facing_at, k, step, density);
    }
  }
  return light;
}
