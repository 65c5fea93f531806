"""Closed surfaces: fields that are outside on the faces of their box, at isovalues on and between lattice values."""

from collections.abc import Callable, Mapping

import numpy as np

from benchmarks.stability.shapes import ball, grid, ramp

SIDE = 41
MIDDLE = (SIDE - 1) / 2
RADIUS = 12.0


def _ball() -> np.ndarray:
    return -ball(grid(SIDE, SIDE, SIDE), (0.0, 0.0, 0.0), RADIUS)


def _octahedron() -> np.ndarray:
    x, y, z = grid(SIDE, SIDE, SIDE)
    return RADIUS - abs(x) - abs(y) - abs(z)


def _step() -> np.ndarray:
    return 255.0 * ramp(-_ball(), 0.0)


def _mask() -> np.ndarray:
    """A ball's mask with a quarter of the voxels near its skin left out."""
    distance = _ball()
    kept = np.random.default_rng(6).random(distance.shape) < 0.75
    return ((distance > 0.0) & (kept | (distance > RADIUS / 2))).astype(np.float32)


def _terraces() -> np.ndarray:
    return 3.0 * np.floor(_ball() / 3.0)


def _shells() -> np.ndarray:
    distance = _ball()
    return np.where(distance > 0.0, np.sin(1.3 * distance), 0.0)


def _noise() -> np.ndarray:
    return np.pad(np.random.default_rng(1).random((SIDE - 4,) * 3), 2)


def _noise_of_bytes() -> np.ndarray:
    return np.floor(8.0 * _noise()).astype(np.uint8)


CLOSED: Mapping[str, tuple[Callable[[], np.ndarray], tuple[float, ...]]] = {
    "ball": (_ball, (0.0, 1.3, 5.0)),
    "octahedron": (_octahedron, (0.0, 0.5, 4.0)),
    "step": (_step, (0.0, 1e-3, 127.5, 254.9)),
    "mask": (_mask, (0.0, 0.5, 0.999)),
    "terraces": (_terraces, (0.0, 3.0, 4.5)),
    "shells": (_shells, (0.0, 0.5)),
    "noise": (_noise, (0.0, 0.3, 0.5)),
    "noise of bytes": (_noise_of_bytes, (0.0, 2.0, 3.5)),
}
"""What makes the volume (SIDE³, z, y, x), and the isovalues at which its surface is closed."""
