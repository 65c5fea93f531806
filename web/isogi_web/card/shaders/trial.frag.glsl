// A small picture that times how quickly a card reads: each pixel reads as many voxels as a pixel
// of a surface does, each at a place that depends on the one before, as along rays.
uniform highp usampler3D voxels;    // EDGE a side
out vec4 sampled;

const int EDGE = 32, READS = 128;

void main() {
  ivec3 at = ivec3(ivec2(gl_FragCoord.xy) & (EDGE - 1), 0);
  uint sum = 0u;
  for (int i = 0; i < READS; i++) {
    uint code = texelFetch(voxels, at, 0).r;
    sum += code * code;
    at = (at + ivec3(1, code & 1u, code >> 7)) & (EDGE - 1);
  }
  sampled = vec4(float(sum & 255u) / 255.0);
}
