"""Specimens with extreme values: offsets, factors, types, outliers and holes."""

import numpy as np

from benchmarks.stability.shapes import body
from benchmarks.stability.specimen import specimen

GROUP = "extreme ranges"
SIDE = 32


def soft(side: int = SIDE) -> np.ndarray:
    """The body as a smooth field from 0 to 1 without a plateau, 0.5 at its skin, float64."""
    return np.asarray(0.5 - 0.5 * np.tanh(body(side) / (side / 8)))


def spoiled(share: float, *marks: float) -> np.ndarray:
    """The field with a share of its voxels, taken by chance and at least one, replaced by the marks in turn."""
    field = soft()
    count = max(round(share * field.size), len(marks))
    field.flat[np.random.default_rng(1).permutation(field.size)[:count]] = np.resize(marks, count)
    return field


@specimen(GROUP, "offset of 1e9", 1e9 + 0.5)
def offset() -> np.ndarray:
    """A small range on a large offset."""
    return 1e9 + soft()


@specimen(GROUP, "offset of 1e9 in single floats", 1e9 + 32)
def coarse_offset() -> np.ndarray:
    """The same in a type that has no step between 1e9 and 1e9 + 64: nearly nothing is left."""
    return (1e9 + 256 * soft()).astype(np.float32)


@specimen(GROUP, "times 1e-300", 0.5e-300)
def tiny() -> np.ndarray:
    """A range whose square is 0."""
    return 1e-300 * soft()


@specimen(GROUP, "times 1e300", 0.5e300)
def huge() -> np.ndarray:
    """A range whose square is infinite."""
    return 1e300 * soft()


@specimen(GROUP, "wider than any double", 0.0)
def widest() -> np.ndarray:
    """A range that is itself infinite."""
    return 1.79e308 * (2 * soft() - 1)


@specimen(GROUP, "subnormal", 2.0**-1056)
def subnormal() -> np.ndarray:
    """Values that processors may flush to zero, 2^19 steps in all."""
    return np.ldexp(soft(), -1055)


@specimen(GROUP, "int64 beyond 2^53", 2.0**60 + 512)
def wide_integers() -> np.ndarray:
    """Steps that doubles do not have."""
    return 2**60 + np.rint(1024 * soft()).astype(np.int64)


@specimen(GROUP, "uint64 up to the last", 2.0**64 - 2**19)
def top_integers() -> np.ndarray:
    """The largest whole numbers."""
    return np.uint64(2**64 - 1) - np.rint(2**20 * (1 - soft())).astype(np.uint64)


@specimen(GROUP, "half floats", 0.5)
def half() -> np.ndarray:
    """11 bits a value."""
    return soft().astype(np.float16)


@specimen(GROUP, "booleans", 0.5)
def booleans() -> np.ndarray:
    """True and false."""
    return soft() > 0.5


@specimen(GROUP, "big-endian", 0.5)
def big_endian() -> np.ndarray:
    """Bytes the other way round."""
    return soft().astype(">f8")


@specimen(GROUP, "constant", 7.0, empty=True)
def constant() -> np.ndarray:
    """One value."""
    return np.full((SIDE,) * 3, 7, np.int16)


@specimen(GROUP, "negative zeros", 0.0, 0.25)
def negative_zeros() -> np.ndarray:
    """Both zeros side by side, where the isovalue is."""
    field = np.maximum(soft() - 0.5, 0.0)
    field[::2][field[::2] == 0.0] = -0.0
    return field


@specimen(GROUP, "hot voxel of 1e30", 0.5)
def hot() -> np.ndarray:
    """One value that leaves no digits to the others."""
    return spoiled(0.0, 1e30)


@specimen(GROUP, "hot voxels of ±1e300", 0.5)
def hottest() -> np.ndarray:
    """Values that single floats do not have."""
    return spoiled(0.0, 1e300, -1e300)


@specimen(GROUP, "-9999 in 30 %", 0.5)
def marked() -> np.ndarray:
    """What simulations write where there is nothing."""
    return spoiled(0.3, -9999.0)


@specimen(GROUP, "one NaN", 0.5)
def nan() -> np.ndarray:
    """A hole."""
    return spoiled(0.0, np.nan)


@specimen(GROUP, "NaN in half", 0.5)
def half_nan() -> np.ndarray:
    """Hardly a cell without a hole."""
    return spoiled(0.5, np.nan)


@specimen(GROUP, "both infinities", 0.5)
def infinities() -> np.ndarray:
    """Two holes."""
    return spoiled(0.0, np.inf, -np.inf)


@specimen(GROUP, "infinities in half", 0.5)
def half_infinite() -> np.ndarray:
    """Holes of all kinds."""
    return spoiled(0.5, np.inf, -np.inf, np.nan)


@specimen(GROUP, "all NaN", 0.5, refused="no finite value")
def no_value() -> np.ndarray:
    """Nothing."""
    return np.full((4, 4, 4), np.nan)
