"""Where texels are projected: stiffness of known fields, levels of a range, and what plans make of
both.
"""

import math
import re
from typing import Any

import numpy as np
import pytest

from isogi_core.errors import SceneError
from isogi_core.frame.tiles import Tiles
from isogi_core.model.volume import Isovalue, Volume, make_volume
from isogi_core.plan import projection
from isogi_core.plan.projection import (
    ProjectionPlan,
    Stiffness,
    adaptive_shares,
    find_stops,
    least_gradients,
    measure_stiffness,
    plan_projection,
    rounded,
    sample_range,
    shortened,
    spread_down,
)
from isogi_core.runs import serially
from tests.kernels.fields import field_of
from tests.loaded import load_scene

SIDE = 40


def ball(width: float) -> np.ndarray:
    """A ball of radius 13 whose skin is a ramp of ``width`` voxels; a mask where that is 0."""
    z, y, x = np.indices((SIDE,) * 3) - (SIDE - 1) / 2
    distance = np.sqrt(x * x + y * y + z * z) - 13.1
    if width:
        return np.clip(0.5 - distance / width, 0.0, 1.0)
    return (distance < 0.0).astype(float)


def stiffness(voxels: np.ndarray, *levels: float) -> Stiffness:
    return measure_stiffness(field_of(voxels), levels or (0.5,), serially)


def shares(found: Stiffness) -> tuple[float, float, float]:
    """Steep, plateau, noisy at the first isovalue."""
    steep, plateau, noisy = (
        float(found.share(each)[0]) for each in (found.steep, found.plateau, found.noisy)
    )
    return steep, plateau, noisy


@pytest.mark.parametrize("width", [8.0, 4.0, 3.0])
def test_a_ball_with_a_soft_skin_is_not_stiff(width: float) -> None:
    assert shares(stiffness(ball(width))) == (0.0, 0.0, 0.0)


def test_the_thinner_a_ramp_the_more_of_it_is_steep() -> None:
    steep = [shares(stiffness(ball(width)))[0] for width in (3.0, 2.0, 1.5, 1.0, 0.0)]
    assert steep == sorted(steep) and steep[1] < 0.2 and steep[3] > 0.9


def test_a_mask_is_steep_everywhere_and_no_more_than_steep() -> None:
    assert shares(stiffness(ball(0.0))) == (1.0, 0.0, 0.0)


def test_a_mask_seen_at_the_value_of_its_outside_is_on_a_plateau() -> None:
    steep, plateau, _ = shares(stiffness(ball(0.0), 0.0))
    assert steep == 1.0 and plateau > 0.5


def test_noise_is_noisy_and_a_little_noise_is_not() -> None:
    noise = np.random.default_rng(2).normal(size=(SIDE,) * 3)
    assert shares(stiffness(noise, 0.0))[2] > 0.9
    assert shares(stiffness(ball(8.0) + 0.01 * noise))[2] == 0.0


def test_terraces_are_plateaus_at_their_treads_values_alone() -> None:
    treads = np.floor(np.indices((30, 30, 30))[0] / 6.0)
    found = stiffness(treads, 1.0, 1.5)
    assert found.share(found.plateau).tolist() == [1.0, 0.0]
    assert found.share(found.steep).tolist() == [1.0, 1.0]


def test_a_surface_meets_the_faces_that_it_leads_to() -> None:
    """A rod along x through the box, cut off at y = 0 too."""
    rod = np.full((20, 20, 20), 0.0)
    rod[8:12, :12, :] = 1.0
    found = stiffness(rod)
    assert found.faces[:, 0].tolist() == [27, 27, 38, 0, 0, 0]


def test_cells_beside_a_hole_are_counted() -> None:
    voxels = ball(8.0)
    voxels[SIDE // 2, SIDE // 2, SIDE // 2 + 13] = np.nan
    found = stiffness(voxels)
    whole = stiffness(ball(8.0))
    assert whole.holed[0] == 0 and 0 < found.holed[0] < 50
    assert 0 < whole.cells[0] - found.cells[0] <= 8


def test_levels_ascend_and_threads_do_not_change_counts() -> None:
    voxels = np.random.default_rng(4).random((33, 12, 13))
    tiles = Tiles(3)
    one, many = (
        measure_stiffness(field_of(voxels), (0.7, 0.2, 0.7), run) for run in (serially, tiles.run)
    )
    tiles.close()
    assert one.levels.tolist() == np.float32([0.2, 0.7]).tolist()
    for name in ("cells", "steep", "plateau", "noisy", "holed", "faces"):
        np.testing.assert_array_equal(getattr(one, name), getattr(many, name))


def test_a_stiffer_surface_is_expected_to_err_more() -> None:
    soft, steep = (stiffness(each).expectation(0) for each in (ball(8.0), ball(0.0)))
    noise = stiffness(np.random.default_rng(2).normal(size=(SIDE,) * 3), 0.0).expectation(0)
    assert soft.low < soft.likely < soft.high
    assert soft.likely < steep.likely < noise.likely


# --- levels of a range
# ------------------------------------------------------------------------------------------------


def radial(
    profile, size: int = 33, spacing: tuple[float, float, float] = (1.0, 1.0, 1.0), **made
) -> Volume:  # type: ignore[no-untyped-def]
    """A volume of a ``profile`` of the distance from its middle, in the world."""
    axes = [(np.arange(size) - (size - 1) / 2.0) * step for step in spacing[::-1]]
    z, y, x = np.meshgrid(*axes, indexing="ij")
    return make_volume(profile(np.sqrt(x * x + y * y + z * z)).astype(np.float32), spacing, **made)


def test_uniform_levels_are_middles_of_equal_parts() -> None:
    volume = radial(lambda r: r)
    levels = sample_range(volume, (2.0, 12.0), 5, "uniform").levels
    assert levels == pytest.approx((3.0, 5.0, 7.0, 9.0, 11.0))


@pytest.mark.parametrize("solid", ["above", "below"])
def test_adaptive_surfaces_are_evenly_spaced(solid: str) -> None:
    """Of f = r², whose surfaces are balls of radius √c: even levels crowd outside, adaptive ones do
    not.
    """
    volume = radial(lambda r: r * r, size=65, solid=solid)
    levels = sample_range(volume, (100.0, 900.0), 12, "adaptive")
    radii = np.sqrt(levels.levels)
    even = np.sqrt(sample_range(volume, (100.0, 900.0), 12, "uniform").levels)
    assert (np.diff(levels.levels) > 0.0).all()
    assert (
        np.diff(radii).std() / np.diff(radii).mean()
        < 0.2
        < np.diff(even).std() / np.diff(even).mean()
    )
    assert levels.softened == 0.0
    assert levels.note == ""


def test_the_least_gradient_is_that_of_the_field() -> None:
    """|∇f| = 2r of f = r², whatever the voxels' shape; those of a cell's middle, next to the
    surface.
    """
    volume = radial(lambda r: r * r, size=65, spacing=(0.5, 1.0, 0.75))
    low, high = (float(volume.normalise_isovalue(each)) for each in (25.0, 225.0))
    found = least_gradients(volume, (low, high)) * abs(volume.scale)
    parts = len(found)
    radii = np.sqrt(25.0 + 200.0 * (np.arange(parts) + 0.5) / parts)
    assert (found <= 2.0 * radii + 1e-6).all()
    assert (found >= 2.0 * (radii - 1.0)).all()


def test_of_a_large_volume_some_cells_say_nearly_the_same() -> None:
    volume = radial(lambda r: r * r, size=65)
    whole, some = (
        sample_range(volume, (100.0, 900.0), 12, "adaptive", most).levels
        for most in (np.inf, volume.voxels.size / 40)
    )
    assert some != whole
    np.testing.assert_allclose(np.sqrt(some), np.sqrt(whole), atol=0.5)


def test_stops_are_spread_over_the_range_and_are_short_numbers() -> None:
    volume = radial(lambda r: r * r, size=65)
    stops = find_stops(volume, (100.0, 900.0)).levels
    assert len(stops) == 20
    assert np.diff([100.0, *stops, 900.0]).min() > 0.0
    assert max(len(f"{stop:.15g}") for stop in stops) <= 5
    assert find_stops(volume, (300.0, 300.0)).levels == ()


@pytest.mark.parametrize("outlier", [1e3, 1e30, -1e300, np.inf, np.nan])
@pytest.mark.parametrize("scale", [1e-300, 1.0, 1e200])
def test_outliers_move_no_stop(outlier: float, scale: float) -> None:
    values = np.random.default_rng(2).random((9, 9, 9)).cumsum(axis=0) * scale
    values[4, 4, 4] = outlier * scale
    volume = make_volume(values)
    stops = find_stops(volume, (scale, 4.0 * scale)).levels
    assert len(stops) == 20
    assert np.diff([1.0, *(stop / scale for stop in stops), 4.0]).min() > 0.0


@pytest.mark.parametrize("scale", [1e-320, 1e-30, 1.0, 1e30, 1e307])
def test_shortened_levels_stay_near_and_in_order(scale: float) -> None:
    levels = [scale * each for each in (-3.14159, 0.123456, 0.234567, 8.7654321)]
    short = shortened(levels, (-4.0 * scale, 9.0 * scale))
    moved = np.abs(np.array(short) / 2.0 - np.array(levels) / 2.0)
    assert (moved <= 0.026 * np.array([0.87, 0.12, 0.12, 0.24]) * scale).all()


def test_numbers_are_rounded_to_powers_of_ten() -> None:
    steps = {60.0: 120.0, 1.0: 123.0, 0.5: 123.5, 0.0: 123.456, float("inf"): 123.456}
    assert {most: rounded(123.456, most) for most in steps} == steps
    assert str(rounded(-0.2, 1.0)) == "0.0"


def test_noise_leaves_even_levels_and_says_so() -> None:
    noise = np.random.default_rng(5).normal(size=(40, 40, 40)).astype(np.float32)
    volume = make_volume(noise)
    adaptive, even = (sample_range(volume, (-1.0, 1.0), 8, way) for way in ("adaptive", "uniform"))
    assert adaptive.softened > 0.5
    assert "levels are even there" in adaptive.note
    np.testing.assert_allclose(adaptive.levels, even.levels, atol=0.15)


def test_no_level_is_in_a_gap_of_the_range() -> None:
    """Two plateaus, 0 and 10, a step between: no surface lies beyond 10, and levels stay below."""
    volume = make_volume(
        np.repeat([0.0, 10.0, 20.0], [8, 8, 1])[:, None, None] * np.ones((1, 6, 6), np.float32)
    )
    volume.voxels[-1] = np.nan
    levels = sample_range(volume, (0.0, 20.0), 6, "adaptive").levels
    assert min(levels) > 0.0
    assert max(levels) <= 10.05


@pytest.mark.parametrize(
    "ramps", [((0.0, 4.0), (16.0, 20.0)), ((8.0, 20.0),), ((3.01, 6.0), (13.0, 13.5))]
)
def test_no_level_is_between_or_before_surfaces(ramps: tuple[tuple[float, float], ...]) -> None:
    """Ramps between pairs of values, with a hole after each: each level is on a ramp, to half a
    thousandth of the range.
    """
    layers = np.array([value for ends in ramps for value in (*ends, np.nan)])
    volume = make_volume(layers[:, None, None] * np.ones((1, 6, 6)))
    shares, _ = adaptive_shares(volume, (0.0, 20.0), np.linspace(0.0, 1.0, 4000))
    part = 0.01
    for level in 20.0 * shares:
        assert any(low - part <= level <= high + part for low, high in ramps), level


def test_ranges_of_powers_of_two_spread_to_their_places() -> None:
    draw = np.random.default_rng(1)
    places = 64
    table = np.full((7, places), np.inf)
    expected = np.full(places, np.inf)
    for _ in range(40):
        level = int(draw.integers(7))
        first = int(draw.integers(places - (1 << level) + 1))
        value = float(draw.random())
        table[level, first] = min(table[level, first], value)
        expected[first : first + (1 << level)] = np.minimum(
            expected[first : first + (1 << level)], value
        )
    np.testing.assert_array_equal(spread_down(table), expected)


# --- plans
# --------------------------------------------------------------------------------------------------


def level(value: float) -> Isovalue:
    return Isovalue(np.float64(value))


def plan_of(errors: list[float], allowed: float = 0.01) -> ProjectionPlan:
    return ProjectionPlan(np.arange(len(errors), dtype=float), np.array(errors), allowed)


def stepped(height: float) -> np.ndarray:
    """A smooth slope along x up to 1, and a step of a ``height`` above it."""
    slope = np.minimum(np.arange(24) / 12.0, 1.0) + height * (np.arange(24) >= 18)
    return np.broadcast_to(slope, (20, 20, 24)).astype(np.float32).copy()


def test_the_error_at_the_nearest_level_counts() -> None:
    plan = plan_of([0.0, 0.02, 0.005])
    assert [plan.error(level(at)) for at in (-3, 0, 0.4, 0.6, 1, 1.4, 1.6, 9)] == [
        0,
        0,
        0,
        *[0.02] * 3,
        0.005,
        0.005,
    ]
    assert [plan.projects(level(at)) for at in (0, 0.4, 1, 1.4, 2)] == [
        False,
        False,
        True,
        True,
        False,
    ]


@pytest.mark.parametrize(
    ("errors", "spans"),
    [
        ([0.0, 0.0], []),
        ([0.0, 0.02, 0.0, 0.0, 0.03], [(0.5, 1.5), (3.5, 4.0)]),
        ([0.02, 0.0, 0.02], [(0.0, 0.5), (1.5, 2.0)]),
        ([0.0, 0.02, 0.02, 0.0], [(0.5, 2.5)]),
        ([0.02], [(0.0, 0.0)]),
    ],
)
def test_spans_hold_just_the_isovalues_that_project(
    errors: list[float], spans: list[tuple[float, float]]
) -> None:
    plan = plan_of(errors)
    assert plan.spans() == spans and plan.any == bool(spans)
    for at in np.linspace(0.0, len(errors) - 1, 8 * len(errors)).tolist():
        inside = any(low <= at <= high for low, high in spans)
        assert plan.projects(level(at)) == inside or at % 1.0 == 0.5


def test_a_steep_surface_is_projected_and_a_smooth_one_is_not() -> None:
    """A step errs by 1 to 2 %: more than a target of 2 % allows. A slope errs by less, and at 4 %
    nothing is projected.
    """
    field = field_of(stepped(2.0))
    span = (level(0.0), level(3.0))
    plan = plan_projection(field, span, level(2.0), 0.02)
    assert 0.0025 < plan.error(level(0.5)) < 0.01 < plan.error(level(2.0)) < 0.02
    assert not plan.projects(level(0.5)) and plan.projects(level(2.0))
    assert not plan_projection(field, span, level(2.0), 0.04).any


def test_a_sample_of_layers_tells_what_all_of_them_tell() -> None:
    rng = np.random.default_rng(3)
    z, y, x = np.mgrid[:64, :40, :40]
    voxels = (
        np.hypot(np.hypot(x - 20, y - 20), z / 2 - 16) / 20 + 0.1 * rng.normal(size=x.shape)
    ).astype(np.float32)
    whole, part = (
        measure_stiffness(field_of(voxels), (0.4, 0.6), most=most)
        for most in (None, voxels.size // 8)
    )
    assert (part.cells < 0.2 * whole.cells).all() and (part.cells > 0.05 * whole.cells).all()
    for place in range(2):
        assert part.expectation(place).likely == pytest.approx(
            whole.expectation(place).likely, rel=0.1
        )
        assert whole.expectation(place).likely > 0.029


@pytest.mark.parametrize("most", [1, 100, 1 << 30])
def test_a_sample_of_a_thin_volume_is_not_empty(most: int) -> None:
    found = measure_stiffness(field_of(stepped(2.0)[:3]), (2.0,), most=most)
    assert found.cells[0] > 0 and found.share(found.steep)[0] == 1.0


@pytest.mark.parametrize("projected", [True, False])
def test_a_scene_may_settle_it(projected: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(projection, "count_stiffness", None)
    scene = load_scene("demo:orbital", projected=projected)
    assert scene.projection.any is projected
    assert scene.projection.spans() == ([scene.span] if projected else [])
    assert any(each.what == "surface-projected texels" for each in scene.left_out) is not projected
    other = load_scene("demo:orbital", projected=not projected)
    assert scene.digest != other.digest and scene.bake_digest == other.bake_digest


def test_what_is_left_out_says_what_interpolation_errs_by() -> None:
    scene = load_scene("demo:orbital", lattice=0.4)
    (found,) = (each for each in scene.left_out if each.what == "surface-projected texels")
    error = scene.projection.error(scene.start)
    said = re.match(r"The error of interpolation is about ([\d.]+)", found.why)
    assert said is not None and math.isclose(float(said[1]), 100.0 * error, rel_tol=1e-2)


@pytest.mark.parametrize("settings", [{"sharpen": True}, {"sharpen": False}])
def test_the_former_key_is_refused_with_the_new_one(settings: dict[str, Any]) -> None:
    with pytest.raises(SceneError, match="projected = false"):
        load_scene("demo:orbital", **settings)
