"""Random numbers that belong to (seed, index, dimension), and not to a thread: hashes and scrambled
Sobol points.

All words are 32 bits wide and are held in uint64 under a mask: products of two words fit then, so
that compiled code and plain Python agree bit for bit and nothing overflows. Vectors of words
(u32×N), which need no mask, go through the same functions to the same bits.
"""

import numpy as np

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.simd.maths import fraction

WORD_MASK = np.uint64(0xFFFFFFFF)
LOWEST_BIT = np.uint64(1)
HALF_WORD = np.uint64(16)
WORD_BITS = np.uint64(32)

# Multiplier and increment of the generator behind PCG4D (Numerical Recipes' "quick and dirty" one).
MULTIPLIER = np.uint64(1664525)
INCREMENT = np.uint64(1013904223)

# Even multipliers of the Laine-Karras permutation, from N. Vegdahl, "Building a Better LK Hash",
# 2021.
LK_FIRST = np.uint64(0x3D20ADEA)
LK_SECOND = np.uint64(0x05526C56)
LK_THIRD = np.uint64(0x53A22864)

# For each step of a butterfly over the 32 bits: the distance, and the places whose number lacks
# that bit.
STEP_1 = np.uint64(1)
PLACES_1 = np.uint64(0x55555555)
STEP_2 = np.uint64(2)
PLACES_2 = np.uint64(0x33333333)
STEP_4 = np.uint64(4)
PLACES_4 = np.uint64(0x0F0F0F0F)
STEP_8 = np.uint64(8)
PLACES_8 = np.uint64(0x00FF00FF)
STEP_16 = np.uint64(16)
PLACES_16 = np.uint64(0x0000FFFF)


@kernel()
def _fold(word):
    """Return the word with its high half added (xor) to its low half."""
    return word ^ (word >> HALF_WORD)


@kernel()
def pcg4d(a, b, c, d):
    """Hash four words to four words, a bijection of the 128 bits.

    Jarzynski and Olano, "Hash Functions for GPU Rendering", JCGT 9(3), 2020. Their two rounds leave
    some bits of neighbouring counters correlated (the tests' avalanche shows it), three do not.
    """
    a = (a * MULTIPLIER + INCREMENT) & WORD_MASK
    b = (b * MULTIPLIER + INCREMENT) & WORD_MASK
    c = (c * MULTIPLIER + INCREMENT) & WORD_MASK
    d = (d * MULTIPLIER + INCREMENT) & WORD_MASK
    for _ in range(3):
        a = (a + ((b * d) & WORD_MASK)) & WORD_MASK
        b = (b + ((c * a) & WORD_MASK)) & WORD_MASK
        c = (c + ((a * b) & WORD_MASK)) & WORD_MASK
        d = (d + ((b * c) & WORD_MASK)) & WORD_MASK
        a, b, c, d = _fold(a), _fold(b), _fold(c), _fold(d)
    return a, b, c, d


@kernel()
def mix(a, b):
    """Hash two integers 0 ≤ a, b < 2⁶⁴ to 64 mixed bits:
    a seed from a texel and a replica, for example.
    """
    a, b = np.uint64(a), np.uint64(b)
    high, low, _, _ = pcg4d(a & WORD_MASK, a >> WORD_BITS, b & WORD_MASK, b >> WORD_BITS)
    return (high << WORD_BITS) | low


@kernel()
def reverse_bits(word):
    """Return the 32 bits of a word in reverse order."""
    # Swap neighbouring bits, then pairs, fours, bytes and halves.
    word = ((word >> STEP_1) & PLACES_1) | ((word & PLACES_1) << STEP_1)
    word = ((word >> STEP_2) & PLACES_2) | ((word & PLACES_2) << STEP_2)
    word = ((word >> STEP_4) & PLACES_4) | ((word & PLACES_4) << STEP_4)
    word = ((word >> STEP_8) & PLACES_8) | ((word & PLACES_8) << STEP_8)
    return (word >> STEP_16) | ((word & PLACES_16) << STEP_16)


@kernel()
def pascal_bits(word):
    """Multiply the Pascal matrix modulo 2 by the bits of a word: bit i becomes the xor of the bits
    j whose number contains all binary digits of i.

    The binomial C(j, i) is odd if the binary digits of i are among those of j (Lucas). The matrix
    is a fivefold Kronecker product, so that five steps of a butterfly apply it.
    """
    word = word ^ ((word >> STEP_1) & PLACES_1)
    word = word ^ ((word >> STEP_2) & PLACES_2)
    word = word ^ ((word >> STEP_4) & PLACES_4)
    word = word ^ ((word >> STEP_8) & PLACES_8)
    return word ^ ((word >> STEP_16) & PLACES_16)


@kernel()
def sobol_2d(index):
    """Return point number 0 ≤ index < 2³² of Sobol's (0,2)-sequence as two words, fractions of 2³².

    The first is van der Corput's radical inverse, the second Sobol's dimension of the Pascal
    matrix.
    """
    index = np.uint64(index) & WORD_MASK
    return reverse_bits(index), reverse_bits(pascal_bits(index))


@kernel()
def laine_karras(word, seed):
    """Permute words so that each bit is changed only by lower bits and the seed.

    Carries of sums and products go upwards alone. A word with an even multiple of itself added
    (xor) keeps its lowest bit, and each further bit can be solved for when those below are known,
    so that no two words become the same; a factor that is odd has an inverse modulo 2³².

    Laine and Karras, "Stratified sampling for stochastic transparency", EGSR 2011; constants by
    Vegdahl 2021.
    """
    word = word ^ ((word * LK_FIRST) & WORD_MASK)
    word = (word + seed) & WORD_MASK
    word = (word * ((seed >> HALF_WORD) | LOWEST_BIT)) & WORD_MASK
    word = word ^ ((word * LK_SECOND) & WORD_MASK)
    return word ^ ((word * LK_THIRD) & WORD_MASK)


@kernel()
def nested_uniform_scramble(word, seed):
    """Scramble a word as Owen does: each bit is flipped or not by a hash of the seed and all higher
    bits.

    Burley, "Practical Hash-based Owen Scrambling", JCGT 9(4), 2020. ``seed`` is one well mixed
    word.
    """
    return reverse_bits(laine_karras(reverse_bits(word), seed))


@kernel()
def point_of_words(low, high, index, dimension):
    """Return ``point_2d`` for arguments that are words, or vectors of words; ``low`` and
    ``high`` make the seed.
    """
    # The fourth word is all ones, made from ``dimension`` so that it has its type: a word or a
    # vector.
    shuffle, first, second, _ = pcg4d(low, high, dimension, dimension | WORD_MASK)
    # Shuffle the index, then scramble both Sobol coordinates; these are reversed words, so that one
    # of the reversals in each scramble cancels.
    place = nested_uniform_scramble(index, shuffle)
    u = reverse_bits(laine_karras(place, first))
    v = reverse_bits(laine_karras(pascal_bits(place), second))
    return fraction(u), fraction(v)


@kernel()
def point_2d(seed, index, dimension):
    """Return point (u, v) in [0, 1)² number 0 ≤ index < 2³² of a pair of dimensions; doubles with
    32 bits.

    The first 2ᵏ points of every (seed, dimension) have one point in each elementary interval of
    area 2⁻ᵏ. Each pair of dimensions shuffles the index by a different scramble, so that pairs are
    not correlated (padding, Burley 2020, section 4). Seeds have up to 64 bits and need no mixing.
    """
    seed = np.uint64(seed)
    return point_of_words(
        seed & WORD_MASK,
        seed >> WORD_BITS,
        np.uint64(index) & WORD_MASK,
        np.uint64(dimension) & WORD_MASK,
    )
