"""The table of random numbers: streams keep sequences apart, and dimensions the purposes of a path.

A seed selects a sequence, and words make the seed: a pixel and its stream plus the number of a
replica, or a texel's place and its half. Each sample of a sequence has pairs of numbers, one for
each dimension: see ``point_2d``. If two purposes drew the same pair of one sequence they would be
correlated, and no test of either would show it; therefore all are listed here.

To add a stream, append the next free power of two, and list it in STREAMS. To add a purpose of
paths, put its pairs below those of LEAVING, and list it in PURPOSES. Numbers that are here never
change: stored light was drawn by these.
"""

PAIRS_PER_PURPOSE = 1 << 16
"""Pairs of random numbers for one purpose of a path, one for each vertex."""

DIRECTIONS = 0
"""The first of the pairs that draw a path's directions, one for each vertex."""

FIRST_SOURCE_PAIR = PAIRS_PER_PURPOSE
"""The first pair that draws a point of a light source, PAIRS_PER_PURPOSE for each: bright sky, then
lamps, then luminaires.
"""

MAX_CROSSINGS = 64
"""Largest number of surfaces that a ray meets; the last of them stops it."""

FIRST_ROULETTE_PAIR = 0x7FFF * PAIRS_PER_PURPOSE
"""The first pair that decides which paths continue, one for each bounce."""

PASSING = FIRST_ROULETTE_PAIR - MAX_CROSSINGS * PAIRS_PER_PURPOSE
"""The first pair that decides which rays pass a surface, one for each crossing and vertex."""

LEAVING = PASSING - PAIRS_PER_PURPOSE
"""The first pair that decides on which side paths leave a surface, one for each vertex."""

IN_MATTER = 0x8000 * PAIRS_PER_PURPOSE
"""The first pair on a ray's way through matter, two for each of MAX_STEPS steps and each vertex."""

MAX_STEPS = 4096
"""Largest number of interfaces and scattering events of a ray in matter;
the light left after them is lost.
"""

PURPOSES = (
    (DIRECTIONS, PAIRS_PER_PURPOSE),
    (FIRST_SOURCE_PAIR, LEAVING - FIRST_SOURCE_PAIR),
    (LEAVING, PAIRS_PER_PURPOSE),
    (PASSING, MAX_CROSSINGS * PAIRS_PER_PURPOSE),
    (FIRST_ROULETTE_PAIR, PAIRS_PER_PURPOSE),
    (IN_MATTER, 2 * MAX_STEPS * PAIRS_PER_PURPOSE),
)
"""The first pair of each purpose of a path, and the number of its pairs."""

SHINE_WAY = 0
SHINE_CHOICE = 1
SHINE_LAMP = 2
"""Pairs in the sequences of shine's rays: for a candidate direction, for the choice among
candidates, and from SHINE_LAMP on one for each lamp.
"""

PICTURE_STREAM = 0
"""The first stream of path-traced pictures."""

REFERENCE_STREAM = 1 << 16
"""The first stream of a report's references."""

CONTROLS_STREAM = 1 << 17
"""The first stream of control pixels, two for each set of halves."""

PIXEL_LIGHT_STREAM = 1 << 18
"""The first stream of paths for pixels whose texels are not accurate enough."""

WALLS_STREAM = 1 << 19
"""The first word, in place of a lattice texel's z, of seeds of walls' texels: two for each wall,
its front and back.
"""

SHINE_STREAM = 1 << 20
"""The first stream of rays of shine, and of paths from their ends."""

GLASS_STREAM = 1 << 21
"""The first stream of trees of rays through glass."""

LOBES_STREAM = 1 << 24
"""The stream of rays towards lobes of the environment."""

STREAMS = (
    PICTURE_STREAM,
    REFERENCE_STREAM,
    CONTROLS_STREAM,
    PIXEL_LIGHT_STREAM,
    WALLS_STREAM,
    SHINE_STREAM,
    GLASS_STREAM,
    LOBES_STREAM,
)
"""All streams. Each has the numbers up to the next one: at least 65,536 replicas."""
