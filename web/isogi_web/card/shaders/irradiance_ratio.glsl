// Light of texels interpolated to a point: irradiance ratios of the eight texels around it, or
// their light as it is. Kernels: isogi_core/kernels/shading/irradiance_ratio.py and lattice.py;
// layout: web/isogi_web/card/texels.js.
#include "bricks.glsl"
#include "surfaces.glsl"
// Per brick of 4x4x4 texels: 64 bits of texels that are present, the number of the first record,
// and a distance.
uniform highp usampler3D bricks;
// ROW in a row: direct and reflected light as halves, and the word of the normal.
uniform highp usampler2D records;
uniform ivec3 lattice;              // texels along x, y, z
uniform vec3 density;               // texels per voxel
uniform bool coarse;                // true if some bricks have a mean, and no texels

const float LEAST_COSINE = 1e-3; // Least cosine in weights: if all texels face away, all count.
const float TURNED = 0.1055; // 1 - cosine, of 27 degrees, at which weights have fallen to a fifth.
const float DARKEST = 1e-30; // Least divisor of ratios.
// Words that no normal has.
const uint BURIED = 0x80008001u, VOID = 0x80008002u, FLAT = 0x80008003u;
const uint NONE = 0xffffffffu;      // number of no record

// Irradiance over pi that arrives without shadows about the unit normal n. Source: Ramamoorthi and
// Hanrahan 2001, eqs. 11 to 13.
vec3 unshadowed_by(vec3 q[9], vec3 n) {
  vec3 light = q[0] + n.y * q[1] + n.z * q[2] + n.x * q[3];
  light += n.x * n.y * q[4] + n.y * n.z * q[5] + n.z * n.z * q[6] + n.x * n.z * q[7];
  return max(light + (n.x * n.x - n.y * n.y) * q[8], least);
}

// Irradiance over pi of the current light without shadows.
vec3 unshadowed_light(vec3 n) { return unshadowed_by(quadric, n); }

// Number of bits that are set in a word: sums of pairs of bits, then of fours, of bytes, and of
// all.
int ones(uint word) {
  uint pairs = word - ((word >> 1) & 0x55555555u);
  uint fours = (pairs & 0x33333333u) + ((pairs >> 2) & 0x33333333u);
  return int((((fours + (fours >> 4)) & 0x0f0f0f0fu) * 0x01010101u) >> 24);
}

// The unit vector of a word with two 16-bit octahedral coordinates; (0, 0, 0) for FLAT. Source:
// Cigolle et al., "A Survey of Efficient Representations for Independent Unit Vectors", JCGT 3(2),
// 2014.
vec3 octahedral(uint word) {
  if (word == FLAT) return vec3(0.0);
  vec2 e = unpackSnorm2x16(word);
  vec3 v = vec3(e, 1.0 - abs(e.x) - abs(e.y));
  float folded = max(-v.z, 0.0);
  v.xy += mix(vec2(folded), vec2(-folded), greaterThanEqual(v.xy, vec2(0.0)));
  return normalize(v);
}

// The number of the record of texel q: its record if it is present, otherwise that of a nearby
// brick's mean, or -1. `lacks` tells that it is not present.
int number_of(ivec3 q, out bool lacks) {
  uvec4 brick = texelFetch(bricks, (q >> 2) + ivec3(0, 0, light_layer), 0);
  int bit = bit_of(q), all = ones(brick.x) + ones(brick.y);
  uint word = half_of(brick.xy, bit), own = 1u << (bit & 31);
  lacks = (word & own) == 0u;
  // Records follow the bits: count the bits that are set before this one. The mean comes after all
  // of them.
  int below = ones(word & (own - 1u)) + (bit < 32 ? 0 : ones(brick.x));
  return brick.z == NONE ? -1 : int(brick.z) + (lacks ? all : below);
}

// True if the brick of texel q is known by its mean alone.
bool is_coarse(ivec3 q) {
  uvec4 brick = texelFetch(bricks, (q >> 2) + ivec3(0, 0, light_layer), 0);
  return (brick.x | brick.y | brick.w) == 0u && brick.z != NONE;
}

// The number of the record of a brick's mean, or -1 if it has none of its own.
int mean_number(ivec3 b) {
  uvec4 brick = texelFetch(bricks, b + ivec3(0, 0, light_layer), 0);
  return brick.w > 0u || brick.z == NONE ? -1 : int(brick.z) + ones(brick.x) + ones(brick.y);
}

// The weight of a texel with normal m at a point with normal n: (c / (1 + (1 - c) / TURNED))^2 for
// the cosine c between them.
float agree(vec3 m, vec3 n) {
  float cosine = dot(n, m), weight = max(cosine, LEAST_COSINE) / (1.0 + (1.0 - cosine) / TURNED);
  return weight * weight;
}

uniform vec3 albedo; // Albedo that is shown, relative to the one that light was folded for.

// Sums over the texels about a point, as in blend_records of the kernel.
struct Blend { vec3 direct, unshadowed, reflected; float weight, buried, lacking; };

// Add the record of a texel with trilinear weight w, for a point with normal n.
void add_record(inout Blend sums, uvec4 record, float w, vec3 n) {
  if (record.w == BURIED) sums.buried += w;
  if (record.w == BURIED || record.w == VOID) return;
  vec3 m = octahedral(record.w);
  vec2 rg = unpackHalf2x16(record.x), br = unpackHalf2x16(record.y), gb = unpackHalf2x16(record.z);
  if (RATIOS == 1) w *= agree(m, n);
  sums.direct += w * vec3(rg, br.x);
  sums.reflected += w * vec3(br.y, gb);
  if (RATIOS == 1) sums.unshadowed += w * unshadowed_light(m);
  sums.weight += w;
}

// Light at p with normal n, in the plan's unit, before it is reflected with the albedo that is
// shown. `lacking` is the share of it that belongs to texels that are not present.
//
// Weights are trilinear (S1, section 4.2). Ratios are relative to unshadowed light, which also
// stands in for unknown light. Means of bricks that have no texels yet are texels of a lattice that
// is a quarter as dense, at the middles of bricks.
vec3 texel_light(vec3 p, vec3 n, out float lacking) {
  vec3 q = p * density, under = unshadowed_light(n);
  bool by_means = coarse && is_coarse(clamp(ivec3(round(q)), ivec3(0), lattice - 1));
  ivec3 last = lattice - 1;
  if (by_means) {
    q = (q - 0.5 * float(BRICK - 1)) / float(BRICK);
    last /= BRICK;
  }
  ivec3 base = clamp(ivec3(floor(q)), ivec3(0), max(last - 1, 0));
  vec3 f = clamp(q - vec3(base), 0.0, 1.0);
  Blend sums = Blend(vec3(0.0), vec3(0.0), vec3(0.0), 0.0, 0.0, 0.0);
  for (int c = 0; c < 8; c++) {
    ivec3 corner = ivec3(c & 1, (c >> 1) & 1, c >> 2);
    vec3 share = mix(1.0 - f, f, vec3(corner));
    float w = share.x * share.y * share.z;
    bool lacks = true;
    int number = by_means ? mean_number(min(base + corner, last)) : number_of(base + corner, lacks);
    if (lacks) sums.lacking += w;
    if (by_means && number < 0) continue;
    if (number >= 0) {
      add_record(sums, texelFetch(records, ivec2(number % ROW, number / ROW), 0), w, n);
    } else {
      sums.direct += w * under;
      sums.unshadowed += w * under;
      sums.weight += w;
    }
  }
  lacking = sums.lacking;
  sums.reflected *= albedo; // Reflected light has met one surface more: correct it to first order.
  // No texel counts: points between buried texels are dark, others get unshadowed light.
  if (!(sums.weight > 0.0)) return sums.buried > 0.0 ? vec3(0.0) : under;
  if (RATIOS == 0) return (sums.direct + sums.reflected) / sums.weight;
  return sums.direct / max(sums.unshadowed, DARKEST) * under + sums.reflected / sums.weight;
}
