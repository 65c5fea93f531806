"""Extreme settings: albedo, bounces, isovalues, lattices, offsets and target errors, to their
ends.
"""

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from isogi_core.errors import IsogiError
from isogi_core.frame.frame import Frame
from isogi_core.model.volume import Volume, make_volume
from isogi_core.plan.scene import Scene
from isogi_server.parameters import ViewParams, read
from isogi_server.views import isovalue_of
from tests.stability.scenes import (
    CONSTANT,
    ball_volume,
    body_volume,
    frame_of,
    is_finite,
    lit,
    view_of,
)
from tests.stability.volumes import grid


def constant_volume() -> Volume:
    """One value everywhere."""
    return make_volume(np.full((8, 8, 8), 3.0))


every_volume = pytest.mark.parametrize("make", [body_volume, ball_volume, constant_volume])


def shown(scene: Scene, samples: int | None = None) -> Frame:
    """The baked frame of a scene."""
    return frame_of(scene, view_of(scene, 16), samples)


def white_body(**settings: Any) -> np.ndarray:
    """The radiance of the pixels of a white body in light of 1, with bounces enough to leave most
    creases.
    """
    scene = lit(body_volume(), 0.5, CONSTANT, **{"albedo": 1.0, "bounces": 1000, **settings})
    frame = shown(scene, 64)
    return np.asarray(frame.radiance[frame.state > 0, 0])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("albedo", 1.0),
        ("albedo", 1.0 - 1e-7),
        ("albedo", [1.0, 0.0, 0.0]),
        ("lattice", 0.125),
        ("lattice", 4.0),
        ("offset", 2.0),
        ("normals", "gradient"),
        ("target_error", 1.0),
        ("precision", "single"),
    ],
)
def test_a_white_body_in_light_of_one_has_radiance_one(name: str, value: Any) -> None:
    """Whatever else is set; of the red body, in red."""
    assert float(white_body(**{name: value}).mean()) == pytest.approx(1.0, abs=0.005)


def test_without_an_offset_pixels_beside_creases_lose_light() -> None:
    """A known fault: up to half of it.

    A texel in a crease may be nearly shut in by its own isosurface: from right on the surface its
    paths take more bounces to come out than there are.
    """
    pixels = white_body(offset=0.0)
    assert np.abs(pixels - 1.0).max() <= 0.5
    assert float(np.median(pixels)) == pytest.approx(1.0, abs=0.005)


@pytest.mark.parametrize(
    ("albedo", "black"), [(0.0, [0, 1, 2]), ([1.0, 0.0, 0.0], [1, 2])], ids=["all", "but red"]
)
def test_channels_of_albedo_zero_are_black(albedo: Any, black: list[int]) -> None:
    frame = shown(lit(body_volume(), 0.5, CONSTANT, albedo=albedo), 16)
    assert (frame.radiance[..., black] == 0.0).all()
    assert frame.radiance.any() == (len(black) < 3)


@pytest.mark.parametrize(
    ("albedo", "bounces"),
    [(0.5, 1), (0.5, 4), (1.0, 8), (0.9, 1000), pytest.param(0.99, 1000, marks=pytest.mark.slow)],
)
def test_bounces_in_a_closed_cavity_add_up_to_a_series(albedo: float, bounces: int) -> None:
    """1 + R + … + R^k, and 1 / (1 - R) for 1000."""
    series = math.fsum(albedo**j for j in range(bounces + 1))
    assert cavity_light(albedo, bounces) / cavity_light(albedo, 0) == pytest.approx(
        series, rel=0.01
    )


@cache
def cavity_light(albedo: float, bounces: int) -> float:
    """Mean radiance within a hollow ball around a lamp, seen from within."""
    x, y, z = grid(32, 32, 32)
    hollow = make_volume(np.sqrt(x**2 + y**2 + z**2), name="hollow")
    lamp = {"type": "point", "position": list(hollow.centre), "intensity": 1.0}
    scene = lit(hollow, 12.0, lamp, albedo=albedo, bounces=bounces)
    frame = frame_of(scene, view_of(scene, 8, distance=0.1, fov=90.0), 64)
    return float(frame.radiance[frame.state > 0].mean())


@every_volume
def test_frames_at_the_ends_of_the_range_are_finite(make: Any) -> None:
    """At both, and at the next numbers within."""
    volume = make()
    low, high = volume.value_range
    for isovalue in (low, math.nextafter(low, high), math.nextafter(high, low), high):
        assert is_finite(shown(lit(volume, isovalue, CONSTANT, target_error=0.1), 16)), isovalue


@every_volume
def test_a_frame_at_the_greatest_value_is_empty_and_final(make: Any) -> None:
    """What is solid exceeds the isovalue; a constant volume is nowhere solid."""
    volume = make()
    frame = shown(lit(volume, volume.value_range[1], CONSTANT), 16)
    assert (frame.surface, frame.provisional, frame.noise) == (0, 0, 0.0)


def test_a_range_of_one_isovalue_shows_it_as_a_wide_one_does() -> None:
    """The texels that can show it are counted all the same."""
    wide = lit(body_volume(), 0.5, CONSTANT)
    narrow = replace(wide, isovalues=(0.5, 0.5))
    np.testing.assert_array_equal(shown(narrow, 16).radiance, shown(wide, 16).radiance)
    assert 0 < narrow.texels.shown < wide.texels.shown


@pytest.mark.parametrize("target", [1.0, 0.1, 0.02, 0.002])
def test_final_light_is_as_good_as_the_target_error(target: float) -> None:
    """A ball in even light: the root mean square of what it is off by, and the frame's own
    error.
    """
    scene = lit(ball_volume(), 0.0, CONSTANT, target_error=target, bounces=0)
    frame = shown(scene)
    light = frame.radiance[frame.state > 0, 0] / scene.surfaces.albedo[0]
    assert len(light)
    assert math.sqrt(float(((light - 1.0) ** 2).mean())) <= target
    assert frame.noise <= target


@cache
def ball_scene() -> Scene:
    """A ball in constant light."""
    return lit(ball_volume(), 0.0, CONSTANT)


@pytest.mark.parametrize(("end", "beyond"), [(0, -math.inf), (1, math.inf)], ids=["below", "above"])
def test_isovalues_just_outside_the_range_are_refused(end: int, beyond: float) -> None:
    """By the least step of a double."""
    scene = ball_scene()
    isovalue = math.nextafter(scene.isovalues[end], beyond)
    with pytest.raises(IsogiError, match=r"\.\Z"):
        isovalue_of(scene, read(ViewParams, [("isovalue", repr(isovalue))]))
