"""Distances to interpolate: against the kernel's frame, linear light, and search by hand."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.accuracy import carrying
from benchmarks.accuracy.carrying import (
    CORNERS,
    TAPS,
    Neighbourhood,
    carry,
    closest_isovalue,
    nearest,
    texels_about,
    tricubic,
    trilinear,
)
from benchmarks.accuracy.projection import by_shares_and_normals, plain, sides_of
from isogi_core.frame import texel_shading
from isogi_report.bench import ViewBake
from isogi_report.exact import straight_light, unrounded
from isogi_report.metrics import luminance_of
from tests.benchmarks.parts import bench_of

SLOPE = np.array([1.0, -2.0, 0.5])


@pytest.fixture
def linear() -> Neighbourhood:
    """Pixels inside a lattice of 8³ texels whose light is 10 + SLOPE · place, all lit."""
    rng = np.random.default_rng(5)
    cells, fractions = rng.integers(1, 6, (50, 3)), rng.random((50, 3))
    texels, numbers = texels_about(cells, (8, 8, 8))
    count = len(texels)
    light = 10.0 + texels @ SLOPE
    shares = np.full(count, 0.04), np.ones(count, np.bool_), rng.random(count)
    return Neighbourhood(numbers, fractions, light, 0.0 * light, *shares, np.tile((0.0, 0.0, 1.0), (count, 1)))


def wanted(around: Neighbourhood) -> np.ndarray:
    """The linear light at the pixels: that of the cell's lowest corner and the slope from there."""
    lowest = around.light[around.numbers[:, (TAPS == 0).all(axis=1).argmax()]]
    return np.asarray(lowest + around.fractions @ SLOPE)


def test_trilinear_and_tricubic_pass_linear_light_on(linear: Neighbourhood) -> None:
    for weigh in (trilinear, tricubic):
        assert np.allclose(carry(linear, weigh(linear)).light, wanted(linear))


def test_weights_add_up_and_noise_falls_with_them(linear: Neighbourhood) -> None:
    for weigh in (nearest, closest_isovalue, trilinear, tricubic):
        weights = weigh(linear)
        assert np.allclose(weights.sum(axis=1), 1.0)
        assert np.allclose(carry(linear, weights).noise, 0.04 * (weights**2).sum(axis=1))


def test_single_texels_are_those_that_a_search_finds(linear: Neighbourhood) -> None:
    for m, numbers in enumerate(linear.numbers):
        away = [np.linalg.norm(TAPS[c] - linear.fractions[m]) for c in CORNERS]
        assert carry(linear, nearest(linear)).light[m] == linear.light[numbers[CORNERS[int(np.argmin(away))]]]
        apart = [linear.apart[numbers[c]] for c in CORNERS]
        assert carry(linear, closest_isovalue(linear)).light[m] == linear.light[numbers[CORNERS[int(np.argmin(apart))]]]


def test_texels_without_light_are_left_out(linear: Neighbourhood) -> None:
    linear.lit[linear.numbers[0]] = False
    linear.lit[linear.numbers[0, CORNERS[3]]] = True
    for weigh in (nearest, closest_isovalue, trilinear):
        assert carry(linear, weigh(linear)).light[0] == linear.light[linear.numbers[0, CORNERS[3]]]


@pytest.mark.parametrize("shared", [False, True])
def test_frames_do_what_their_twins_say(shared: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Grey light and surfaces: twins know luminance alone."""
    monkeypatch.setattr(texel_shading, "carries_irradiance_ratios", lambda *_: shared)
    monkeypatch.setattr(carrying, "SAMPLES", 64)
    probe = {"type": "sky", "sun_azimuth": 30.0, "sun_elevation": 50.0}
    bench = bench_of(tmp_path, lights=[probe], albedo=0.7, lobes=1)
    bake = ViewBake(bench.renderer(bench.scene), bench.view, tuple(map(unrounded, bench.scene.plan.layers)))
    bake.grow(64)
    frame, sides = bake.frame(), sides_of(bench)
    on = frame.state > 0
    carried = (by_shares_and_normals if shared else plain)(sides, sides.own)
    light = luminance_of(frame.radiance[on])
    assert np.allclose(carried.light + straight_light(bench), light, rtol=2e-2 if shared else 1e-4)
    assert np.allclose(np.sqrt(carried.noise), frame.error[on] * light, rtol=2e-2)
