"""Rays of shine: what they bring of every kind of light is the integral of the lobe over it,
whatever draws them.
"""

import math

import numpy as np
import pytest

from isogi_core.kernels.shading.shine import (
    MET_ISOSURFACE,
    MET_NOTHING,
    ShineDraws,
    ShineEnds,
    cast_shine,
    fill_below,
    light_ends,
)
from isogi_core.kernels.shading.surface_points import SurfacePoints, pool_noise
from isogi_core.kernels.transport.light_paths import Surroundings
from isogi_core.kernels.transport.lights import (
    DIRECTIONAL,
    NO_LAMPS,
    NO_TABLE,
    POINT,
    LampArrays,
)
from isogi_core.kernels.transport.microfacets import ENERGY_STEPS, ShineLobe, fill_energy
from isogi_core.kernels.transport.ray_lights import Discs, Panels, ShineLights
from isogi_core.model.environment import bright_table, pixel_directions, solid_angles
from tests.kernels.fields import field_of, surface_of
from tests.kernels.rooms import box, room_of, wall
from tests.scale import few

RAYS = few(1 << 15, 1 << 9)
NONE = np.empty((0, 3))
NO_PANELS = Panels(NONE, np.empty((0, 2, 3)), NONE, np.empty(0), np.empty(0))
NO_DISCS = Discs(NONE, np.empty((0, 2, 3)), NONE)
EYE = (12.0, 4.0, 14.0)


@pytest.fixture(scope="module")
def ground():
    """The plane z = 4.5 of a field of 9 × 9 × 9 voxels, solid below."""
    z = np.arange(9.0)[:, None, None]
    return surface_of(field_of(np.broadcast_to(9.0 - z, (9, 9, 9))), 4.5)


def lobe_of(roughness, facing=0.04, metal=False, aside=0.4, strength=1.0):
    """A lobe with its table."""
    energy = np.empty((ENERGY_STEPS + 1, 2))
    fill_energy(roughness**2, energy)
    return ShineLobe(roughness**2, (facing,) * 3, strength, metal, aside, energy)


def lights_of(around, panels=NO_PANELS, discs=NO_DISCS, ways=4):
    """All light of a scene."""
    return ShineLights(around, panels, discs, 0.1, ways)


def sky(radiance=0.0, lamps=NO_LAMPS):
    """The same light from everywhere, and lamps."""
    return Surroundings(
        np.full(3, radiance), np.zeros((1, 1, 3), np.float32), np.eye(3), NO_TABLE, lamps
    )


def point_at(x=4.0, y=4.0, z=4.5, normal=(0.0, 0.0, 1.0)):
    """One point of a picture."""
    return SurfacePoints(
        np.array([[x, y, z]], np.float32), np.array([normal], np.float32), np.zeros(1, np.uint32)
    )


def cast(surface, lobe, lights, room=None, points=None, rays=RAYS):
    """The ends of many rays from one point, all of one sequence."""
    brought, weights, *there = np.empty((4, rays, 3), np.float32)
    ends = ShineEnds(
        brought,
        weights,
        SurfacePoints(*there, np.arange(rays, dtype=np.uint32)),
        np.empty(rays, np.int8),
    )
    draws = ShineDraws(np.zeros(rays, np.int64), np.full(rays, 77, np.uint64), np.arange(rays))
    cast_shine(surface, room or room_of([]), points or point_at(), EYE, lobe, lights, draws, ends)
    return ends


def to_eye(points):
    """The unit direction to the eye."""
    away = np.array(EYE) - points.points[0]
    return away / np.linalg.norm(away)


def mirrored(lobe, v, ways):
    """f cosθ of a lobe about +z towards ``v`` from directions (n, 3); NumPy; (n,)."""
    h = v + ways
    h /= np.linalg.norm(h, axis=1, keepdims=True)
    cosine = h[:, 2]
    alpha = lobe.alpha
    d = alpha**2 / (np.pi * (cosine**2 * (alpha**2 - 1.0) + 1.0) ** 2)

    def hidden(c):
        return 0.5 * (np.sqrt(1.0 + alpha**2 * (1.0 / np.maximum(c, 1e-9) ** 2 - 1.0)) - 1.0)

    g = 1.0 / (1.0 + hidden(v[2]) + hidden(ways[:, 2]))
    f = lobe.facing[0] + (1.0 - lobe.facing[0]) * (1.0 - np.clip(h @ v, 0.0, 1.0)) ** 5
    return np.where(ways[:, 2] > 0.0, lobe.strength * f * d * g / (4.0 * v[2]), 0.0)


@pytest.mark.parametrize("metal", [False, True])
@pytest.mark.parametrize("roughness", [0.1, 0.3, 0.6, 1.0])
def test_a_white_sky_is_mirrored_as_the_table_says(ground, roughness, metal):
    lobe = lobe_of(roughness, 0.7 if metal else 0.04, metal)
    points = point_at()
    below = np.empty((1, 3), np.float32)
    ends = cast(ground, lobe, lights_of(sky(2.0), ways=1))
    fill_below(points, EYE, (1.0, 1.0, 1.0), lobe._replace(metal=False), below)
    assert (ends.met == MET_NOTHING).all()
    assert ends.brought.mean(axis=0) == pytest.approx(2.0 * (1.0 - below[0]), rel=5e-3)


@pytest.mark.parametrize("roughness", [0.1, 0.3, 0.6])
def test_a_bright_image_is_integrated_over_the_lobe(ground, roughness):
    image = np.full((16, 32, 3), 0.1, np.float32)
    mirror = to_eye(point_at()) * (-1.0, -1.0, 1.0)
    row = int(math.acos(mirror[2]) / math.pi * 16)
    image[row, int((math.atan2(mirror[1], mirror[0]) / (2.0 * math.pi) % 1.0) * 32)] = 50.0
    image[3, 3] = 20.0
    table = bright_table(image, np.maximum(image[..., 0] - image[..., 0].mean(), 0.0))
    around = Surroundings(np.zeros(3), image, np.eye(3), table)
    lobe = lobe_of(roughness)
    fine = few(64, 24)
    ways = pixel_directions(16 * fine, 32 * fine)
    weights = solid_angles(16 * fine, 32 * fine)
    seen = np.repeat(np.repeat(image[..., 0], fine, 0), fine, 1)
    truth = float(
        (mirrored(lobe, to_eye(point_at()), ways.reshape(-1, 3)) * (seen * weights).ravel()).sum()
    )
    for ways_of, aside in ((1, 0.0), (1, 0.4), (8, 0.4)):
        if aside == 0.0 and roughness < 0.2:
            continue  # its own rays hardly find the bright pixel's neighbours: too noisy a test
        ends = cast(ground, lobe._replace(aside=aside), lights_of(around, ways=ways_of))
        assert ends.brought[:, 0].mean() == pytest.approx(truth, rel=few(0.02, 0.2)), (
            ways_of,
            aside,
        )


def test_choosing_among_ways_takes_noise_away(ground):
    image = np.full((16, 32, 3), 0.1, np.float32)
    image[3:5, 3:5] = 50.0
    table = bright_table(image, np.maximum(image[..., 0] - image[..., 0].mean(), 0.0))
    around = Surroundings(np.zeros(3), image, np.eye(3), table)
    spread = [
        cast(ground, lobe_of(0.6), lights_of(around, ways=ways)).brought[:, 0].std()
        for ways in (1, 8)
    ]
    assert spread[1] < 0.6 * spread[0]


@pytest.mark.parametrize("roughness", [0.1, 0.4])
@pytest.mark.parametrize("kind", ["panel", "disc", "point", "sharp"])
def test_lamps_are_integrated_over_the_lobe(ground, kind, roughness):
    """A panel of 2 × 2 beyond the mirror direction, a disc about it, and lamps without an
    extent.
    """
    v = to_eye(point_at())
    mirror = v * (-1.0, -1.0, 1.0)
    lobe = lobe_of(roughness)
    start = np.array([4.0, 4.0, 4.8])
    panels = NO_PANELS
    discs = NO_DISCS
    lamps = NO_LAMPS
    if kind == "panel":
        corner = start + 6.0 * mirror - np.array([1.0, 1.0, 0.0])
        edges = np.array([[[0.0, 2.0, 0.0], [2.0, 0.0, 0.0]]])
        panels = Panels(corner[None], edges, np.full((1, 3), 3.0), np.zeros(1), np.ones(1))
        s = (np.arange(200) + 0.5) / 200
        places = corner + (s[:, None, None] * edges[0, 0] + s[None, :, None] * edges[0, 1])
        away = places.reshape(-1, 3) - start
        far = np.linalg.norm(away, axis=1)
        ways = away / far[:, None]
        light = 3.0
        weights = 4.0 / 200**2 * np.abs(ways[:, 2]) / far**2
    elif kind == "disc":
        s = np.cross(mirror, [0.0, 1.0, 0.0])
        t = np.zeros(3)
        s = 0.2 * s / np.linalg.norm(s)
        t = np.cross(mirror, s)
        discs = Discs(mirror[None], np.array([[s, t]]), np.full((1, 3), 3.0))
        r, phi = np.meshgrid(
            (np.arange(400) + 0.5) / 400, (np.arange(200) + 0.5) * (2.0 * np.pi / 200)
        )
        across = (r * np.cos(phi))[..., None] * s + (r * np.sin(phi))[..., None] * t
        along = np.sqrt(1.0 - (across**2).sum(axis=-1))
        ways = (across + along[..., None] * mirror).reshape(-1, 3)
        light = 3.0
        weights = (np.pi * 0.04 * 2.0 * r / (400 * 200) / along).ravel()
    else:
        towards = mirror + np.array([0.1, 0.0, 0.0])
        towards /= np.linalg.norm(towards)
        if kind == "point":
            place = start + 5.0 * towards
        else:
            place = towards
        lamps = LampArrays(
            np.array([POINT if kind == "point" else DIRECTIONAL], np.int8),
            place[None], np.zeros((1, 2, 3)), np.full((1, 3), 3.0 / np.pi),
        )  # fmt: skip
        ways = towards[None]
        light = 3.0
        weights = np.array([1.0 / 25.0 if kind == "point" else 1.0])
    truth = light * float((mirrored(lobe, v, ways) * weights).sum())
    ends = cast(ground, lobe, lights_of(sky(0.0, lamps), panels, discs))
    assert ends.brought[:, 0].mean() == pytest.approx(truth, rel=few(0.01, 0.2))


def test_what_stands_before_a_lamp_hides_it(ground):
    lamps = LampArrays(
        np.array([POINT], np.int8),
        np.array([[2.0, 4.0, 8.0]]),
        np.zeros((1, 2, 3)),
        np.ones((1, 3)),
    )
    blind = room_of([wall((0.0, 0.0, 6.5), (8.0, 0.0, 0.0), (0.0, 8.0, 0.0))])
    lobe = lobe_of(0.5)
    lights = lights_of(sky(0.0, lamps))
    assert cast(ground, lobe, lights, rays=4).brought.min() > 0.0
    assert not cast(ground, lobe, lights, blind, rays=4).brought.any()


def test_rays_in_a_closed_room_end_on_its_walls(ground):
    """All of them: what they count is what a white sky would bring, and each stands on the wall
    that it met.
    """
    walls = room_of(box(8.0, radiance=1.0))
    lobe = lobe_of(0.6)
    ends = cast(ground, lobe, lights_of(sky()), walls)
    above = ends.weights.max(axis=1) > 0.0
    assert (ends.met[above] >= 0).all()
    assert not ends.brought.any()
    free = cast(ground, lobe, lights_of(sky(1.0)))
    np.testing.assert_allclose(ends.weights[above].sum(axis=0), free.brought.sum(axis=0), rtol=1e-4)
    (points, normals, _) = ends.points.part(above)
    met = ends.met[above]
    heights = ((points - walls.corners[met]) * walls.normals[met]).sum(axis=1)
    assert np.abs(heights).max() < 1e-3
    assert ((normals * (4.0 - points)).sum(axis=1) > 0.0).all()


def test_black_backs_of_walls_are_not_seen(ground):
    back = room_of([wall((-90.0, -90.0, 7.0), (200.0, 0.0, 0.0), (0.0, 200.0, 0.0), 0.5)])
    ends = cast(ground, lobe_of(0.2), lights_of(sky(1.0)), back, rays=256)
    assert not ends.brought.any() and (ends.met == MET_NOTHING).all()


def test_rays_meet_the_surface_from_outside():
    """A mirror before a wall of the same surface: rays end on it, half a cell or less beside, with
    its normal.
    """
    x = np.arange(17.0)
    voxels = np.minimum(9.0 - x, 4.5)[:, None, None] + np.zeros((17, 17, 17))
    voxels = np.maximum(voxels, (5.0 - x)[None, None, :])
    surface = surface_of(field_of(voxels), 1.0)
    points = point_at(8.0, 8.0, 8.0)
    ends = cast(surface, lobe_of(0.02), lights_of(sky(1.0)), points=points, rays=64)
    v = np.array(EYE) - points.points[0]
    assert v[0] > 0.0  # so that the mirror direction goes to lower x, where the wall is
    assert (ends.met == MET_ISOSURFACE).all()
    np.testing.assert_allclose(ends.points.points[:, 0], 4.0, atol=0.1)
    np.testing.assert_allclose(ends.points.normals, np.tile([1.0, 0.0, 0.0], (64, 1)), atol=0.2)


def test_light_of_lobes_where_rays_end_is_that_of_a_disc(ground):
    """E/π of a disc straight above an open plane is that of its irradiance, ray by ray without much
    noise.
    """
    lamps = LampArrays(
        np.zeros(1, np.int8),
        np.array([[0.0, 0.0, 1.0]]),
        0.3 * np.eye(3)[None, :2],
        np.full((1, 3), 0.5),
    )
    count = few(4096, 64)
    points = SurfacePoints(
        *(np.repeat(each, count, 0) for each in point_at()[:2]), np.zeros(count, np.uint32)
    )
    lit = np.empty((count, 3), np.float32)
    light_ends(ground, points, lamps, np.arange(count, dtype=np.uint64), lit)
    assert lit.mean() == pytest.approx(0.5, rel=1e-3)


def test_noise_is_told_by_halves_and_by_neighbours():
    """Of white noise of a known deviation, half of the picture empty."""
    rng = np.random.default_rng(3)
    size = 64
    rows = np.full((size, size), -1, np.int32)
    pixels = np.arange(size * size // 2, dtype=np.uint32)
    rows.flat[pixels] = np.arange(len(pixels))
    for halves in (1, 2):
        values = rng.normal(5.0, 0.3, (len(pixels), halves))
        variance = np.empty(len(pixels))
        pool_noise(rows, pixels, 0, values, variance)
        assert variance.mean() == pytest.approx(0.09 / halves, rel=0.1)
        part = np.empty(10)
        pool_noise(rows, pixels, 100, values, part)
        np.testing.assert_array_equal(part, variance[100:110])
