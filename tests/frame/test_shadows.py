"""Light of lobes on a floor under a shelf against rays cast one by one, and against closed
forms.
"""

import math
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.rays import lobe_light
from isogi_core.frame.rays.lobe_light import find_lobes, find_starts
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.lobes import (
    rim_way,
)
from isogi_core.kernels.shading.surface_points import SurfacePoints
from isogi_core.kernels.tracing.field import to_index
from isogi_core.kernels.tracing.intersect import OUTSIDE_SIGN, cast, launch
from isogi_core.kernels.transport import streams
from isogi_core.kernels.transport.lights import DIRECTIONAL, LampArrays, draw_from_disc
from isogi_core.kernels.transport.rng import mix, point_2d
from tests.kernels.fields import field_of, surface_of

Z, Y, X = np.mgrid[:41, :41, :41].astype(float)
FLOOR = 8.0
EDGE = 18.0
ROOM = np.maximum(FLOOR - Z, np.minimum(np.minimum(EDGE - X, Z - 24.0), 27.0 - Z))
"""A floor, and above it a shelf one side of which ends at x = EDGE."""
LIGHT = np.array([0.2126, 0.7152, 0.0722], np.float32).astype(float)
SIDE = 64
UP = np.array([0.0, 0.0, 1.0])

RIM_RAYS = 4
"""Rays to the rim of a lobe that is more than half a degree wide."""

DISC_RAYS = (16, 8, 8, 4, 4)
"""Rays to the disc from a point in the half-shadow, by the pairs beside it that share theirs."""

PAIRS = ((0, 1, 2.0), (1, 0, 2.0), (1, 1, 1.0), (1, -1, 1.0))
"""Steps along y and x to pairs, and their weights beside 4 of the point: binomial along both."""

Spacing = tuple[float, float, float]
Lobe = tuple[Sequence[float], float, Sequence[float]]


def lamps_of(*lobes: Lobe) -> LampArrays:
    """Directional lamps (towards, degrees across, colour)."""
    towards = np.array([np.array(t) / np.linalg.norm(t) for t, _, _ in lobes]).reshape(-1, 3)
    edges = np.empty((len(lobes), 2, 3))
    for k, (axis, (_, degrees, _)) in enumerate(zip(towards, lobes, strict=True)):
        east = np.cross(axis, [0.0, 1.0, 0.0])
        east /= np.linalg.norm(east)
        edges[k] = math.sin(math.radians(degrees / 2.0)) * np.array([east, np.cross(axis, east)])
    colours = np.array([c for *_, c in lobes], float).reshape(-1, 3)
    return LampArrays(np.full(len(lobes), DIRECTIONAL, np.int8), towards, edges, colours)


def floor(side: int = SIDE) -> np.ndarray:
    """Points of the floor in a picture of it from above, (side², 3) float32, index space."""
    y, x = np.divmod(np.arange(side * side), side)
    across = 8.0 + 24.0 * (np.stack([x, y], axis=1) + 0.5) / side
    return np.column_stack([across, np.full(len(across), FLOOR)]).astype(np.float32)


def light(
    lamps: LampArrays,
    points: np.ndarray,
    spacing: Spacing = (1.0, 1.0, 1.0),
    moving: bool = False,
    threads: int = 1,
) -> np.ndarray:
    """`find_lobes` of such a picture: (n, 4)."""
    given: Any = SimpleNamespace(lobes=lamps, view=SimpleNamespace(moving=moving))
    gbuffer = picture(points, spacing)
    tiles = Tiles(threads)
    return find_lobes(
        given, find_starts(gbuffer, tiles), gbuffer.surface.traced(tiles.run), tiles
    ).lit


def picture(points: np.ndarray, spacing: Spacing = (1.0, 1.0, 1.0)) -> GBuffer:
    """A picture of such points."""
    surface: Any = SimpleNamespace(
        traced=lambda _: surface_of(field_of(ROOM, spacing), 0.0), isovalue=0.0
    )
    side = math.isqrt(len(points))
    normals = np.tile(UP.astype(np.float32), (len(points), 1))
    pixels = np.arange(len(points), dtype=np.uint32)
    shown = SurfacePoints(points, normals, pixels)
    gbuffer = GBuffer((side, side), spacing, (20.0, 20.0, 40.0), surface, pixels, points)
    return gbuffer.of_these(shown)


def twin(lamps: LampArrays, points: np.ndarray, spacing: Spacing) -> np.ndarray:
    """The same, ray by ray, all of them to all rims; points amid four in the half-shadow are there,
    too.
    """
    field = field_of(ROOM, spacing)
    lit = np.zeros((len(points), 4))
    starts = find_starts(picture(points, spacing), Tiles(1))
    for k in range(len(lamps.kinds)):
        seen = [rims_seen(field, lamps, k, m, p) for m, p in enumerate(points.astype(float))]
        half = np.array([any(each) and not all(each) for each in seen])
        for m in starts.picture.order[starts.ends[1] :]:
            around = starts.picture.around[m]
            half[m] |= (around >= 0).all() and half[around].all()
        for m in range(len(points)):
            share = all(seen[m]) * max(float(lamps.places[k, 2]), 0.0)
            variance = 0.0
            if half[m]:
                share, variance = half_seen(field, lamps, k, points, half, m)
            lit[m, :3] += share * lamps.colours[k]
            lit[m, 3] += variance * (lamps.colours[k] @ LIGHT) ** 2
    return lit


def free(field: Any, p: np.ndarray, w: Any) -> bool:
    """Whether a ray from a point gets away."""
    origin = launch(field, 0.0, tuple(p), tuple(UP), OUTSIDE_SIGN)
    return (
        not cast(field, 0.0, origin, to_index(tuple(w), field.spacing), OUTSIDE_SIGN)[0] < math.inf
    )


def rims_seen(field: Any, lamps: LampArrays, k: int, m: int, p: np.ndarray) -> list[bool]:
    """What a point sees along rays to a lobe's rim; to its middle, where it is sharp."""
    rim = [lamps.places[k]]
    if np.linalg.norm(lamps.edges[k, 0]) > math.sin(math.radians(0.25)):
        dimension = len(lamps.kinds) + k
        seed = np.uint64(mix(m, streams.LOBES_STREAM))
        first = 0.5 * math.pi * point_2d(seed, 0, dimension)[0]
        rim = [
            np.array(rim_way(lamps, k, first + 2.0 * math.pi * i / RIM_RAYS))
            for i in range(RIM_RAYS)
        ]
    return [w[2] > 0.0 and free(field, p, w) for w in rim]


def half_seen(
    field: Any, lamps: LampArrays, k: int, points: np.ndarray, half: np.ndarray, m: int
) -> tuple[float, float]:
    """What a point in the half-shadow gets of a lobe's light, and its variance: by those beside it,
    too.
    """
    given = [
        (m, 4.0),
        *(
            (n, weight)
            for pair, weight in pairs_beside(half, math.isqrt(len(points)), m)
            for n in pair
        ),
    ]
    total = sum(weight for _, weight in given)
    share = 0.0
    variance = 0.0
    for n, weight in given:
        rays = DISC_RAYS[len(pairs_beside(half, math.isqrt(len(points)), n))]
        each = share_of(field, lamps, k, n, points[n], rays)
        share = share + weight / total * each[0]
        variance = variance + (weight / total) ** 2 * each[1]
    return share, variance


def pairs_beside(half: np.ndarray, side: int, m: int) -> list[tuple[tuple[int, int], float]]:
    """The pairs of points opposite each other about one that are both in the half-shadow, and what
    each counts.
    """
    y, x = divmod(m, side)
    pairs = [((y - dy, x - dx), (y + dy, x + dx), weight) for dy, dx, weight in PAIRS]
    inside = [each for each in pairs if all(0 <= i < side for i in (*each[0], *each[1]))]
    numbered = [((a * side + b, c * side + d), weight) for (a, b), (c, d), weight in inside]
    return [each for each in numbered if half[each[0][0]] and half[each[0][1]]]


def share_of(
    field: Any, lamps: LampArrays, k: int, m: int, p: np.ndarray, rays: int
) -> tuple[float, float]:
    """What a point gets of a lobe's light by so many rays of its own, and the variance of that."""
    brought = []
    for i in range(rays):
        w, cosine = draw_from_disc(
            tuple(lamps.places[k]),
            lamps.edges[k],
            *point_2d(np.uint64(mix(m, streams.LOBES_STREAM)), i, k),
        )
        brought.append(max(w[2], 0.0) / cosine * free(field, p.astype(float), w))
    # Rays in strata have less variance than random ones, by the root of their number.
    variance = np.var(brought) / (rays - 1) / math.sqrt(rays)
    return float(np.mean(brought)), float(variance)


@pytest.mark.slow
@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.5, 2.0, 1.0)])
@pytest.mark.parametrize("degrees", [0.0, 0.4, 3.0, 15.0])
def test_light_of_lobes_is_that_of_all_rays(degrees: float, spacing: Spacing) -> None:
    lamps = lamps_of(
        ((0.6, 0.2, 0.8), degrees, (3.0, 2.0, 1.0)), ((-0.5, 0.1, 0.7), degrees, (0.1, 0.2, 0.4))
    )
    points = floor(24)
    lit = light(lamps, points, spacing)
    expected = twin(lamps, points, spacing)
    same = np.isclose(lit[:, :3], expected[:, :3], rtol=1e-5, atol=1e-6).all(axis=1)
    same &= np.isclose(lit[:, 3], expected[:, 3], rtol=0.05, atol=1e-6)
    assert same.mean() > 0.99 and np.abs((lit - expected)[:, :3]).max() < 0.25
    for each in (lit, expected):
        assert (each[:, 3] > 0.0).any() == (degrees > 1.0), "half-shadows are of wide lobes"


def leaves(seed: int, shade: float) -> np.ndarray:
    """A field that is above 0 in a canopy over a floor, with gaps of all sizes."""
    rng = np.random.default_rng(seed)
    ways, phases = rng.normal(size=(12, 2)), rng.uniform(0.0, 2.0 * math.pi, 12)
    waves = [np.cos(kx * X + ky * Y + p) for (kx, ky), p in zip(ways, phases, strict=True)]
    canopy = np.minimum(np.minimum(Z - 24.0, 27.0 - Z), np.sum(waves, axis=0) + shade)
    return np.maximum(FLOOR - Z, canopy)


def test_spots_of_light_below_leaves_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the ray of each point: seven in ten of those that its neighbours made wrong are right."""
    lamps = lamps_of(((0.05, 0.1, 1.0), 0.2, (1.0,) * 3))
    wrong = dict.fromkeys(("by neighbours", "by all"), 0)
    for seed, shade, side in ((1, 2.0, 40), (2, 3.0, 40), (2, 2.0, 24)):
        canopy = leaves(seed, shade)
        monkeypatch.setitem(globals(), "ROOM", canopy)
        points = floor(side)
        field = field_of(canopy, (1.0, 1.0, 1.0))
        reached = [free(field, p, lamps.places[0]) for p in points.astype(float)]
        for how in wrong:
            with monkeypatch.context() as patch:
                if how == "by neighbours":
                    patch.setattr(lobe_light, "DAPPLE_REACH", 0)
                lit = light(lamps, points)[:, 0]
            wrong[how] += int(((lit > 0.0) != reached).sum())
    before, after = wrong.values()
    assert before > 15 and after <= 0.3 * before, wrong


@pytest.mark.parametrize(("side", "believed"), [(48, True), (16, False)])
def test_neighbours_far_apart_on_the_surface_are_not_believed(side: int, believed: bool) -> None:
    """Four pixels are 2 voxels of the finer picture, and 6 of the coarser one, whose next
    neighbours still count.
    """
    starts = find_starts(picture(floor(side)), Tiles(1))
    first = starts.picture.around[:, 0].reshape(side, side)[4:-4, 4:-4]
    assert (first[::4, ::4] == -1).all(), "those that are asked first"
    assert ((first[2::4, 2::4] >= 0) == believed).all() and (
        (first[::4, 2::4] >= 0) == believed
    ).all()
    assert (first[1::2, 1::2] >= 0).all() and (first[::2, 1::2] >= 0).all()


def test_a_moving_view_has_nearly_the_same_light() -> None:
    lamps = lamps_of(((-0.5, 0.1, 0.7), 3.0, (3.0, 2.0, 1.0)))
    points = floor()
    rest, moving = (light(lamps, points, moving=each)[:, 0] for each in (False, True))
    assert moving.mean() == pytest.approx(rest.mean(), rel=0.15)
    assert (np.abs(moving - rest) < 0.01).mean() > 0.9 and not np.array_equal(moving, rest)


def test_without_lobes_it_is_dark() -> None:
    assert not light(lamps_of(), floor(8)).any()


def test_what_sees_a_lobe_has_the_cosine_of_its_light() -> None:
    """Away from the shelf nothing is in the way."""
    points = floor()
    lit = light(lamps_of(((0.6, 0.0, 0.8), 5.0, (3.0, 2.0, 1.0))), points)[
        points[:, 0] > EDGE + 2.0
    ]
    np.testing.assert_allclose(
        lit[:, :3], np.broadcast_to([2.4, 1.6, 0.8], lit[:, :3].shape), rtol=1e-6
    )
    assert not lit[:, 3].any()


def test_of_a_lobe_on_the_horizon_its_upper_half_arrives() -> None:
    points = floor()
    below, level = (lamps_of(((1.0, 0.0, z), 8.0, (1.0,) * 3)) for z in (-0.5, 0.0))
    assert not light(below, points).any()
    a = math.sin(math.radians(4.0))
    expected = 4.0 * a / (3.0 * math.pi) / 2.0  # mean height of half a disc, of which there is half
    assert light(level, points)[points[:, 0] > EDGE + 2.0, 0].mean() == pytest.approx(
        expected, rel=0.05
    )


def half_shadow_of_the_shelf(points: np.ndarray, degrees: float) -> tuple[np.ndarray, np.ndarray]:
    """Which points are about the shelf's edge, and the share of a lobe straight above that each of
    these sees.
    """
    radius = math.sin(math.radians(degrees / 2.0))
    near = np.abs(points[:, 0] - EDGE) < 3.0
    away = EDGE - points[near, 0]
    begins = find_starts(picture(points), Tiles(1)).picture.starts[0, 2]
    slope = away / (np.where(away > 0.0, 24.0, 27.0) - begins)
    d = np.clip(
        slope / np.sqrt(1.0 + slope**2) / radius, -1.0, 1.0
    )  # a plane cuts the disc about there
    return near, (np.arccos(d) - d * np.sqrt(1.0 - d**2)) / math.pi


def test_a_half_shadow_is_the_share_of_the_disc_left_free() -> None:
    """Straight above, the shelf hides what is on its side: its lower edge before it, its upper edge
    from aside.
    """
    points = floor()
    lit = light(lamps_of(((0.0, 1e-9, 1.0), 30.0, (1.0,) * 3)), points)
    (near, free) = half_shadow_of_the_shelf(points, 30.0)
    wrong = lit[near, 0] - free
    assert abs(wrong.mean()) < 0.01 and np.sqrt((wrong**2).mean()) < 0.1
    told = math.sqrt(lit[near, 3].mean())
    assert 0.5 < told / wrong.std() < 2.0, "and its error is told"


def test_rays_in_a_wide_half_shadow_are_shared(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of the rays err a quarter more than all of a point's own."""
    lamps = lamps_of(((0.0, 1e-9, 1.0), 30.0, (1.0,) * 3))
    points = floor()
    see_rims, see_discs = lobe_light.see_rims, lobe_light.see_discs
    wrong = {}
    rays = {}
    for shares in (True, False):
        counts = list[int]()

        def rims(*given: Any, counts: list[int] = counts) -> None:
            counts.append(RIM_RAYS * len(given[3]))
            see_rims(*given)

        def discs(*given: Any, counts: list[int] = counts) -> None:
            counts.append(given[4] * len(given[3]))
            see_discs(*given)

        monkeypatch.setattr(lobe_light, "see_rims", rims)
        monkeypatch.setattr(lobe_light, "see_discs", discs)
        if not shares:
            monkeypatch.setattr(lobe_light, "find_sides", unshared)
        near, free = half_shadow_of_the_shelf(points, 30.0)
        wrong[shares] = (light(lamps, points)[near, 0] - free).std()
        rays[shares] = sum(counts)
    assert rays[True] < 0.6 * rays[False] and wrong[True] < 1.3 * wrong[False]


def unshared(picture: Any, pairs: np.ndarray, seen: np.ndarray, sides: np.ndarray) -> None:
    """In place of ``find_sides``: no neighbours share rays."""
    sides[:] = 0


def test_a_wide_half_shadow_is_found_by_few_of_its_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """Points four apart are asked at first, and those amid four in the half-shadow are there
    without rays.
    """
    lamps = lamps_of(((0.0, 1e-9, 1.0), 30.0, (1.0,) * 3))
    points = floor()
    asked = [0]
    found = [np.empty(0)]
    see = lobe_light.see_rims
    add = lobe_light.add_halves
    monkeypatch.setattr(
        lobe_light, "see_rims", lambda *given: asked.append(len(given[3])) or see(*given)
    )
    monkeypatch.setattr(
        lobe_light, "add_halves", lambda *given: found.append(given[1]) or add(*given)
    )
    light(lamps, points)
    seen = [
        rims_seen(field_of(ROOM, (1.0,) * 3), lamps, 0, m, p)
        for m, p in enumerate(points.astype(float))
    ]
    half = np.array([any(each) and not all(each) for each in seen])
    there = np.zeros(len(points), bool)
    there[found[-1]] = True
    assert half.sum() > 500 and sum(asked) < 0.7 * half.sum()
    assert (half & ~there).sum() < 0.01 * half.sum() and (there & ~half).sum() < 0.05 * half.sum()


@pytest.mark.parametrize("moving", [False, True])
def test_light_of_lobes_does_not_depend_on_tiles(
    monkeypatch: pytest.MonkeyPatch, moving: bool
) -> None:
    lamps = lamps_of(((0.4, 0.3, 0.8), 12.0, (1.0, 2.0, 3.0)), ((-0.4, 0.3, 0.8), 3.0, (1.0,) * 3))
    points = floor()
    whole = light(lamps, points, moving=moving)
    for name in ("LOBE_POINTS", "RIM_PAIRS", "HALF_SEEN_PAIRS"):
        monkeypatch.setattr(f"isogi_core.frame.rays.lobe_light.{name}", 97)
    assert np.array_equal(whole, light(lamps, points, moving=moving, threads=3))
