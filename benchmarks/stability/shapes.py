"""Solids that specimens are made of, as signed distances: negative within."""

import numpy as np

Solid = np.ndarray


def grid(*sides: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coordinates x, y, z (each nz, ny, nx) of a volume of ``sides`` (nx, ny, nz) voxels, from its middle."""
    x, y, z = (np.arange(n) - (n - 1) / 2 for n in sides)
    return tuple(np.meshgrid(z, y, x, indexing="ij"))[::-1]


def ball(grid: tuple[np.ndarray, ...], centre: tuple[float, float, float], radius: float) -> Solid:
    """Distance from a ball's skin."""
    return np.sqrt(sum((axis - c) ** 2 for axis, c in zip(grid, centre, strict=True))) - radius


def body(side: int = 48) -> Solid:
    """A bored ball, a small one beside it and a plate under both, (side,)³ voxels: it shades itself, and is smooth."""
    x, y, z = axes = grid(side, side, side)
    scale = side / 48
    large = ball(axes, (0.0, 0.0, -2.3 * scale), 13.1 * scale)
    small = ball(axes, (9.2 * scale, 3.1 * scale, 8.7 * scale), 7.4 * scale)
    plate = np.maximum.reduce([abs(x) - 20 * scale, abs(y) - 20 * scale, abs(z + 15 * scale) - 3 * scale])
    bore = np.hypot(x + 4 * scale, y - 3 * scale) - 4.2 * scale
    return np.minimum(np.minimum(np.maximum(large, -bore), small), plate)


def ramp(distance: Solid, width: float) -> np.ndarray:
    """The field 1 within, 0 without, and linear over ``width`` voxels across the skin; a mask where that is 0."""
    if width == 0.0:
        return (distance < 0.0).astype(np.float32)
    return np.clip(0.5 - distance / width, 0.0, 1.0).astype(np.float32)
