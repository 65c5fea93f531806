// Bricks of 4x4x4 cells or texels, with one bit for each; data of marked cells or texels lie in
// textures that are ROW wide.
const int BRICK = 4, ROW = 2048;

// The number of a cell's, or texel's, bit in its brick, 0 to 63.
int bit_of(ivec3 c) { return (c.x & 3) | ((c.y & 3) << 2) | ((c.z & 3) << 4); }

// The word, of two with 32 bits each, that holds a bit.
uint half_of(uvec2 words, int bit) { return bit < 32 ? words.x : words.y; }
