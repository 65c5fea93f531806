// Filters light of texels that still converges, one fragment per texel: a texel of few paths takes
// over the light that its neighbours on the surface agree on. Kernel: filter_texels of
// isogi_core/kernels/shading/filtering.py. Texels without light have no record.
#include "irradiance_ratio.glsl"
#include "noise.glsl"
uniform highp usampler2D noises; // The noise of each record, as noise_of packs it.
// The texel of each record: the number of its brick, then six bits of its place in it; NONE for
// means of bricks.
uniform highp usampler2D places;
uniform int apart; // Texels from one neighbour to the next.
layout(location = 0) out uvec4 filtered;
layout(location = 1) out uint noise;

// A texel's light, the unshadowed light about its normal, the variance of its luminance, and the
// logarithm of its samples, which is negative if it is not filtered.
struct Texel { vec3 direct, bare, reflected, normal; float variance, samples; };

// Unpack the record of a texel.
Texel texel_of(int number) {
  ivec2 at = ivec2(number % ROW, number / ROW);
  uvec4 record = texelFetch(records, at, 0);
  vec2 rg = unpackHalf2x16(record.x), br = unpackHalf2x16(record.y), gb = unpackHalf2x16(record.z);
  vec2 known = unpackHalf2x16(texelFetch(noises, at, 0).r);
  vec3 m = octahedral(record.w);
  return Texel(vec3(rg, br.x), unshadowed_light(m), vec3(br.y, gb), m, known.x * known.x, known.y);
}

// The place of a texel in the lattice.
ivec3 place_of(uint word) {
  ivec3 shape = textureSize(bricks, 0);
  int brick = int(word >> 6), bit = int(word & 63u);
  ivec3 at = ivec3(brick % shape.x, brick / shape.x % shape.y, brick / (shape.x * shape.y));
  return at * BRICK + ivec3(bit & 3, (bit >> 2) & 3, bit >> 4);
}

// The weight of a texel for another by their normals: the 16th power of the cosine, one half at 17
// degrees.
float likeness(vec3 m, vec3 n) {
  float cosine = max(dot(m, n), 0.0), square = cosine * cosine, fourth = square * square;
  return fourth * fourth * (fourth * fourth);
}

// List the records and weights of lit texels among the 3x3x3 about q, q included; return their
// number.
int neighbours_of(ivec3 q, vec3 n, out int found[27], out float weights[27]) {
  int count = 0;
  for (int i = 0; i < 27; i++) {
    ivec3 way = ivec3(i % 3, i / 3 % 3, i / 9) - 1, s = q + apart * way;
    if (any(lessThan(s, ivec3(0))) || any(greaterThanEqual(s, lattice))) continue;
    bool lacks;
    int number = number_of(s, lacks);
    if (lacks) continue;
    Texel each = texel_of(number);
    // A Gaussian of the distance with a deviation of one step, times the likeness of normals.
    float weight = exp(-0.5 * dot(vec3(way), vec3(way))) * likeness(n, each.normal);
    if (each.samples == 0.0 || weight == 0.0) continue;
    found[count] = number;
    weights[count++] = weight;
  }
  return count;
}

// Weighted means over neighbours: ratio of direct to unshadowed light, reflected light, and the
// variance of the luminance of both. Ratios vary less over a curved surface than light does.
void mean_of(int found[27], float weights[27], int count, out vec3 ratio, out vec3 reflected, out float variance) {
  vec3 direct = vec3(0.0), bare = vec3(0.0);
  float total = DARKEST;
  reflected = vec3(0.0);
  variance = 0.0;
  for (int n = 0; n < count; n++) {
    Texel s = texel_of(found[n]);
    // Weigh by the number of samples, so that noisy neighbours count less.
    float w = weights[n] * exp2(abs(s.samples));
    direct += w * s.direct;
    bare += w * s.bare;
    reflected += w * s.reflected;
    total += w;
    variance += w * w * s.variance;
  }
  ratio = direct / max(bare, DARKEST);
  reflected /= total;
  variance /= total * total;
}

// Sums over neighbours: squared differences of luminance from the expected light less the part that
// noise explains, noise, and weights.
vec3 differences(int found[27], float weights[27], int count, vec3 ratio, vec3 reflected) {
  float apart = 0.0, noise = 0.0, total = DARKEST;
  for (int n = 0; n < count; n++) {
    Texel s = texel_of(found[n]);
    float w = weights[n], difference = luminance(s.direct + s.reflected - ratio * s.bare - reflected);
    apart += w * difference * difference;
    noise += w * s.variance;
    total += w;
  }
  return vec3(max(apart - noise, 0.0), noise, total);
}

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  filtered = texelFetch(records, at, 0);
  noise = texelFetch(noises, at, 0).r;
  uint place = texelFetch(places, at, 0).r;
  Texel t = texel_of(at.y * ROW + at.x);
  if (place == NONE || t.samples <= 0.0) return;
  int found[27];
  float weights[27];
  int count = neighbours_of(place_of(place), t.normal, found, weights);
  if (count < 2) return;
  vec3 ratio, around;
  float variance;
  mean_of(found, weights, count, ratio, around, variance);
  vec3 sums = differences(found, weights, count, ratio, around);
  // Mix as a Wiener filter does: keep the share of the texel's light that true differences have in
  // all differences.
  float own = sums.x / max(sums.x + sums.y, DARKEST);
  // The variance that is left, for the next pass: of the texel's part, and of the mean's.
  float left = own * (sums.y / sums.z) + (1.0 - own) * (1.0 - own) * variance;
  filtered = record_of(mix(ratio * t.bare, t.direct, own), mix(around, t.reflected, own), filtered.w);
  noise = noise_of(left, t.samples);
}
