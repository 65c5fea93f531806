"""Extreme light: too much of it, none, all from one point, from inside what it lights, and
turned.
"""

import math
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.noise import Goal
from isogi_core.frame.film import develop
from isogi_core.frame.frame import Frame
from isogi_core.kernels.transport.harmonics import MAX_ORDER, rotate
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.model.view import IDENTITY, Quaternion, rotation_matrix, unit_quaternion
from isogi_core.plan.scene import Scene
from isogi_server.parameters import ViewParams, read
from isogi_server.views import light_of
from tests.stability.scenes import (
    ABOVE,
    CONSTANT,
    HEIGHT,
    SIDE,
    Light,
    ball_volume,
    body_volume,
    frame_of,
    grey_levels,
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
    f"{name}, intensity {intensity:g}": {
        "type": "point",
        "position": [MIDDLE, MIDDLE, z],
        "intensity": intensity,
    }
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
    f"{angle:g}° wide, irradiance {irradiance:g}": {
        "type": "directional",
        "angle": angle,
        "irradiance": irradiance,
    }
    for angle in (0.0, 90.0)
    for irradiance in (0.0, 1e30)
}

DARK: Mapping[str, Light] = {
    "black probe": PROBES["all black"],
    "black constant": {**CONSTANT, "radiance": 0.0},
    "black sky": {"type": "sky", "scale": 0.0},
    **{
        name: light
        for name, light in (POINTS | SUNS).items()
        if name.endswith((" 0", "irradiance 0"))
    },
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
    """14° to 65° from the normal: order 6 leaves 13/256 of a cosine lobe's height, and less, to the
    next harmonics.
    """
    assert light_under_a_pixel(row, "gi", rotating=True) == pytest.approx(1.0, abs=0.06)


def light_under_a_pixel(row: int, shading: str, rotating: bool) -> float:
    """The mean radiance of an open plane under one pixel of a probe, over albedo · E / π."""
    scene = lit(plane_volume(), -HEIGHT, spot(32, 64, row, 10, 1e6), rotating=rotating, lobes=0)
    if shading == "path_traced":
        samples = {"samples": 64}
    else:
        samples = {}
    frame = frame_of(scene, view_of(scene, 8, shading=shading, **ABOVE, **samples))
    right = scene.surfaces.albedo[0] * irradiance_of_a_pixel(32, 64, row, 1e6) / math.pi
    return float(surface_light(frame).mean()) / right


def irradiance_of_a_pixel(height: int, width: int, row: int, radiance: float) -> float:
    """What a surface with normal +z receives from one pixel above it: L · 2π/w · (sin²θ_bottom -
    sin²θ_top) / 2.
    """
    top, bottom = (math.sin(math.pi * edge / height) ** 2 for edge in (row, row + 1))
    return radiance * math.pi / width * (bottom - top)


@pytest.mark.parametrize("exponent", [-100, -20, 20, 100])
def test_stronger_light_makes_the_same_frame_bit_for_bit(exponent: int) -> None:
    """Light of 2^exponent, and its error."""
    usual = frame_under_half_a_sky(1.0)
    strong = frame_under_half_a_sky(2.0**exponent)
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
        bake.grow(scene.plan.samples, Goal(scene.target_error))
        bake.frame()
        frame = bake.renderer.render(view)
    assert not frame.provisional
    assert not frame.radiance.any()
    assert frame.noise == 0.0
    assert 0 < bake.light.samples.max() <= 64


def test_harmonics_that_ring_below_zero_make_no_pixel_negative() -> None:
    """One bright pixel turned to the back of a body; what is kept of the transfer is not cut at
    zero.
    """
    light = spot(32, 64, 16, 40, 1e6)
    scene = lit(body_volume(24), 0.5, light, rotating=True, lobes=0, target_error=0.1)
    with view_bake(scene, view_of(scene, 24)) as bake:
        bake.grow(64)
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
    lamp: dict[str, Any] = {
        "position": [MIDDLE, MIDDLE, HEIGHT + distance],
        "intensity": distance**2,
    }
    scene = lit(plane_volume(), -HEIGHT, {"type": "point", **lamp})
    frame = frame_of(scene, view_of(scene, 11, **ABOVE))
    across = np.where(
        frame.state > 0, np.linalg.norm(frame.position[..., :2] - MIDDLE, axis=-1), math.inf
    )
    below = np.unravel_index(across.argmin(), across.shape)
    return float(frame.radiance[below] @ LUMINANCE_WEIGHTS) * math.pi / scene.surfaces.albedo[0]


Z = np.array([0.0, 0.0, 1.0])


def turning(q: Quaternion, order: int = MAX_ORDER) -> np.ndarray:
    """The matrix D (n², n²) of a rotation on coefficients: column i is what becomes of harmonic
    i.
    """
    turned = np.empty((order**2, order**2))
    rotate(order, rotation_matrix(q), np.eye(order**2), turned)
    return turned.T


def product(a: Quaternion, b: Quaternion) -> Quaternion:
    """The quaternion that does ``b`` first, then ``a``, as a client multiplies them: not brought to
    unit length.
    """
    (aw, ax, ay, az) = a
    (bw, bx, by, bz) = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def about(axis: np.ndarray, angle: float) -> Quaternion:
    """Rotation about a unit axis by an angle in radians."""
    x, y, z = (math.sin(angle / 2.0) * axis).tolist()
    return math.cos(angle / 2.0), x, y, z


def rotations(count: int) -> Iterator[Quaternion]:
    """Unit quaternions, even over all rotations."""
    for values in np.random.default_rng(6).normal(size=(count, 4)).tolist():
        w, x, y, z = values
        yield unit_quaternion((w, x, y, z))


def deviation(matrix: np.ndarray) -> float:
    """The largest element of |M Mᵀ - 1|."""
    transpose = matrix.T.copy()  # beside a view of itself BLAS multiplies ten times as slowly
    return float(np.abs(matrix @ transpose - np.eye(len(matrix))).max())


def apart(a: Quaternion, b: Quaternion) -> float:
    """The largest element of |D(a b) - D(a) D(b)|."""
    return float(np.abs(turning(product(a, b)) - turning(a) @ turning(b)).max())


@pytest.mark.parametrize("order", range(1, MAX_ORDER + 1))
def test_no_rotation_changes_no_bit(order: int) -> None:
    np.testing.assert_array_equal(turning(IDENTITY, order), np.eye(order**2))


def test_half_turns_or_nearly_so_are_orthogonal_and_compose() -> None:
    """About x, y, z and diagonals; exact, and off by 1e-16 … 1e-3."""
    axes = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 1.0, 0.0), (0.0, -1.0, 1.0)]
    off = [0.0, *(10.0**-k for k in range(3, 17))]
    turned = [unit_quaternion((w, *axis)) for axis in axes for w in off]
    assert max(deviation(turning(q)) for q in turned) <= 1e-12
    assert max(apart(a, b) for a, b in zip(turned, turned[::-1], strict=True)) <= 1e-12


@cache
def turning_scene() -> Scene:
    """A ball under a probe of 16 × 32 random pixels."""
    return lit(ball_volume(), 0.0, np.random.default_rng(1).uniform(0.0, 2.0, (16, 32, 3)) ** 4)


def turned_frame(scene: Scene, q: Quaternion, samples: int) -> Frame:
    """The frame of a scene under light turned by ``q``."""
    return frame_of(scene, view_of(scene, 16, light=q), samples)


def test_many_rotations_make_the_picture_of_the_one_they_make() -> None:
    """100,000 quaternions that a client multiplies and never brings to unit length."""
    turn = math.radians(0.7)
    count = 100_000
    axis = np.array([2.0, -3.0, 6.0]) / 7.0
    step = about(axis, turn)
    chained = IDENTITY
    for _ in range(count):
        chained = product(step, chained)
    scene = turning_scene()
    frames = (
        turned_frame(scene, q, 64)
        for q in (about(axis, count * turn), unit_quaternion(chained), IDENTITY)
    )
    right, found, unturned = (develop(frame, scene.default_exposure) for frame in frames)
    assert grey_levels(right, found) <= 1
    assert grey_levels(right, unturned) > 1


@pytest.mark.parametrize("order", range(1, MAX_ORDER + 1))
def test_a_quarter_turn_is_the_probe_rolled_by_a_quarter(order: int) -> None:
    """Exactly the same light in two ways, at every order of direct and of reflected light, baked
    and shown.
    """
    image = np.random.default_rng(2).uniform(0.0, 1.0, (8, 16, 3)) ** 3
    orders = {"order": order, "indirect_order": order, "bounces": 2}
    upright, rolled = (
        lit(body_volume(), 0.5, light, **orders) for light in (image, np.roll(image, 4, axis=1))
    )
    one = turned_frame(upright, about(Z, math.pi / 2.0), 16)
    other = turned_frame(rolled, IDENTITY, 16)
    assert float(np.abs(one.radiance - other.radiance).max()) <= 1e-5 * float(one.radiance.max())


@pytest.mark.parametrize("length", [1.0001e-3, 0.5, 1.0, 999.99])
def test_a_quaternion_of_any_length_turns_as_one_of_length_one(length: float) -> None:
    """By what the server reads."""
    scene = turning_scene()
    for q in rotations(100):
        query = ",".join(repr(length * value) for value in q)
        assert math.dist(light_of(scene, read(ViewParams, [("light", query)])), q) <= 1e-15
