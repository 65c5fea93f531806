"""Specimens with stiff fields: masks, ramps, terraces, streaks."""

import numpy as np

from benchmarks.stability.shapes import ball, body, grid, ramp
from benchmarks.stability.specimen import specimen

GROUP = "stiff fields"


@specimen(GROUP, "mask", 0.0, 0.5, 0.999)
def mask() -> np.ndarray:
    """A binary mask: every voxel lies on a plateau."""
    return ramp(body(), 0.0)


@specimen(GROUP, "mask of bytes", 0.5, 254.0)
def mask_of_bytes() -> np.ndarray:
    """The same as 0 and 255."""
    return (255 * ramp(body(), 0.0)).astype(np.uint8)


@specimen(GROUP, "ramp of a voxel", 0.25, 0.5)
def thin_ramp() -> np.ndarray:
    """From nothing to solid within one voxel."""
    return ramp(body(), 1.0)


@specimen(GROUP, "terraces", 0.25, 0.4)
def terraces() -> np.ndarray:
    """A wide ramp in eight steps: between them every voxel lies on a plateau, and 0.25 is one of them."""
    return (np.round(8 * ramp(body(), 24.0)) / 8).astype(np.float32)


@specimen(GROUP, "metal in a scan", 500.0, 3000.0)
def metal_in_a_scan() -> np.ndarray:
    """Twelve bits of tissue, noise, and metal that is clipped and streaks across the slice."""
    x, y, z = axes = grid(48, 48, 48)
    metal = ball(axes, (0.0, 0.0, 8.0), 4.0)
    streaks = 400.0 * np.cos(14 * np.arctan2(y, x)) * np.exp(-np.hypot(x, y) / 12 - abs(z - 8) / 3)
    noise = np.random.default_rng(5).normal(0.0, 20.0, x.shape)
    scan = 1000 * ramp(body(), 3.0) + 6000 * ramp(metal, 2.0) + streaks + noise
    return np.clip(np.rint(scan), 0, 4095).astype(np.uint16)


@specimen(GROUP, "gradients apart by 1e6", 0.0)
def gradients_apart() -> np.ndarray:
    """A body whose field rises a million times more steeply at one end than at the other."""
    x, _, _ = grid(48, 48, 48)
    return (-body() * 10.0 ** (6 * (x - x.min()) / np.ptp(x))).astype(np.float64)
