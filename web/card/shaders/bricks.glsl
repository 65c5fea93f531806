// Bricks of 4x4x4 cells or texels, with a bit for each; what they count lies in textures ROW wide.
const int BRICK = 4, ROW = 2048;

// The bit of a cell, or texel, in its brick.
int bit_of(ivec3 c) { return (c.x & 3) | ((c.y & 3) << 2) | ((c.z & 3) << 4); }

// The word of 32 bits that a bit is in.
uint half_of(uvec2 words, int bit) { return bit < 32 ? words.x : words.y; }
