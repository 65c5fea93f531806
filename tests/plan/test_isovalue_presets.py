"""First views: isovalues at boundaries between materials, and the exposure, against closed
forms.
"""

import math
from typing import Any

import numpy as np
import pytest

from isogi_core.frame.film import develop
from isogi_core.model.environment import pixel_directions, solid_angles
from isogi_core.model.volume import Volume, make_volume
from isogi_core.plan.assembly import load_scene as load
from isogi_core.plan.bands import project_image
from isogi_core.plan.isovalue_presets import (
    SeenNormals,
    brightness,
    exposure_for,
    find_boundaries,
    find_seen,
    front_of,
    peaks,
    percentile,
    prominence,
    surface_integrals,
    surface_normals,
)
from isogi_core.plan.variants import at_time, cut_open, under, with_material
from tests.loaded import load_scene
from tests.stability.scenes import frame_of, lit, view_of

Z, Y, X = np.mgrid[:32, :36, :40].astype(np.float64)


def ball(radius: float, softness: float) -> np.ndarray:
    """1 within a ball, 0 outside, and half-way at its radius."""
    distance = np.sqrt((X - 19.5) ** 2 + (Y - 17.5) ** 2 + (Z - 15.5) ** 2)
    return np.asarray(1.0 / (1.0 + np.exp((distance - radius) / softness)))


def materials(*values: float, softness: float = 0.5) -> np.ndarray:
    """Balls within each other, the outermost first, in a surrounding of 0."""
    steps = np.diff([0.0, *values])
    return np.asarray(sum(step * ball(14.0 - 4.0 * i, softness) for i, step in enumerate(steps)))


def found(array: np.ndarray, **more: str) -> tuple[float, ...]:
    volume = make_volume(array, **more)  # type: ignore[arg-type]
    return find_boundaries(volume, volume.value_range)


@pytest.mark.parametrize(
    ("values", "between"),
    [((100.0,), (50,)), ((100.0, 240.0), (50, 170)), ((60.0, 90.0), (30, 75))],
)
def test_a_boundary_is_half_way_between_two_materials(
    values: tuple[float, ...], between: tuple[float, ...]
) -> None:
    assert found(materials(*values)) == pytest.approx(between, abs=0.06 * max(values))


def test_which_side_is_solid_does_not_matter() -> None:
    array = materials(100.0, 240.0)
    assert found(array, solid="below") == found(array)


def test_a_mask_has_its_boundary_in_the_middle() -> None:
    assert found((materials(1.0) > 0.5).astype(np.uint8)) == pytest.approx((0.5,), abs=0.02)


def test_noise_in_a_material_is_no_boundary() -> None:
    noise = np.random.default_rng(3).normal(0.0, 3.0, X.shape)
    assert found(materials(100.0, 240.0) + noise) == pytest.approx((50, 170), abs=15)


@pytest.mark.parametrize("unit", [1e-300, 1e-3, 1e30, 1e305])
def test_units_do_not_matter(unit: float) -> None:
    assert np.divide(found(materials(100.0, 240.0) * unit), unit) == pytest.approx(
        (50, 170), abs=14
    )


def test_values_that_are_missing_or_far_off_are_not_looked_at() -> None:
    array = materials(100.0, 240.0)
    before = found(array)
    array[0, 0, :3] = np.nan, np.inf, 1e30
    volume = make_volume(array)
    assert find_boundaries(volume, volume.core) == before


def test_a_boundary_outside_the_range_is_not_suggested() -> None:
    volume = make_volume(materials(100.0, 240.0))
    assert find_boundaries(volume, (100.0, 240.0)) == pytest.approx((170,), abs=14)


@pytest.mark.parametrize("array", [np.zeros((4, 4, 4)), np.full((2, 2, 2), 7, np.uint8)])
def test_one_material_has_none(array: np.ndarray) -> None:
    assert found(array) == ()


def test_the_integrals_are_those_of_a_plane() -> None:
    """A ramp of slope 3 along y: each isosurface has the box's face for area, and 3 for
    gradient.
    """
    volume = make_volume(
        np.broadcast_to(6.0 * np.arange(9.0)[:, None], (5, 9, 7)).copy(), (4.0, 2.0, 3.0)
    )
    total, area = surface_integrals(volume)
    ratios = total[1:-1] / area[1:-1]
    assert len(ratios) > 100
    np.testing.assert_allclose(ratios, 3.0 / volume.scale, rtol=1e-6)
    assert np.ptp(area[1:-1]) == pytest.approx(0.0, abs=1e-9)


def test_prominence_is_the_fall_to_the_higher_saddle() -> None:
    curve = np.array([2.0, 5.0, 3.0, 4.0, 1.0, 9.0, 0.0])
    assert [prominence(curve, at) for at in (1, 2, 3, 5)] == [4.0, 0.0, 1.0, 9.0]


def test_a_plateau_is_one_peak() -> None:
    curve = np.zeros(100)
    curve[30:41] = 2.0
    curve[70] = 1.0
    assert peaks(curve) == [35.0, 70.0]


def test_the_engine_has_its_two_metals(shared_data: object) -> None:
    scene = load_scene(f"{shared_data}/engine_256x256x128_uint8.nhdr")
    assert [preset.isovalue for preset in scene.presets] == pytest.approx([75, 180], abs=12)
    assert [preset.name for preset in scene.presets] == [
        f"{preset.isovalue:g}" for preset in scene.presets
    ]


# --- exposure
# --------------------------------------------------------------------------------------------------


FRONT = (50.0, 25.0)
"""Azimuth and elevation from which surfaces are seen."""

WHITE = np.ones(3)
GREY = (0.5, 0.5, 0.5)


def ball_volume(side: int = 33, spacing: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> Volume:
    """The field of distances inwards from a ball's surface, a third of the box's shortest side, in
    the world.
    """
    axes = [(np.arange(side) - (side - 1) / 2) * step for step in spacing[::-1]]
    z, y, x = np.meshgrid(*axes, indexing="ij")
    return make_volume(side * min(spacing) / 3 - np.sqrt(x * x + y * y + z * z), spacing)


def seen_of(volume: Volume, front: tuple[float, float] = FRONT) -> SeenNormals:
    return find_seen(volume, volume.normalise_isovalue(0.0), front)


def lamp_from(azimuth: float, elevation: float, irradiance: float = math.pi) -> dict[str, Any]:
    return {
        "type": "directional",
        "azimuth": azimuth,
        "elevation": elevation,
        "irradiance": irradiance,
    }


def test_brightness_is_the_integral_over_the_hemisphere() -> None:
    """Of a coloured light, soft enough for ten bands, by a sum over its pixels."""
    directions = pixel_directions(64, 128)
    image = np.exp(2.0 * directions @ np.array([0.6, 0.0, 0.8]))[..., None] * [1.0, 0.5, 0.25]
    normals = pixel_directions(4, 8).reshape(-1, 3)
    cosines = np.maximum(np.einsum("nc,hwc->nhw", normals, directions), 0.0)
    whole = np.einsum("nhw,hw,hwc->nc", cosines, solid_angles(64, 128), image) / math.pi
    light = project_image(image, 10)
    np.testing.assert_allclose(
        brightness(light, WHITE, normals), whole[:, 0], rtol=0.01, atol=0.005
    )
    np.testing.assert_allclose(
        brightness(light, np.array([0, 0, 1.0]), normals), whole[:, 2], rtol=0.01, atol=0.005
    )


def test_a_percentile_counts_weights() -> None:
    values = np.array([3.0, 1.0, 2.0])
    weights = np.array([1.0, 97.0, 2.0])
    assert [percentile(values, weights, share) for share in (0.5, 0.98, 0.995)] == [1.0, 2.0, 3.0]


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.5, 1.0, 2.0)])
def test_normals_are_seen_as_a_camera_sees_a_ball(spacing: tuple[float, float, float]) -> None:
    """A ball's disc shows facing c with density 2c: its mean is 2/3, and the share below c is
    c².
    """
    volume = ball_volume(49, spacing)
    normals, weights = seen_of(volume)
    a, e = np.radians(FRONT)
    facing = normals @ [math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)]
    assert facing.min() > 0.0
    assert np.average(facing, weights=weights) == pytest.approx(2.0 / 3.0, abs=0.02)
    assert percentile(facing, weights, 0.25) == pytest.approx(0.5, abs=0.03)


@pytest.mark.parametrize("solid", ["above", "below"])
def test_normals_point_out_of_what_is_solid(solid: str) -> None:
    array = np.arange(8.0)[:, None, None] * np.ones((8, 8, 8))
    volume = make_volume(array, solid=solid)
    normals = surface_normals(volume, volume.normalise_isovalue(3.5))
    np.testing.assert_allclose(
        normals, [[0.0, 0.0, -1.0 if solid == "above" else 1.0]] * 49, atol=1e-6
    )


def test_a_ball_stands_for_a_surface_that_is_not_there() -> None:
    """And holes have no normals."""
    array = np.full((6, 6, 6), np.nan)
    array[:2] = [[[0.0]], [[1.0]]]
    volume = make_volume(array)
    assert len(surface_normals(volume, volume.normalise_isovalue(0.5))) == 25
    assert not len(surface_normals(volume, volume.normalise_isovalue(-5.0)))
    facing = find_seen(volume, volume.normalise_isovalue(-5.0), FRONT)
    assert exposure_for(np.full((3, 1), math.sqrt(4.0 * math.pi)), GREY, facing) == pytest.approx(
        1.0
    )


@pytest.mark.parametrize(
    ("albedo", "least", "most"), [(0.2, 0.199, 0.201), (0.7, 0.696, 0.704), (0.95, 0.7, 0.85)]
)
def test_even_light_shows_the_albedo_or_a_light_grey(
    albedo: float, least: float, most: float
) -> None:
    """White surfaces are darkened, so that their highlights keep shape."""
    scene = load_scene(
        "demo:orbital", albedo=albedo, lights=[{"type": "constant", "radiance": 2.0}]
    )
    assert least < 2.0 * albedo * scene.default_exposure < most


def test_a_light_from_behind_darkens_no_other_side_to_white() -> None:
    """From in front a lamp is about as bright as it is; from behind the surface would have none of
    it.
    """
    front, behind = (
        lit(ball_volume(), 0.0, lamp_from(az, el)) for az, el in ((45.0, 25.0), (225.0, -25.0))
    )
    assert front.default_exposure == pytest.approx(1.0, abs=0.04)
    assert 1.4 < behind.default_exposure < 2.8


def test_without_light_the_exposure_is_one() -> None:
    assert exposure_for(np.zeros((3, 100)), GREY, seen_of(ball_volume())) == 1.0


def test_coloured_light_is_as_bright_as_its_strongest_channel() -> None:
    """A red lamp of luminance 0.21 fills its channel: it does not want five times the light."""
    red = {"type": "constant", "radiance": [1.0, 0.0, 0.0]}
    assert load_scene("demo:orbital", lights=[red]).default_exposure == pytest.approx(
        1.0, rel=0.005
    )


@pytest.mark.parametrize("environment", ["noon", "evening", "studio"])
def test_hardly_any_of_the_first_picture_is_white(environment: str) -> None:
    """Of what path tracing shows, shadows and reflections with the rest: but most of what is lit is
    bright.
    """
    scene = load_scene("demo:orbital", environment=environment)
    azimuth, elevation = front_of(scene.volume, inside=False)
    view = view_of(
        scene,
        48,
        azimuth=azimuth,
        elevation=elevation,
        distance=2.6,
        shading="path_traced",
        samples=32,
    )
    frame = frame_of(scene, view)
    picture = develop(frame, scene.default_exposure)[frame.state > 0].max(axis=-1)
    assert (picture > 250).mean() <= 0.02
    assert np.quantile(picture, 0.95) > 200


def test_a_cut_and_another_material_keep_the_exposure() -> None:
    """A surface is as bright as it was before some of it was cut away; also where its scene's file
    says so.
    """
    scene = load("demo:orbital")
    middle = scene.volume.centre[2]
    cut = cut_open(scene, f"z>{middle}", "orbital@@cut")
    assert cut.seen is scene.seen and cut.default_exposure == scene.default_exposure
    assert load("demo:orbital", cut=f"z>{middle}").default_exposure == scene.default_exposure
    wax = with_material(scene, {"material": "subsurface"}, "wax")
    assert wax.seen is scene.seen
    evening = under(cut, "evening", "orbital@evening@cut")
    assert evening.seen is scene.seen and evening.default_exposure != scene.default_exposure


def test_steps_in_time_keep_the_exposure(tmp_path: Any) -> None:
    series = np.stack([np.roll(ball_volume(17).voxels, shift, axis=0) for shift in (0, 3)])
    np.savez(tmp_path / "series.npz", series)
    scene = load(tmp_path / "series.npz", time=0)
    assert scene.volume.moment == (0, 2)
    assert at_time(scene, 1, "later").default_exposure == scene.default_exposure
