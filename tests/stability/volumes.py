"""Volumes that are hard on a renderer: solids, stiff fields, extreme values, extreme boxes, and
closed surfaces.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

Spacing = tuple[float, float, float]
Make = Callable[[], np.ndarray]

SIDE = 32
"""Voxels along each side of ``soft``."""

CLOSED_SIDE = 41
RADIUS = 12.0
"""Voxels along each side of volumes with closed surfaces, and the radius of most of these."""


@dataclass(frozen=True)
class Specimen:
    """A volume (z, y, x) that ``make`` makes, the ``isovalues`` to look at in its own units, and
    its ``spacing``.

    ``spacing`` is (x, y, z). ``distance``, in bounding radii, is where a camera sees its surface.
    ``refused`` is a word of the sentence that refuses the volume, or empty.
    """

    make: Make
    isovalues: tuple[float, ...]
    spacing: Spacing = (1.0, 1.0, 1.0)
    distance: float = 2.4
    refused: str = ""


def grid(*sides: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coordinates x, y, z (each nz, ny, nx) of a volume of ``sides`` (nx, ny, nz) voxels, from its
    middle.
    """
    x, y, z = (np.arange(n) - (n - 1) / 2 for n in sides)
    return tuple(np.meshgrid(z, y, x, indexing="ij"))[::-1]


def ball(
    axes: tuple[np.ndarray, ...], centre: tuple[float, float, float], radius: float
) -> np.ndarray:
    """Signed distance from a ball's skin, negative within."""
    return np.sqrt(sum((axis - c) ** 2 for axis, c in zip(axes, centre, strict=True))) - radius


def body(side: int = 48) -> np.ndarray:
    """Signed distance from a bored ball, a small one beside it and a plate under both: it shades
    itself.
    """
    x, y, z = axes = grid(side, side, side)
    scale = side / 48
    large = ball(axes, (0.0, 0.0, -2.3 * scale), 13.1 * scale)
    small = ball(axes, (9.2 * scale, 3.1 * scale, 8.7 * scale), 7.4 * scale)
    plate = np.maximum.reduce(
        [abs(x) - 20 * scale, abs(y) - 20 * scale, abs(z + 15 * scale) - 3 * scale]
    )
    bore = np.hypot(x + 4 * scale, y - 3 * scale) - 4.2 * scale
    return np.minimum(np.minimum(np.maximum(large, -bore), small), plate)


def ramp(distance: np.ndarray, width: float) -> np.ndarray:
    """The field 1 within, 0 without, and linear over ``width`` voxels across the skin; a mask where
    that is 0.
    """
    if width == 0.0:
        return (distance < 0.0).astype(np.float32)
    return np.clip(0.5 - distance / width, 0.0, 1.0).astype(np.float32)


def soft(side: int = SIDE) -> np.ndarray:
    """The body as a smooth field from 0 to 1 without a plateau, 0.5 at its skin, float64."""
    return np.asarray(0.5 - 0.5 * np.tanh(body(side) / (side / 8)))


def spoiled(share: float, *marks: float) -> np.ndarray:
    """``soft`` with a share of its voxels, taken by chance and at least one per mark, replaced by
    the marks in turn.
    """
    field = soft()
    count = max(round(share * field.size), len(marks))
    field.flat[np.random.default_rng(1).permutation(field.size)[:count]] = np.resize(marks, count)
    return field


def metal_in_a_scan() -> np.ndarray:
    """Twelve bits of tissue, noise, and metal that is clipped and streaks across the slice."""
    x, y, z = axes = grid(48, 48, 48)
    metal = ball(axes, (0.0, 0.0, 8.0), 4.0)
    streaks = 400.0 * np.cos(14 * np.arctan2(y, x)) * np.exp(-np.hypot(x, y) / 12 - abs(z - 8) / 3)
    noise = np.random.default_rng(5).normal(0.0, 20.0, x.shape)
    scan = 1000 * ramp(body(), 3.0) + 6000 * ramp(metal, 2.0) + streaks + noise
    return np.clip(np.rint(scan), 0, 4095).astype(np.uint16)


def gradients_apart() -> np.ndarray:
    """A body whose field rises a million times more steeply at one end than at the other."""
    x, _, _ = grid(48, 48, 48)
    return (-body() * 10.0 ** (6 * (x - x.min()) / np.ptp(x))).astype(np.float64)


def negative_zeros() -> np.ndarray:
    """Both zeros side by side, where the isovalue is."""
    field = np.maximum(soft() - 0.5, 0.0)
    field[::2][field[::2] == 0.0] = -0.0
    return field


def ripples(*sides: int) -> np.ndarray:
    """Waves across a box of ``sides`` (nx, ny, nz) voxels, from 0 to 1."""
    x, y, z = grid(*sides)
    return np.asarray(0.5 + 0.5 * np.cos(0.9 * x + 0.3) * np.cos(0.8 * y) * np.cos(0.7 * z + 0.2))


def one_cell() -> np.ndarray:
    """The least volume: 2 × 2 × 2 voxels."""
    return np.array([[[0.0, 1.0], [0.2, 0.9]], [[0.1, 0.4], [0.8, 0.3]]])


STIFF: Mapping[str, Specimen] = {
    "mask": Specimen(lambda: ramp(body(), 0.0), (0.0, 0.5, 0.999)),
    "mask of bytes": Specimen(lambda: (255 * ramp(body(), 0.0)).astype(np.uint8), (0.5, 254.0)),
    "ramp of a voxel": Specimen(lambda: ramp(body(), 1.0), (0.25, 0.5)),
    # A wide ramp in eight steps: between them every voxel lies on a plateau, and 0.25 is one of
    # them.
    "terraces": Specimen(
        lambda: (np.round(8 * ramp(body(), 24.0)) / 8).astype(np.float32), (0.25, 0.4)
    ),
    "metal in a scan": Specimen(metal_in_a_scan, (500.0, 3000.0)),
    "gradients apart by 1e6": Specimen(gradients_apart, (0.0,)),
}

SPECKS = "-9999 in 30 %"
"""The specimen whose surface is all specks, smaller than the space between texels."""

RANGES: Mapping[str, Specimen] = {
    "offset of 1e9": Specimen(lambda: 1e9 + soft(), (1e9 + 0.5,)),
    # Single floats have no step between 1e9 and 1e9 + 64: nearly nothing is left.
    "offset of 1e9 in single floats": Specimen(
        lambda: (1e9 + 256 * soft()).astype(np.float32), (1e9 + 32,)
    ),
    "times 1e-300": Specimen(lambda: 1e-300 * soft(), (0.5e-300,)),
    "times 1e300": Specimen(lambda: 1e300 * soft(), (0.5e300,)),
    "wider than any double": Specimen(lambda: 1.79e308 * (2 * soft() - 1), (0.0,)),
    "subnormal": Specimen(lambda: np.ldexp(soft(), -1055), (2.0**-1056,)),
    "int64 beyond 2^53": Specimen(
        lambda: 2**60 + np.rint(1024 * soft()).astype(np.int64), (2.0**60 + 512,)
    ),
    "uint64 up to the last": Specimen(
        lambda: np.uint64(2**64 - 1) - np.rint(2**20 * (1 - soft())).astype(np.uint64),
        (2.0**64 - 2**19,),
    ),
    "half floats": Specimen(lambda: soft().astype(np.float16), (0.5,)),
    "booleans": Specimen(lambda: soft() > 0.5, (0.5,)),
    "big-endian": Specimen(lambda: soft().astype(">f8"), (0.5,)),
    "constant": Specimen(lambda: np.full((SIDE,) * 3, 7, np.int16), (7.0,)),
    "negative zeros": Specimen(negative_zeros, (0.0, 0.25)),
    "hot voxel of 1e30": Specimen(lambda: spoiled(0.0, 1e30), (0.5,)),
    "hot voxels of ±1e300": Specimen(lambda: spoiled(0.0, 1e300, -1e300), (0.5,)),
    SPECKS: Specimen(lambda: spoiled(0.3, -9999.0), (0.5,)),
    "one NaN": Specimen(lambda: spoiled(0.0, np.nan), (0.5,)),
    "NaN in half": Specimen(lambda: spoiled(0.5, np.nan), (0.5,)),
    "both infinities": Specimen(lambda: spoiled(0.0, np.inf, -np.inf), (0.5,)),
    "infinities in half": Specimen(lambda: spoiled(0.5, np.inf, -np.inf, np.nan), (0.5,)),
}

CAVE = "solid up to the box"
"""The specimen that is a cave without a way in: it is black."""

BOXES: Mapping[str, Specimen] = {
    "2 × 2 × 2": Specimen(one_cell, (0.5,)),
    "4096 × 2 × 2": Specimen(lambda: ripples(4096, 2, 2), (0.5,), distance=0.005),
    "2 × 2 × 300": Specimen(lambda: ripples(2, 2, 300), (0.5,), distance=0.05),
    "64 × 64 × 2": Specimen(lambda: ripples(64, 64, 2), (0.5,)),
    "cut by the box": Specimen(lambda: soft()[16:], (0.5,)),
    CAVE: Specimen(lambda: 1.0 - soft(), (0.5,)),
    "spacing 1 : 1000": Specimen(soft, (0.5,), (1.0, 1.0, 1000.0), distance=0.004),
    "spacing of 1e-30": Specimen(soft, (0.5,), (1e-30, 1e-30, 1e-30)),
    "spacing of 1e30": Specimen(soft, (0.5,), (1e30, 1e30, 1e30)),
}

REFUSED: Mapping[str, Specimen] = {
    "all NaN": Specimen(lambda: np.full((4, 4, 4), np.nan), (0.5,), refused="no finite value"),
    "1 × 8 × 8": Specimen(lambda: ripples(1, 8, 8), (0.5,), refused="no cells"),
    **{
        f"spacing of {step:g}": Specimen(one_cell, (0.5,), (1.0, step, 1.0), refused="spacing")
        for step in (1e-300, 1e300, 0.0, -1.0, math.nan, math.inf)
    },
}
"""What is no volume."""

VOLUMES: Mapping[str, Specimen] = {**STIFF, **RANGES, **BOXES}
"""All specimens that are not refused."""


def closed_ball() -> np.ndarray:
    """Signed distance from a ball's skin, positive within."""
    return -ball(grid(*(CLOSED_SIDE,) * 3), (0.0, 0.0, 0.0), RADIUS)


def closed_octahedron() -> np.ndarray:
    """RADIUS less the sum of the absolute coordinates."""
    x, y, z = grid(*(CLOSED_SIDE,) * 3)
    return RADIUS - abs(x) - abs(y) - abs(z)


def closed_mask() -> np.ndarray:
    """A ball's mask with a quarter of the voxels near its skin left out."""
    distance = closed_ball()
    kept = np.random.default_rng(6).random(distance.shape) < 0.75
    return ((distance > 0.0) & (kept | (distance > RADIUS / 2))).astype(np.float32)


def closed_shells() -> np.ndarray:
    """Shells within each other."""
    distance = closed_ball()
    return np.where(distance > 0.0, np.sin(1.3 * distance), 0.0)


def closed_noise() -> np.ndarray:
    """White noise from 0 to 1, and 0 around it."""
    return np.pad(np.random.default_rng(1).random((CLOSED_SIDE - 4,) * 3), 2)


CLOSED: Mapping[str, tuple[Make, tuple[float, ...]]] = {
    "ball": (closed_ball, (0.0, 1.3, 5.0)),
    "octahedron": (closed_octahedron, (0.0, 0.5, 4.0)),
    "step": (lambda: 255.0 * ramp(-closed_ball(), 0.0), (0.0, 1e-3, 127.5, 254.9)),
    "mask": (closed_mask, (0.0, 0.5, 0.999)),
    "terraces": (lambda: 3.0 * np.floor(closed_ball() / 3.0), (0.0, 3.0, 4.5)),
    "shells": (closed_shells, (0.0, 0.5)),
    "noise": (closed_noise, (0.0, 0.3, 0.5)),
    "noise of bytes": (lambda: np.floor(8.0 * closed_noise()).astype(np.uint8), (0.0, 2.0, 3.5)),
}
"""What makes a volume (CLOSED_SIDE³; z, y, x), and isovalues at and between its values where its
surface is closed.
"""
