"""Turned light: rotations of harmonics, and rotations that clients send."""

import math
from collections.abc import Iterator
from functools import cache

import numpy as np
import pytest

from isogi_core.frame.film import develop
from isogi_core.frame.frame import Frame
from isogi_core.kernels.transport.harmonics import MAX_ORDER, rotate
from isogi_core.model.view import IDENTITY, Quaternion, rotation_matrix, unit_quaternion
from isogi_core.plan.scene import Scene
from server.parameters import ViewParams, read
from server.views import light_of
from tests.stability.scenes import ball_volume, body_volume, frame_of, grey_levels, lit, view_of

Z = np.array([0.0, 0.0, 1.0])


def turning(q: Quaternion, order: int = MAX_ORDER) -> np.ndarray:
    """The matrix D (n², n²) of a rotation on coefficients: column i is what becomes of harmonic i."""
    turned = np.empty((order**2, order**2))
    rotate(order, rotation_matrix(q), np.eye(order**2), turned)
    return turned.T


def product(a: Quaternion, b: Quaternion) -> Quaternion:
    """The quaternion that does ``b`` first, then ``a``, as a client multiplies them: not brought to unit length."""
    (aw, ax, ay, az), (bw, bx, by, bz) = a, b
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
    turn, count = math.radians(0.7), 100_000
    axis = np.array([2.0, -3.0, 6.0]) / 7.0
    step, chained = about(axis, turn), IDENTITY
    for _ in range(count):
        chained = product(step, chained)
    scene = turning_scene()
    frames = (turned_frame(scene, q, 64) for q in (about(axis, count * turn), unit_quaternion(chained), IDENTITY))
    right, found, unturned = (develop(frame, scene.default_exposure) for frame in frames)
    assert grey_levels(right, found) <= 1
    assert grey_levels(right, unturned) > 1


@pytest.mark.parametrize("order", range(1, MAX_ORDER + 1))
def test_a_quarter_turn_is_the_probe_rolled_by_a_quarter(order: int) -> None:
    """Exactly the same light in two ways, at every order of direct and of reflected light, baked and shown."""
    image = np.random.default_rng(2).uniform(0.0, 1.0, (8, 16, 3)) ** 3
    orders = {"order": order, "indirect_order": order, "bounces": 2}
    upright, rolled = (lit(body_volume(), 0.5, light, **orders) for light in (image, np.roll(image, 4, axis=1)))
    one, other = turned_frame(upright, about(Z, math.pi / 2.0), 16), turned_frame(rolled, IDENTITY, 16)
    assert float(np.abs(one.radiance - other.radiance).max()) <= 1e-5 * float(one.radiance.max())


@pytest.mark.parametrize("length", [1.0001e-3, 0.5, 1.0, 999.99])
def test_a_quaternion_of_any_length_turns_as_one_of_length_one(length: float) -> None:
    """By what the server reads."""
    scene = turning_scene()
    for q in rotations(100):
        query = ",".join(repr(length * value) for value in q)
        assert math.dist(light_of(scene, read(ViewParams, [("light", query)])), q) <= 1e-15
