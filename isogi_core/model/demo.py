"""Built-in volumes, computed from formulas; they are shown if no file is given."""

import math
from collections.abc import Callable, Iterable
from functools import reduce
from typing import NamedTuple

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.model.volume import Volume, make_volume

Pair = tuple[float, float]


class Demo(NamedTuple):
    """A demo: the function ``build`` that makes its array (z, y, x), the ``isovalue`` at which
    views start, and a one-line ``description``.
    """

    build: Callable[[], np.ndarray]
    isovalue: float
    description: str


def demo_volume(name: str) -> Volume:
    """Return the demo volume ``name``, with spacing 1. Raises VolumeError if there is none."""
    if name not in DEMOS:
        raise VolumeError(f"There is no demo '{name}': choose one of {', '.join(DEMOS)}.")
    return make_volume(DEMOS[name].build(), name=name)


_AXES = ((96, (96, 1, 1)), (128, (1, 128, 1)), (128, (1, 1, 128)))
"""Number of voxels of the casting along z, y, x, and the shape in which their indices broadcast to
the volume.
"""


def casting() -> np.ndarray:
    """Return a cast two-cylinder engine block, (96, 128, 128) float32 from 0 to 255, made from a
    signed distance.

    The value is 255 / (1 + e^(d/1.5)). In size, d is the distance in voxels to the surface of the
    part, or less near edges and fillets; it is negative within. Isovalue 127.5 is the part; lower
    ones grow it, higher ones thin it. From isovalue 1 on every surface is closed within the box.
    """
    z, y, x = (np.arange(count, dtype=np.float32).reshape(shape) for count, shape in _AXES)
    # The part is the metal without the cuts.
    distance = np.maximum(_metal(x, y, z), -_cuts(x, y, z))
    return np.asarray(255.0 / (1.0 + np.exp(distance / 1.5)), np.float32)


def orbital() -> np.ndarray:
    """Return the probability density of the hydrogen orbital 4f z³, (96, 96, 96) float32, with
    greatest value 1.

    |ψ|² ∝ (z (5z² - 3r²) e^(-r/4))², with lengths in Bohr radii, 36 from the middle to each face.
    """
    steps = np.linspace(-36.0, 36.0, 96)
    z, y, x = np.meshgrid(steps, steps, steps, indexing="ij", sparse=True)
    squared = x * x + y * y + z * z
    density = (z * (5.0 * z * z - 3.0 * squared) * np.exp(-np.sqrt(squared) / 4.0)) ** 2
    return np.asarray(density / density.max(), np.float32)


_BARRELS = ((43.5, 64.0), (84.5, 64.0))


def _metal(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return the signed distance in voxels, negative within, to the cast metal: crankcase, barrels,
    fins, flanges, ribs and ports.
    """
    # Each part is a profile in the plane of two axes, swept over an interval of the third; the
    # parts are joined with fillets, as cast metal has them.
    crankcase = _extrude(_rectangle(x, y, (64.0, 64.0), (44.0, 34.0), 7.0), _slab(z, 24.0, 14.0))
    sole = _extrude(_rectangle(x, y, (64.0, 64.0), (53.0, 51.0), 9.0), _slab(z, 13.0, 3.2))
    barrels = _extrude(_discs(x, y, _BARRELS, 18.5), _slab(z, 58.0, 25.0))
    levels = [_slab(z, 45.0 + 5.6 * i, 0.9) for i in range(6)]
    fins = _extrude(_rectangle(x, y, (64.0, 64.0), (46.5, 31.0), 15.0), reduce(np.minimum, levels))
    deck = _extrude(_rectangle(x, y, (64.0, 64.0), (45.0, 26.0), 8.0), _slab(z, 81.5, 3.0))
    walls = [_rectangle(x, z, (24.0 + 16.0 * i, 22.0), (1.1, 10.0), 1.0) for i in range(6)]
    ribs = _extrude(reduce(np.minimum, walls), np.maximum(_slab(y, 64.0, 47.0), _lean(y, z)))
    ports = _extrude(_discs(x, z, [(cx, 59.0) for cx, _ in _BARRELS], 8.5), _slab(y, 88.0, 22.0))
    mouth = _extrude(_rectangle(x, z, (64.0, 59.0), (36.0, 11.0), 5.0), _slab(y, 108.5, 2.6))
    parts = (sole, barrels, fins, deck, ribs, ports, mouth)
    return reduce(_blend, parts, crankcase)


def _cuts(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return the signed distance in voxels, negative within, to the drilled holes: bores, crank
    tunnel, holes in the feet, bolt holes, oil galleries, port channels and flange screws.
    """
    # Each hole is a disc swept along its axis, over an interval of which the middle and the half
    # length are given; it goes on beyond the metal where it is open. Edges between holes stay
    # sharp.
    bores = _extrude(_discs(x, y, _BARRELS, 13.0), _slab(z, 62.0, 36.0))
    tunnel = _extrude(_discs(y, z, [(64.0, 25.0)], 9.5), _slab(x, 64.0, 60.0))
    corners = [(64.0 + 46.5 * i, 64.0 + 44.0 * j) for i in (-1, 0, 1) for j in (-1, 1)]
    feet = _extrude(_discs(x, y, corners, 3.2), _slab(z, 13.0, 8.0))
    # Four bolts are at the corners of the deck, and two between the barrels.
    studs = [(64.0 + 39.0 * i, 64.0 + 20.0 * j) for i in (-1, 1) for j in (-1, 1)]
    bolts = _extrude(_discs(x, y, [*studs, (64.0, 43.5), (64.0, 84.5)], 2.6), _slab(z, 70.0, 32.0))
    galleries = _extrude(
        _discs(x, z, [(64.0, 30.0), (28.0, 31.0), (100.0, 31.0)], 3.0), _slab(y, 64.0, 60.0)
    )
    channels = _extrude(_discs(x, z, [(cx, 59.0) for cx, _ in _BARRELS], 5.2), _slab(y, 92.0, 26.0))
    flange = [(64.0 + 31.0 * i, 59.0 + 6.5 * j) for i in (-1, 1) for j in (-1, 1)]
    screws = _extrude(_discs(x, z, flange, 1.9), _slab(y, 108.0, 8.0))
    parts = (tunnel, feet, bolts, galleries, channels, screws)
    return reduce(np.minimum, parts, bores)


def _lean(y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return the signed distance to the wedge below the sloping backs of the ribs."""
    return np.asarray((np.abs(y - 64.0) + z - 72.0) * math.sqrt(0.5))


def _discs(a: np.ndarray, b: np.ndarray, centres: Iterable[Pair], radius: float) -> np.ndarray:
    """Return the signed distance, in the plane of the axes ``a`` and ``b``, to discs of one
    ``radius``.
    """
    return reduce(np.minimum, [np.hypot(a - ca, b - cb) - np.float32(radius) for ca, cb in centres])


def _rectangle(a: np.ndarray, b: np.ndarray, centre: Pair, half: Pair, radius: float) -> np.ndarray:
    """Return the signed distance, in the plane of the axes ``a`` and ``b``, to a rectangle with
    round corners.
    """
    return (
        _extrude(_slab(a, centre[0], half[0] - radius), _slab(b, centre[1], half[1] - radius))
        - radius
    )


def _slab(a: np.ndarray, centre: float, half: float) -> np.ndarray:
    """Return the signed distance along one axis to the interval centre ± half."""
    return np.asarray(np.abs(a - centre) - half)


def _extrude(profile: np.ndarray, slab: np.ndarray) -> np.ndarray:
    """Return the signed distance to a ``profile`` swept over a ``slab`` across it."""
    outside = np.hypot(np.maximum(profile, 0.0), np.maximum(slab, 0.0))
    return np.asarray(outside + np.minimum(np.maximum(profile, slab), 0.0))


def _blend(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the union of two distances with a fillet: the smaller one, reduced if both are
    within 3 voxels of each other.
    """
    near = np.maximum(3.0 - np.abs(a - b), 0.0)
    return np.asarray(np.minimum(a, b) - near * near / 12.0)


DEMOS = {
    "casting": Demo(
        casting, 127.5, "a cast engine block: deep bores, fins, ports, holes and thin webs"
    ),
    "orbital": Demo(orbital, 0.03, "electron density of a hydrogen atom in the state 4f z³"),
}
"""The demos by name."""
