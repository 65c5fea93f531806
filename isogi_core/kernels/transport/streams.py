"""The table of random numbers: streams keep sequences apart, and dimensions the purposes that a path draws for.

A seed owns a sequence, and words make the seed: a pixel and its stream plus the number of a replica, or a texel's place
and its half. Each sample of a sequence has pairs of numbers, one for each dimension: see ``point_2d``. Two purposes
that draw the same pair of one sequence are correlated, and no test of either sees that. So all of them stand here.

To add a stream, append the next free power of two, and list it in STREAMS. To add a purpose of paths, put its pairs
below those of LEAVING, and list it in PURPOSES. Numbers that are here never change: stored light was drawn by these.
"""

PAIRS = 1 << 16
"""Pairs of random numbers for one purpose of a path, one for each vertex."""

DIRECTIONS = 0
"""The first of the pairs that draw a path's directions, one for each vertex."""

SOURCES = PAIRS
"""The first pair that draws a point of a light source, PAIRS for each: bright sky, then lamps, then luminaires."""

CROSSINGS = 64
"""Surfaces that a ray passes at most: what comes next stops it."""

ROULETTE = 0x7FFF * PAIRS
"""The first pair that decides which paths go on, one for each bounce."""

PASSING = ROULETTE - CROSSINGS * PAIRS
"""The first pair that decides which rays pass a surface, one for each crossing and vertex."""

LEAVING = PASSING - PAIRS
"""The first pair that decides on which side paths leave a surface, one for each vertex."""

IN_MATTER = 0x8000 * PAIRS
"""The first pair on a ray's way through matter, two for each of MAX_STEPS steps and each vertex."""

MAX_STEPS = 4096
"""Interfaces and scatterings of a ray in matter at most: what is left then is lost."""

PURPOSES = (
    (DIRECTIONS, PAIRS),
    (SOURCES, LEAVING - SOURCES),
    (LEAVING, PAIRS),
    (PASSING, CROSSINGS * PAIRS),
    (ROULETTE, PAIRS),
    (IN_MATTER, 2 * MAX_STEPS * PAIRS),
)
"""For each purpose of a path the first of its pairs, and how many are its own."""

SHINE_WAY, SHINE_CHOICE, SHINE_LAMP = 0, 1, 2
"""Pairs of the sequences of shine's rays: for a way, for which way a ray takes, and one for each lamp from there on."""

PICTURE = 0
"""The first stream of path-traced pictures."""

REFERENCE = 1 << 16
"""The first stream of a report's references."""

CONTROLS = 1 << 17
"""The first stream of control pixels, two for each set of halves."""

PIXEL_LIGHT = 1 << 18
"""The first stream of pixels that get light of their own."""

WALLS = 1 << 19
"""The first word, in place of a lattice texel's z, of seeds of walls' texels: two for each wall, its front and back."""

SHINE = 1 << 20
"""The first stream of rays of shine, and of paths from their ends."""

GLASS = 1 << 21
"""The first stream of trees of rays through glass."""

LOBES = 1 << 24
"""The stream of rays towards lobes of the environment."""

STREAMS = (PICTURE, REFERENCE, CONTROLS, PIXEL_LIGHT, WALLS, SHINE, GLASS, LOBES)
"""All streams. Each has the numbers up to the next one: at least 65,536 replicas."""
