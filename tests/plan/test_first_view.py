"""The exposure of a scene: against closed forms and the light's own picture, and what it does not depend on."""

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
    FALL,
    FRONT,
    MAX_SHOWN_ALBEDO,
    SeenNormals,
    brightness,
    exposure_for,
    find_seen,
    percentile,
    surface_normals,
)
from isogi_core.plan.variants import at_time, cut_open, under, with_material
from tests.loaded import load_scene
from tests.stability.scenes import frame_of, lit, view_of

WHITE = np.ones(3)
GREY = (0.5, 0.5, 0.5)


def ball(side: int = 33, spacing: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> Volume:
    """The field of distances inwards from a ball's surface, a third of the box's shortest side, in the world."""
    axes = [(np.arange(side) - (side - 1) / 2) * step for step in spacing[::-1]]
    z, y, x = np.meshgrid(*axes, indexing="ij")
    return make_volume(side * min(spacing) / 3 - np.sqrt(x * x + y * y + z * z), spacing)


def seen_of(volume: Volume, front: tuple[float, float] = FRONT) -> SeenNormals:
    return find_seen(volume, volume.normalise_isovalue(0.0), front)


def lamp_from(azimuth: float, elevation: float, irradiance: float = math.pi) -> dict[str, Any]:
    return {"type": "directional", "azimuth": azimuth, "elevation": elevation, "irradiance": irradiance}


def test_brightness_is_the_integral_over_the_hemisphere() -> None:
    """Of a coloured light, soft enough for ten bands, by a sum over its pixels."""
    directions = pixel_directions(64, 128)
    image = np.exp(2.0 * directions @ np.array([0.6, 0.0, 0.8]))[..., None] * [1.0, 0.5, 0.25]
    normals = pixel_directions(4, 8).reshape(-1, 3)
    cosines = np.maximum(np.einsum("nc,hwc->nhw", normals, directions), 0.0)
    whole = np.einsum("nhw,hw,hwc->nc", cosines, solid_angles(64, 128), image) / math.pi
    light = project_image(image, 10)
    np.testing.assert_allclose(brightness(light, WHITE, normals), whole[:, 0], rtol=0.01, atol=0.005)
    np.testing.assert_allclose(brightness(light, np.array([0, 0, 1.0]), normals), whole[:, 2], rtol=0.01, atol=0.005)


def test_a_percentile_counts_weights() -> None:
    values, weights = np.array([3.0, 1.0, 2.0]), np.array([1.0, 97.0, 2.0])
    assert [percentile(values, weights, share) for share in (0.5, 0.98, 0.995)] == [1.0, 2.0, 3.0]


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.5, 1.0, 2.0)])
def test_normals_are_seen_as_a_camera_sees_a_ball(spacing: tuple[float, float, float]) -> None:
    """A ball's disc shows facing c with density 2c: its mean is 2/3, and the share below c is c²."""
    volume = ball(49, spacing)
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
    np.testing.assert_allclose(normals, [[0.0, 0.0, -1.0 if solid == "above" else 1.0]] * 49, atol=1e-6)


def test_a_ball_stands_for_a_surface_that_is_not_there() -> None:
    """And holes have no normals."""
    array = np.full((6, 6, 6), np.nan)
    array[:2] = [[[0.0]], [[1.0]]]
    volume = make_volume(array)
    assert len(surface_normals(volume, volume.normalise_isovalue(0.5))) == 25
    assert not len(surface_normals(volume, volume.normalise_isovalue(-5.0)))
    facing = find_seen(volume, volume.normalise_isovalue(-5.0), FRONT)
    assert exposure_for(np.full((3, 1), math.sqrt(4.0 * math.pi)), GREY, facing) == pytest.approx(1.0)


@pytest.mark.parametrize(("albedo", "shown"), [(0.2, 0.2), (0.7, 0.7), (0.95, MAX_SHOWN_ALBEDO)])
def test_even_light_shows_the_albedo_or_the_whitest(albedo: float, shown: float) -> None:
    scene = load_scene("demo:orbital", albedo=albedo, lights=[{"type": "constant", "radiance": 2.0}])
    assert 2.0 * albedo * scene.default_exposure == pytest.approx(shown, rel=0.005)


def test_a_light_from_behind_darkens_no_other_side_to_white() -> None:
    """From in front a lamp is about as bright as it is; from behind the surface would have none of it."""
    front, behind = (lit(ball(), 0.0, lamp_from(az, el)) for az, el in ((45.0, 25.0), (225.0, -25.0)))
    assert front.default_exposure == pytest.approx(1.0, abs=0.04)
    assert behind.default_exposure == pytest.approx(1.0 / FALL, abs=0.04)


def test_without_light_the_exposure_is_one() -> None:
    assert exposure_for(np.zeros((3, 100)), GREY, seen_of(ball())) == 1.0


def test_coloured_light_is_as_bright_as_its_strongest_channel() -> None:
    """A red lamp of luminance 0.21 fills its channel: it does not want five times the light."""
    red = {"type": "constant", "radiance": [1.0, 0.0, 0.0]}
    assert load_scene("demo:orbital", lights=[red]).default_exposure == pytest.approx(1.0, rel=0.005)


@pytest.mark.parametrize("environment", ["noon", "evening", "studio"])
def test_hardly_any_of_the_first_picture_is_white(environment: str) -> None:
    """Of what path tracing shows, shadows and reflections with the rest: but most of what is lit is bright."""
    scene = load_scene("demo:orbital", environment=environment)
    azimuth, elevation = FRONT
    view = view_of(scene, 48, azimuth=azimuth, elevation=elevation, distance=2.6, shading="path_traced", samples=32)
    frame = frame_of(scene, view)
    picture = develop(frame, scene.default_exposure)[frame.state > 0].max(axis=-1)
    assert (picture > 250).mean() <= 0.02
    assert np.quantile(picture, 0.95) > 200


def test_a_cut_and_another_material_keep_the_exposure() -> None:
    """A surface is as bright as it was before some of it was cut away; also where its scene's file says so."""
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
    series = np.stack([np.roll(ball(17).voxels, shift, axis=0) for shift in (0, 3)])
    np.savez(tmp_path / "series.npz", series)
    scene = load(tmp_path / "series.npz", time=0)
    assert scene.volume.moment == (0, 2)
    assert at_time(scene, 1, "later").default_exposure == scene.default_exposure
