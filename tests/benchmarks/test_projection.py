"""Ways to carry light from texels to pixels: against light that is known, the frames' own, and
search by hand.
"""

import math
from dataclasses import replace
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
from benchmarks.accuracy.projection import (
    Sides,
    bare_light,
    by_isovalues,
    by_normals,
    by_shares,
    by_shares_and_normals,
    errors_of_moves,
    plain,
    sides_of,
)
from isogi_core.frame import texel_shading
from isogi_core.frame.lighting import RotatedLight
from isogi_report.bench import ViewBake
from isogi_report.exact import straight_light, unrounded
from isogi_report.metrics import luminance_of
from tests.benchmarks.parts import CONSTANT, bench_of

SLOPE = np.array([1.0, -2.0, 0.5])


@pytest.fixture
def linear() -> Neighbourhood:
    """Pixels inside a lattice of 8³ texels whose light is 10 + SLOPE · place, all lit."""
    rng = np.random.default_rng(5)
    cells = rng.integers(1, 6, (50, 3))
    fractions = rng.random((50, 3))
    texels, numbers = texels_about(cells, (8, 8, 8))
    count = len(texels)
    light = 10.0 + texels @ SLOPE
    shares = np.full(count, 0.04), np.ones(count, np.bool_), rng.random(count)
    return Neighbourhood(
        numbers, fractions, light, 0.0 * light, *shares, np.tile((0.0, 0.0, 1.0), (count, 1))
    )


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
        assert (
            carry(linear, nearest(linear)).light[m]
            == linear.light[numbers[CORNERS[int(np.argmin(away))]]]
        )
        apart = [linear.apart[numbers[c]] for c in CORNERS]
        assert (
            carry(linear, closest_isovalue(linear)).light[m]
            == linear.light[numbers[CORNERS[int(np.argmin(apart))]]]
        )


def test_texels_without_light_are_left_out(linear: Neighbourhood) -> None:
    linear.lit[linear.numbers[0]] = False
    linear.lit[linear.numbers[0, CORNERS[3]]] = True
    for weigh in (nearest, closest_isovalue, trilinear):
        assert carry(linear, weigh(linear)).light[0] == linear.light[linear.numbers[0, CORNERS[3]]]


@pytest.mark.parametrize("shared", [False, True])
def test_frames_do_what_their_twins_say(
    shared: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Grey light and surfaces: twins know luminance alone."""
    monkeypatch.setattr(texel_shading, "carries_irradiance_ratios", lambda *_: shared)
    monkeypatch.setattr(carrying, "SAMPLES", 64)
    probe = {"type": "sky", "sun_azimuth": 30.0, "sun_elevation": 50.0}
    bench = bench_of(tmp_path, lights=[probe], albedo=0.7, lobes=1)
    bake = ViewBake(
        bench.renderer(bench.scene), bench.view, tuple(map(unrounded, bench.scene.plan.layers))
    )
    bake.grow(64)
    frame = bake.frame()
    sides = sides_of(bench)
    on = frame.state > 0
    carried = (by_shares_and_normals if shared else plain)(sides, sides.own)
    light = luminance_of(frame.radiance[on])
    assert np.allclose(carried.light + straight_light(bench), light, rtol=2e-2 if shared else 1e-4)
    assert np.allclose(np.sqrt(carried.noise), frame.error[on] * light, rtol=2e-2)


@pytest.fixture
def sides() -> Sides:
    """Pixels in a lattice of 8³ texels, lit as the cosine of their normals to a lamp's direction
    has it.
    """
    rng = np.random.default_rng(9)
    texels, numbers = texels_about(rng.integers(1, 6, (40, 3)), (8, 8, 8))
    count = len(texels)

    def around() -> Neighbourhood:
        normals = rng.normal(size=(count, 3)) * 0.3 + (0.0, 0.0, 1.0)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        shares = np.full(count, 1e-4), rng.random(count) < 0.9, rng.random(count)
        light = 2.0 * normals[:, 2], np.zeros(count)
        return Neighbourhood(numbers, rng.random((40, 3)), *light, *shares, normals)

    own = around()
    there = around()
    there = replace(there, fractions=own.fractions)
    pixels = rng.normal(size=(40, 3)) * 0.2 + (0.0, 0.0, 1.0)
    pixels /= np.linalg.norm(pixels, axis=1, keepdims=True)
    return Sides(own, there, rng.random(count), pixels, lambda normals: normals[:, 2])


def test_texels_are_moved_where_they_are_far_and_can_be(sides: Sides) -> None:
    for way in (0.0, 0.5, math.inf):
        there = sides.projected.lit & (sides.ways > way)
        found = sides.beyond(way)
        for name in ("light", "noise", "lit", "apart", "normals"):
            own = getattr(sides.own, name)
            other = getattr(sides.projected, name)
            assert all(
                np.array_equal(getattr(found, name)[t], (other if there[t] else own)[t])
                for t in range(len(there))
            )


def test_shares_pass_light_on_that_follows_the_normals(sides: Sides) -> None:
    assert np.allclose(by_shares(sides, sides.own).light, 2.0 * sides.normals[:, 2])
    assert not np.allclose(plain(sides, sides.own).light, 2.0 * sides.normals[:, 2], rtol=0.01)


def test_normals_and_isovalues_that_agree_weigh_nothing(sides: Sides) -> None:
    alike = replace(sides.own, normals=np.tile((0.0, 0.0, 1.0), (len(sides.ways), 1)))
    facing = replace(sides, own=alike, normals=np.tile((0.0, 0.0, 1.0), (40, 1)))
    expected = carry(alike, trilinear(alike))
    assert np.allclose(by_normals(facing, alike).light, expected.light)
    near = replace(facing, ways=np.zeros(len(sides.ways)))
    assert np.allclose(by_isovalues(near, alike).light, expected.light)


def test_a_texel_that_faces_away_hardly_counts(sides: Sides) -> None:
    turned = sides.own.normals.copy()
    corner = sides.own.numbers[0, carrying.CORNERS]
    turned[corner[1:]] = -sides.normals[0]
    turned[corner[0]] = sides.normals[0]
    around = replace(sides.own, normals=turned, lit=np.ones(len(turned), np.bool_))
    assert by_normals(sides, around).light[0] == pytest.approx(around.light[corner[0]], rel=1e-6)


def test_unshadowed_light_is_that_of_a_surface_which_sees_all(tmp_path: Path) -> None:
    normals = np.array([(0.0, 0.0, 1.0), (0.6, 0.0, -0.8), (0.0, 1.0, 0.0)])
    constant, under_sky = (
        bench_of(tmp_path, lights=[light]) for light in (CONSTANT, {"type": "sky", "ground": 0.1})
    )
    spec = constant.renderer(constant.scene).caches.spec("gi")
    flat = bare_light(RotatedLight(spec, constant.view))(normals) * spec.unit
    assert np.allclose(flat, luminance_of(np.array([constant.scene.surfaces.albedo]))), (
        "albedo under a radiance of 1"
    )
    spec = under_sky.renderer(under_sky.scene).caches.spec("gi")
    sky = bare_light(RotatedLight(spec, under_sky.view))(normals)
    assert sky[0] > sky[2] > sky[1] > 0.0, "up, level, down"
    assert (sky >= 0.02 * spec.unoccluded / spec.unit).all(), "no side is black"


def test_light_of_lobes_is_on_both_sides(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No texel keeps what comes straight from the sun: what is compared has it all the same."""
    monkeypatch.setattr(carrying, "SAMPLES", 64)
    bench = bench_of(tmp_path)
    assert bench.scene.plan.lobes
    assert max(each.rmse for each in errors_of_moves(bench).values()) < 0.1


def test_moved_texels_are_nearer_to_light_at_the_pixels(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(carrying, "SAMPLES", 256)
    found = errors_of_moves(
        bench_of(tmp_path, size=24, lights=[CONSTANT], lattice=0.5, target_error=0.05)
    )
    assert found["projected"].rmse < 0.8 * found["on their own isosurfaces"].rmse
