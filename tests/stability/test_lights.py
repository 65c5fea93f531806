"""Extreme light: too much of it, none, all from one point, or from inside what it lights."""

import math
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
import pytest

from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.model.scene_plan import MIN_SAMPLES
from tests.stability.scenes import (
    ABOVE,
    CONSTANT,
    HEIGHT,
    SIDE,
    Light,
    body_volume,
    frame_of,
    is_finite,
    lit,
    plane_volume,
    spot,
    surface_light,
    view_bake,
    view_of,
)

MIDDLE = (SIDE - 1) / 2.0

PROBES: Mapping[str, np.ndarray] = {
    "one pixel of 1e6": spot(32, 64, 3, 10, 1e6),
    "one pixel of 1e30": spot(32, 64, 3, 10, 1e30),
    "one pixel of 1e30 beside 1e-30": spot(32, 64, 3, 10, 1e30, 1e-30),
    "one pixel below the plane": spot(32, 64, 30, 10, 1e6),
    "all black": np.zeros((8, 16, 3)),
    "all 1e-30": np.full((8, 16, 3), 1e-30),
    "all 1e30": np.full((8, 16, 3), 1e30),
    "a single pixel": np.ones((1, 1, 3)),
    "two pixels": spot(2, 1, 0, 0, 2.0),
    "one column": spot(64, 1, 3, 0, 10.0),
    "one row": spot(1, 64, 0, 3, 10.0),
    "red alone": np.ones((4, 8, 3)) * (1e6, 0.0, 0.0),
}

SKIES: Mapping[str, Light] = {
    f"sun at {elevation:g}°, turbidity {turbidity:g}": {
        "type": "sky",
        "sun_elevation": elevation,
        "turbidity": turbidity,
    }
    for elevation in (0.0, 90.0)
    for turbidity in (1.9, 10.0)
}
"""At the ends of their ranges."""

PLACES = {"inside": 2.0, "on the surface": HEIGHT, "touching": HEIGHT + 0.3, "far": 1e6 * SIDE}
"""Heights of point lamps, in voxels, beside the plane."""

POINTS: Mapping[str, Light] = {
    f"{name}, intensity {intensity:g}": {"type": "point", "position": [MIDDLE, MIDDLE, z], "intensity": intensity}
    for name, z in PLACES.items()
    for intensity in (0.0, 1.0, 1e30)
}

AREAS: Mapping[str, Light] = {
    f"of side {side:g} at {z:g}": {
        "type": "area",
        "corner": [MIDDLE, MIDDLE, z],
        "u": [0.0, side, 0.0],
        "v": [side, 0.0, 0.0],
    }
    for side, z in ((4.0, HEIGHT), (4.0, 2.0), (1e9, 1e9), (1e-12, 8.0))
}

SUNS: Mapping[str, Light] = {
    f"{angle:g}° wide, irradiance {irradiance:g}": {"type": "directional", "angle": angle, "irradiance": irradiance}
    for angle in (0.0, 90.0)
    for irradiance in (0.0, 1e30)
}

DARK: Mapping[str, Light] = {
    "black probe": PROBES["all black"],
    "black constant": {**CONSTANT, "radiance": 0.0},
    "black sky": {"type": "sky", "scale": 0.0},
    **{name: light for name, light in (POINTS | SUNS).items() if name.endswith((" 0", "irradiance 0"))},
}

STILL: Mapping[str, Light] = {**PROBES, **SKIES, **POINTS, **AREAS, **SUNS}
TURNING: Mapping[str, Light] = {**PROBES, **SKIES}


@pytest.mark.parametrize(
    ("light", "rotating"),
    [
        *(pytest.param(light, False, id=name) for name, light in STILL.items()),
        *(pytest.param(light, True, id=f"{name}, turning") for name, light in TURNING.items()),
    ],
)
def test_frames_under_hard_lights_are_finite(light: Light, rotating: bool) -> None:
    """Of a plane, by shadings that treat light differently."""
    scene = lit(plane_volume(), -HEIGHT, light, rotating=rotating, target_error=0.1)
    for shading in ("gi", "path_traced", "lambert_shadow"):
        assert is_finite(frame_of(scene, view_of(scene, 6, shading=shading, **ABOVE))), shading


@pytest.mark.parametrize("shading", ["gi", "path_traced"])
@pytest.mark.parametrize("row", [2, 8, 14])
def test_one_bright_pixel_lights_a_plane_by_the_cosine_law(row: int, shading: str) -> None:
    """14° to 82° from the normal; baked as irradiance, and path-traced."""
    assert light_under_a_pixel(row, shading, rotating=False) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("row", [2, 8, 11])
def test_harmonics_of_one_pixel_keep_the_cosine_law(row: int) -> None:
    """14° to 65° from the normal: order 6 leaves 13/256 of a cosine lobe's height, and less, to the next harmonics."""
    assert light_under_a_pixel(row, "gi", rotating=True) == pytest.approx(1.0, abs=0.06)


def light_under_a_pixel(row: int, shading: str, rotating: bool) -> float:
    """The mean radiance of an open plane under one pixel of a probe, over albedo · E / π."""
    scene = lit(plane_volume(), -HEIGHT, spot(32, 64, row, 10, 1e6), rotating=rotating, lobes=0)
    samples = {"samples": 64} if shading == "path_traced" else {}
    frame = frame_of(scene, view_of(scene, 8, shading=shading, **ABOVE, **samples))
    right = scene.surfaces.albedo[0] * irradiance_of_a_pixel(32, 64, row, 1e6) / math.pi
    return float(surface_light(frame).mean()) / right


def irradiance_of_a_pixel(height: int, width: int, row: int, radiance: float) -> float:
    """What a surface with normal +z receives from one pixel above it: L · 2π/w · (sin²θ_bottom - sin²θ_top) / 2."""
    top, bottom = (math.sin(math.pi * edge / height) ** 2 for edge in (row, row + 1))
    return radiance * math.pi / width * (bottom - top)


@pytest.mark.parametrize("exponent", [-100, -20, 20, 100])
def test_stronger_light_makes_the_same_frame_bit_for_bit(exponent: int) -> None:
    """Light of 2^exponent, and its error."""
    usual, strong = frame_under_half_a_sky(1.0), frame_under_half_a_sky(2.0**exponent)
    assert usual[..., :3].any()
    np.testing.assert_array_equal(strong, usual)


@cache
def frame_under_half_a_sky(radiance: float) -> np.ndarray:
    """Light over ``radiance``, and error, of the body under a half sky of it; (h, w, 4)."""
    half = np.zeros((8, 16, 3))
    half[:4] = radiance
    scene = lit(body_volume(), 0.5, half)
    frame = frame_of(scene, view_of(scene, 12), 64)
    return np.concatenate([frame.radiance / radiance, frame.error[..., None]], axis=-1)


@pytest.mark.parametrize("light", DARK.values(), ids=DARK)
def test_frames_without_light_are_black_and_soon_final(light: Light) -> None:
    """After the fewest samples: baking ends."""
    scene = lit(plane_volume(), -HEIGHT, light)
    view = view_of(scene, 8, **ABOVE)
    with view_bake(scene, view) as bake:
        bake.grow(scene.plan.samples, scene.target_error)
        bake.frame()
        frame = bake.renderer.render(view)
    assert not frame.provisional
    assert not frame.radiance.any()
    assert frame.noise == 0.0
    assert 0 < bake.light.samples.max() <= MIN_SAMPLES


def test_harmonics_that_ring_below_zero_make_no_pixel_negative() -> None:
    """One bright pixel turned to the back of a body; what is kept of the transfer is not cut at zero."""
    light = spot(32, 64, 16, 40, 1e6)
    scene = lit(body_volume(24), 0.5, light, rotating=True, lobes=0, target_error=0.1)
    with view_bake(scene, view_of(scene, 24)) as bake:
        bake.grow(MIN_SAMPLES)
        radiance = bake.frame().radiance
    shares = (bake.light.transfer @ bake.spec.luminance_light.T)[~bake.light.void]
    assert (shares < 0.0).any()
    assert (radiance >= 0.0).all()


@pytest.mark.parametrize("boxes", [1e2, 1e4, 1e6])
def test_a_plane_far_below_a_lamp_receives_intensity_over_r2(boxes: float) -> None:
    assert light_below_a_lamp(boxes * SIDE) == pytest.approx(1.0, abs=0.001)


def test_a_lamp_nearby_counts_as_nearer_by_the_ray_offset() -> None:
    """A known fault: light is gathered where rays start, 0.3 voxel above the surface."""
    assert light_below_a_lamp(4.0) == pytest.approx((4.0 / (4.0 - 0.3)) ** 2, abs=0.04)


def light_below_a_lamp(distance: float) -> float:
    """The radiance right below a lamp of intensity r², at ``distance`` r, over albedo / π."""
    lamp: dict[str, Any] = {"position": [MIDDLE, MIDDLE, HEIGHT + distance], "intensity": distance**2}
    scene = lit(plane_volume(), -HEIGHT, {"type": "point", **lamp})
    frame = frame_of(scene, view_of(scene, 11, **ABOVE))
    across = np.where(frame.state > 0, np.linalg.norm(frame.position[..., :2] - MIDDLE, axis=-1), math.inf)
    below = np.unravel_index(across.argmin(), across.shape)
    return float(frame.radiance[below] @ LUMINANCE_WEIGHTS) * math.pi / scene.surfaces.albedo[0]
