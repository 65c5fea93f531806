"""Cases of turned light: rotations of harmonics, and rotations that clients send."""

import math
from collections.abc import Iterator
from functools import cache

import numpy as np

from benchmarks.stability.case import Outcome, Size, case
from benchmarks.stability.lighting import ball, lit, solid
from benchmarks.stability.pictures import grey_levels
from benchmarks.stability.stage import frame_of, view_of
from isogi_core.frame.film import develop
from isogi_core.frame.frame import Frame
from isogi_core.kernels.harmonics import MAX_ORDER, rotate
from isogi_core.model.scene import Scene
from isogi_core.model.view import IDENTITY, Quaternion, rotation_matrix, unit_quaternion
from server.params import ViewParams, read
from server.views import light_of

GROUP = "turned light"


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


def rotations(count: int) -> Iterator[Quaternion]:
    """Unit quaternions, even over all rotations."""
    for values in np.random.default_rng(6).normal(size=(count, 4)).tolist():
        w, x, y, z = values
        yield unit_quaternion((w, x, y, z))


@case(GROUP, "orthogonal", "M Mᵀ = 1 of rotations of harmonics of order 10, in double precision", 1e-12, "absolute")
def orthogonal(size: Size) -> Outcome:
    """The largest element of what is left."""
    count = size.pick(1000, 1000, 100_000)
    worst = max(deviation(turning(q)) for q in rotations(count))
    return Outcome(worst, f"{count} rotations")


def deviation(matrix: np.ndarray) -> float:
    """The largest element of |M Mᵀ - 1|."""
    transpose = matrix.T.copy()  # beside a view of itself BLAS multiplies ten times as slowly
    return float(np.abs(matrix @ transpose - np.eye(len(matrix))).max())


@case(GROUP, "composing", "D(a b) = D(a) D(b), in double precision", 1e-12, "absolute")
def composing(size: Size) -> Outcome:
    """The largest element of the difference."""
    count = size.pick(1000, 1000, 100_000)
    return Outcome(max(apart(a, b) for a, b in pairs(count)), f"{count} pairs")


def pairs(count: int) -> Iterator[tuple[Quaternion, Quaternion]]:
    """Pairs of rotations."""
    each = rotations(2 * count)
    yield from zip(each, each, strict=True)


def apart(a: Quaternion, b: Quaternion) -> float:
    """The largest element of |D(a b) - D(a) D(b)|."""
    return float(np.abs(turning(product(a, b)) - turning(a) @ turning(b)).max())


@case(GROUP, "as used", "the same of coefficients in single floats, as frames have them", 1e-5, "absolute")
def as_used(size: Size) -> Outcome:
    """Both, of matrices rounded to float32, in arithmetic of float32."""
    count = size.pick(200, 1000, 100_000)
    worst = 0.0
    for a, b in pairs(count):
        one, other, both = (turning(q).astype(np.float32) for q in (a, b, product(a, b)))
        worst = max(worst, deviation(one), float(np.abs(both - one @ other).max()))
    return Outcome(worst, f"{count} pairs")


@case(GROUP, "identity", "no rotation changes no bit", 0, "absolute")
def identity(_: Size) -> Outcome:
    """At every order."""
    orders = range(1, MAX_ORDER + 1)
    return Outcome(max(float(np.abs(turning(IDENTITY, order) - np.eye(order**2)).max()) for order in orders))


@case(
    GROUP,
    "half turns and poles",
    "half turns, or nearly so, are orthogonal and compose",
    1e-12,
    "absolute",
)
def half_turns(_: Size) -> Outcome:
    """About x, y, z and diagonals; exact, and off by 1e-16 … 1e-3."""
    axes = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 1.0, 0.0), (0.0, -1.0, 1.0)]
    off = [0.0, *(10.0**-k for k in range(3, 17))]
    turned = [unit_quaternion((w, *axis)) for axis in axes for w in off]
    worst = max(max(deviation(turning(a)), apart(a, b)) for a, b in zip(turned, turned[::-1], strict=True))
    return Outcome(worst, f"{len(turned)} rotations")


@case(GROUP, "rotations put together", "the picture after 1e5 rotations is that of the one they make", 1, "grey levels")
def put_together(size: Size) -> Outcome:
    """A client multiplies quaternions and never brings them to unit length; the truth has its axis and all angles."""
    turn, count = math.radians(0.7), 100_000
    axis = np.array([2.0, -3.0, 6.0]) / 7.0
    step, chained = about(axis, turn), IDENTITY
    for _ in range(count):
        chained = product(step, chained)
    scene = turning_scene()
    one, other = (turned_frame(scene, q, size) for q in (about(axis, count * turn), unit_quaternion(chained)))
    pictures = [develop(frame, scene.default_exposure) for frame in (one, other)]
    return Outcome(grey_levels(*pictures), f"length {math.hypot(*chained) - 1.0:+.1e}")


def about(axis: np.ndarray, angle: float) -> Quaternion:
    """Rotation about a unit axis by an angle in radians."""
    x, y, z = (math.sin(angle / 2.0) * axis).tolist()
    return math.cos(angle / 2.0), x, y, z


@cache
def turning_scene() -> Scene:
    """A ball under a probe of 16 × 32 random pixels."""
    return lit(ball(), 0.0, np.random.default_rng(1).uniform(0.0, 2.0, (16, 32, 3)) ** 4)


def turned_frame(scene: Scene, q: Quaternion, size: Size, samples: int = 64) -> Frame:
    """The frame of a scene under light turned by ``q``."""
    return frame_of(scene, view_of(scene, size.pick(16, 64), light=q), samples)


@case(GROUP, "orders 1 to 10", "turning light by 90° about z is rolling its probe by a quarter", 1e-5, "relative")
def orders(size: Size) -> Outcome:
    """Exactly the same light in two ways, at every order of direct and of reflected light, baked and shown."""
    worst = max(roll_error(order, size) for order in range(1, MAX_ORDER + 1))
    return Outcome(worst, "of the brightest pixel")


def roll_error(order: int, size: Size) -> float:
    """How far both are from each other at one order."""
    image = np.random.default_rng(2).uniform(0.0, 1.0, (8, 16, 3)) ** 3
    told = {"order": order, "indirect_order": order, "bounces": 2}
    upright, rolled = (lit(solid(), 0.5, light, **told) for light in (image, np.roll(image, 4, axis=1)))
    quarter = about(np.array([0.0, 0.0, 1.0]), math.pi / 2.0)
    one, other = turned_frame(upright, quarter, size, 16).radiance, turned_frame(rolled, IDENTITY, size, 16).radiance
    return float(np.abs(one - other).max() / one.max())


@case(GROUP, "any length", "a quaternion of length 1e-3 to 1e3 turns as that of length 1", 1e-15, "absolute")
def any_length(_: Size) -> Outcome:
    """By what the server reads."""
    sent = [(q, scale) for q in rotations(100) for scale in (1.0001e-3, 0.5, 1.0, 999.99)]
    return Outcome(max(math.dist(served([scale * v for v in q]), q) for q, scale in sent), f"{len(sent)} quaternions")


def served(values: list[float]) -> Quaternion:
    """The light rotation that a query with these numbers makes."""
    return light_of(turning_scene(), read(ViewParams, [("light", ",".join(map(repr, values)))]))
