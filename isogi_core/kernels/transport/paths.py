"""Records of path tracing: where paths start, which samples are taken, by what rules, and how paths
end.
"""

from typing import Any, NamedTuple

from numba import types

from isogi_core.kernels._jit import REAL_ARRAY, REAL_ROWS, record


class PathStarts(NamedTuple):
    """g starts of paths on an isosurface or a wall: ``points`` in index space and world
    ``normals``, (3, g) float64.

    They are columns, as vectors of a wave are. ``isovalues`` (g,) float64, normalised, are those of
    the surface that paths meet; ``seeds`` (g,) uint64 of the sequences that they draw from.
    ``walls`` (g,) float64 are numbers of walls, or NO_WALL on the isosurface, where rays start
    outside.
    """

    points: Any
    normals: Any
    isovalues: Any
    seeds: Any
    walls: Any


PATH_STARTS = record(PathStarts, REAL_ROWS, REAL_ROWS, REAL_ARRAY, types.uint64[::1], REAL_ARRAY)


class SampleRange(NamedTuple):
    """``count`` samples of each sequence from number ``first`` on."""

    first: int
    count: int


class PathRules(NamedTuple):
    """What a path's light counts, and which paths go on: ``weights`` float64 (see the kernel), and
    ``survival``.

    That is the chance with which a path that has hit twice goes on from a hit: see
    ``russian_roulette``.
    """

    weights: Any
    survival: float


class TransferRules(NamedTuple):
    """``PathRules`` of paths that go on from the first surface that they hit in a number of
    ``branches``.
    """

    weights: Any
    survival: float
    branches: int


class PathTree(NamedTuple):
    """How paths go on: from ``bounces`` hits at most, with the chance ``survival`` (see
    ``russian_roulette``), and from the first one in ``branches`` ways.

    What comes straight is soon known, and what was reflected takes many more paths: branches bring
    these without first rays of their own. Source: splitting, Arvo and Kirk, "Particle Transport and
    Image Synthesis", 1990.
    """

    bounces: int
    survival: float
    branches: int


class PathEnds(NamedTuple):
    """How paths end: ``bounces`` int64 (n,) before they left, or -1, and world ``directions`` (3,
    n), or zeros.

    In front are the paths as they start; where they branch, those of the first branches follow,
    those of the second, and so on, as many each. ``NO_PATH`` stands for a path that branched, and
    for branches of one that did not.
    """

    bounces: Any
    directions: Any


NO_PATH = -2
"""The bounces of what is no path."""


SAMPLE_RANGE = record(SampleRange, types.int64, types.int64)
PATH_RULES = record(PathRules, types.float64[:, ::1], types.float64)
TRANSFER_RULES = record(TransferRules, types.float64[:, ::1], types.float64, types.int64)
