"""What the eye sees through glass, against closed forms of balls and slabs."""

import math

import numpy as np
import pytest

from tests.kernels.fields import field_of
from tests.kernels.rooms import room_of, sky, wall
from tests.kernels.transport.matter.passables import LEAVES, ball, look, passable, slab

FACING = 0.04
"""What a surface of index 1.5 mirrors head on."""


def floor_at(z, radiance=0.0, albedo=0.5):
    """A large floor that faces up and down."""
    return wall((-500.0, -500.0, z), (1000.0, 0, 0), (0, 1000.0, 0), albedo, radiance, twofold=True)


@pytest.mark.parametrize("index", [1.0, 1.3, 1.5, 2.4])
def test_a_clear_ball_under_an_even_sky_is_not_seen(index):
    field = ball(4.0, 12)
    middle = 5.5
    aside = np.array([0.0, 0.5, 1.0, 2.0, 3.0, 3.9])
    points = np.column_stack(
        [middle + aside, np.full(6, middle), middle - np.sqrt(16.0 - aside**2)]
    )
    seen = look(field, passable(index=index), (middle, middle, -1e3), points, sky(1.0))
    np.testing.assert_allclose(seen.sky, 1.0, rtol=1e-5)


def test_a_ball_brings_rays_to_its_focus():
    """At n R / (2 (n - 1)) from its middle, for rays near the axis; farther ones go where two
    refractions send them.
    """
    n = 1.5
    radius = 16.0
    middle = 20.5
    focus = middle + n * radius / (2.0 * (n - 1.0))
    aside = np.array([0.01, 0.5, 1.0, 2.0])
    points = np.column_stack(
        [middle + aside, np.full(4, middle), middle - np.sqrt(radius**2 - aside**2)]
    )
    seen = look(ball(radius, 42), passable([floor_at(focus)]), (middle, middle, -1e6), points)
    shares = np.where(seen.met >= 0, seen.weights[:, 0], 0.0).reshape(4, LEAVES)
    through = np.arange(4) * LEAVES + shares.argmax(axis=1)
    angles = np.arcsin(aside / radius)
    other = np.arcsin(aside / radius / n)
    place = 2.0 * other - angles
    turned = 2.0 * (angles - other)
    true = radius * np.sin(place) - (focus - middle - radius * np.cos(place)) * np.tan(turned)
    assert abs(true[0]) < 1e-6
    np.testing.assert_allclose(seen.points[through, 0] - middle, true, atol=2e-3)
    np.testing.assert_allclose(seen.weights[through], (1.0 - FACING) ** 2, rtol=1e-3)


def test_a_slab_moves_rays_aside_and_absorbs_by_depth():
    """Snell: by d (tanθ - tanθ'); Beer: exp(-a d / cosθ'), times Fresnel's share twice."""
    angle = 0.6
    depth = 3.0
    absorption = 0.2
    field = slab(2.0, 2.0 + depth)
    met = passable([floor_at(-4.0)], absorption=absorption)
    way = np.array([math.sin(angle), 0.0, -math.cos(angle)])
    point = np.array([2.0, 3.5, 2.0 + depth])
    seen = look(field, met, point - 50.0 * way, point[None])
    other = math.asin(math.sin(angle) / 1.5)
    end = 2.0 + depth * math.tan(other) + 6.0 * math.tan(angle)
    place = int(np.where(seen.met >= 0, seen.weights[:, 0], 0.0).argmax())
    assert seen.points[place, 0] == pytest.approx(end, abs=2e-3)
    across = math.sin(angle - other) / math.sin(angle + other)
    along = math.tan(angle - other) / math.tan(angle + other)
    share = (across**2 + along**2) / 2.0
    left = (1.0 - share) ** 2 * math.exp(-absorption * depth / math.cos(other))
    np.testing.assert_allclose(seen.weights[place], left, rtol=1e-3)
    assert seen.sides[place] == 1


def test_walls_and_their_dark_backs_are_seen():
    field = ball(4.0, 12)
    lit, dark = (
        wall((-500.0, -500.0, 30.0), u, v, 0.5)
        for u, v in [((0, 1e3, 0), (1e3, 0, 0)), ((1e3, 0, 0), (0, 1e3, 0))]
    )
    front, back = (
        look(field, passable([each], 1.0), (5.5, 5.5, -50.0), [(5.5, 5.5, 1.5)])
        for each in (lit, dark)
    )
    assert front.met[0] == 0 and front.sides[0] == 1
    assert (front.met[1:] < 0).all() and (back.met < 0).all()
    assert room_of([dark]).normals[0, 2] > 0.0


def shares_on_walls(seen, breadth):
    """The share of its light that each tree sees on walls."""
    return np.where(seen.met >= 0, seen.weights[:, 0], 0.0).reshape(-1, breadth).sum(axis=1)


def test_ways_by_chance_are_right_on_the_average():
    """Rays that never part, and those that part as long as that counts: many times the same shares
    end on a floor.
    """
    field = ball(8.0, 20)
    middle = 9.5
    aside = np.array([0.5, 4.0, 6.0, 7.5])
    points = np.column_stack(
        [middle + aside, np.full(4, middle), middle - np.sqrt(64.0 - aside**2)]
    )
    glass = passable([floor_at(30.0)], index=1.8)
    eye = (middle, middle, -1e3)
    true = shares_on_walls(look(field, glass, eye, points, breadth=256), 256)
    for breadth, rtol in ((1, 0.03), (4, 0.015)):
        seen = look(field, glass, eye, points, breadth=breadth, samples=range(4096))
        found = shares_on_walls(seen, breadth).reshape(4, -1)
        assert found.std(axis=1).max() > 0.01
        np.testing.assert_allclose(found.mean(axis=1), true, rtol=rtol)
    greatest = shares_on_walls(look(field, glass, eye, points, breadth=1), 1)
    assert set(greatest) <= {0.0, 1.0}


@pytest.mark.parametrize(
    "breadth, cut", [(1, 2.0 * FACING), (2, FACING * (1.0 - FACING)), (8, 1e-3)]
)
def test_what_went_another_way_is_told(breadth, cut):
    """A slab from above: where rays part at no face, at the first, and at all that count."""
    field = slab(2.0, 5.0)
    met = passable([floor_at(-4.0)])
    seen = look(field, met, (3.5, 3.5, 50.0), [(3.5, 3.5, 5.0)], breadth=breadth)
    assert seen.cut[0] == pytest.approx(cut, rel=1e-3 if breadth < 3 else 1.0)


def test_a_prism_reflects_all_and_loses_nothing_by_it():
    """Down through its top, to +x by its slope of 45°, and out of its side: two faces part rays."""
    z, _, x = np.mgrid[:20, :20, :20].astype(float)
    prism = field_of(np.minimum(np.minimum(14.0 - z, 16.0 - x), x + z - 16.0))
    screen = wall((30.0, -500.0, -500.0), (0, 1e3, 0), (0, 0, 1e3), 0.5, twofold=True)
    top = (10.7, 9.5, 14.0)
    seen = look(prism, passable([screen]), (10.7, 9.5, 50.0), [top], breadth=1)
    np.testing.assert_allclose(seen.points[0], (30.0, 9.5, 5.3), atol=1e-2)
    assert seen.weights[0, 0] == pytest.approx(1.0)
    assert seen.cut[0] == pytest.approx(2.0 * FACING, rel=1e-3)


def test_beyond_the_last_interface_rays_go_straight_on():
    field = slab(2.0, 5.0)
    met = passable([floor_at(-4.0)])
    seen = look(field, met, (3.5, 3.5, 50.0), [(3.5, 3.5, 5.0)], deep=1)
    assert seen.cut[0] == pytest.approx(1.0 - FACING, rel=1e-3)
    np.testing.assert_allclose(shares_on_walls(seen, LEAVES), 1.0 - FACING, rtol=1e-3)
