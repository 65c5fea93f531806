"""Filtering of pixels' own light, on surfaces that are known by formula."""

from collections.abc import Callable

import numpy as np
import pytest

from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.rays.pixel_filter import filter_pixels
from isogi_core.frame.tiles import Tiles
from isogi_core.model.sky import LUMINANCE

SIZE, NOISE = 48, 0.1
Bend = Callable[[np.ndarray, np.ndarray], np.ndarray]


def seen(depth: Bend, normal: tuple[float, float, float] | np.ndarray = (0.0, 0.0, 1.0)) -> GBuffer:
    """A surface that is seen from above in all pixels: its ``depth`` by x and y, in pixels."""
    y, x = (each.ravel().astype(np.float32) for each in np.mgrid[:SIZE, :SIZE])
    points = np.stack([x, y, depth(x, y)], axis=1).astype(np.float32)
    normals = np.ascontiguousarray(np.broadcast_to(np.float32(normal), points.shape))
    surface: object = None
    return GBuffer(
        (SIZE, SIZE),
        (1.0, 1.0, 1.0),
        (0.0, 0.0, 99.0),
        surface,  # type: ignore[arg-type]
        np.arange(SIZE**2, dtype=np.uint32),
        points,
        _normals=normals,
    )


def noisy(light: np.ndarray) -> np.ndarray:
    """Light (k,) as grey (k, 3) with the deviation NOISE."""
    return (light + np.random.default_rng(1).normal(0.0, NOISE, len(light)))[:, None].repeat(3, axis=1)


def filtered(light: np.ndarray, gbuffer: GBuffer) -> tuple[np.ndarray, np.ndarray]:
    """The luminance of noisy light once it is filtered, and its variance."""
    found, variance = filter_pixels(noisy(light), np.full(len(light), NOISE**2), gbuffer, Tiles(1))
    return found @ LUMINANCE, variance


@pytest.mark.parametrize("slope", [0.0, 1.0])
def test_even_light_loses_most_of_its_noise(slope: float) -> None:
    normal = np.array([-slope, 0.0, 1.0]) / np.hypot(slope, 1.0)
    found, variance = filtered(np.ones(SIZE**2), seen(lambda x, y: slope * x, normal))
    wrong = ((found - 1.0) ** 2).mean()
    assert wrong < 0.2 * NOISE**2
    assert variance.mean() == pytest.approx(wrong, rel=0.35), "and says how much is left"


def test_a_border_of_light_stays_sharp() -> None:
    """Light that differs by more than its noise is no noise."""
    light = np.where(np.arange(SIZE**2) % SIZE < SIZE // 2, 1.0, 3.0)
    found, _ = filtered(light, seen(lambda x, y: 0.0 * x))
    at_border = np.isin(np.arange(SIZE**2) % SIZE, (SIZE // 2 - 1, SIZE // 2))
    assert np.abs(found - light)[at_border].mean() < 1.5 * NOISE


def test_pixels_of_other_surfaces_are_left_out() -> None:
    """Half of the picture lies far behind, and a little darker: by less than the noise."""
    light = np.where(np.arange(SIZE**2) % SIZE < SIZE // 2, 1.0, 1.0 - NOISE)
    behind = filtered(light, seen(lambda x, y: np.where(x < SIZE // 2, 0.0, -40.0)))[0] - light
    beside = filtered(light, seen(lambda x, y: 0.0 * x))[0] - light
    left, right = (np.flatnonzero(np.arange(SIZE**2) % SIZE == SIZE // 2 - 1 + i) for i in (0, 1))
    assert abs(behind[left].mean()) < 0.5 * abs(beside[left].mean())
    assert abs(behind[right].mean()) < 0.5 * abs(beside[right].mean())


def test_a_pixel_alone_keeps_its_light() -> None:
    gbuffer = seen(lambda x, y: 0.0 * x)
    one = gbuffer.part(np.array([100]), Tiles(1))
    found, variance = filter_pixels(np.full((1, 3), 0.7), np.array([0.01]), one, Tiles(1))
    assert found.tolist() == [[0.7] * 3] and variance.tolist() == [0.01]
