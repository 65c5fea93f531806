"""Records of path tracing: starts of paths, ranges of samples, rules of continuation, and ends."""

from typing import Any, NamedTuple

from numba import types

from isogi_core.kernels._jit import REAL_ARRAY, REAL_ROWS, record


class PathStarts(NamedTuple):
    """g starts of paths on an isosurface or a wall.

    - ``points``, ``normals``: (3, g) float64; points in index space, normals in the world.
    - ``isovalues``: (g,) float64, normalised; the surface that the paths meet.
    - ``seeds``: (g,) uint64, of the random sequences.
    - ``walls``: (g,) float64, numbers of walls, or NO_WALL on the isosurface, where rays start
      outside.
    """

    points: Any
    normals: Any
    isovalues: Any
    seeds: Any
    walls: Any


PATH_STARTS = record(PathStarts, REAL_ROWS, REAL_ROWS, REAL_ARRAY, types.uint64[::1], REAL_ARRAY)


class SampleRange(NamedTuple):
    """The samples ``first`` to ``first + count`` of each random sequence."""

    first: int
    count: int


class PathRules(NamedTuple):
    """Rules of paths that gather light: ``weights`` float64 of the light by the number of bounces
    (see each kernel), and the probability ``survival``.

    A path that has hit twice or more continues with the probability ``survival``: see
    ``russian_roulette``.
    """

    weights: Any
    survival: float


class TransferRules(NamedTuple):
    """``PathRules`` of paths that split into a number of ``branches`` at their first hit."""

    weights: Any
    survival: float
    branches: int


class PathTree(NamedTuple):
    """Rules of paths that split: at most ``bounces`` hits, ``survival`` per hit, ``branches`` at
    the first one.

    Direct light converges with few paths, reflected light needs many more: branches add reflected
    light without further first rays. See ``russian_roulette`` for survival. Source: splitting, Arvo
    and Kirk, "Particle Transport and Image Synthesis", 1990.
    """

    bounces: int
    survival: float
    branches: int


class PathEnds(NamedTuple):
    """Ends of n paths: ``bounces`` int64 (n,) before they left the volume, and world ``directions``
    (3, n).

    Paths that never leave have bounces -1 and zero directions. The first block holds paths as they
    start; if they branch, blocks of the first branches, of the second and so on follow, each of the
    same size. ``NO_PATH`` marks a path that was replaced by its branches, and the branches of a
    path that did not split.
    """

    bounces: Any
    directions: Any


NO_PATH = -2
"""``PathEnds.bounces`` of an entry that is no path."""


SAMPLE_RANGE = record(SampleRange, types.int64, types.int64)
PATH_RULES = record(PathRules, types.float64[:, ::1], types.float64)
TRANSFER_RULES = record(TransferRules, types.float64[:, ::1], types.float64, types.int64)
