"""Paths among several isosurfaces: one ray at a time, and closed forms."""

import numpy as np
import pytest

from isogi_core.kernels.tracing.walls import NO_WALL
from isogi_core.kernels.transport.lights import DIRECTIONAL
from isogi_core.kernels.transport.paths import PathRules, PathStarts, SampleRange
from isogi_core.kernels.transport.surface_paths import light_among_surfaces
from tests.kernels.fields import field_of
from tests.kernels.rooms import X, Y, Z, among, box, sky, wall
from tests.kernels.transport.lighting import (
    BALL,
    LIGHTS,
    NOISY,
    PLANE,
    lamps,
    on_ball,
    surroundings,
)
from tests.oracles.paths import gathered, several_surfaces
from tests.scale import few

WALLS = [
    wall((-20.0, -20.0, -2.0), 80.0 * X, 80.0 * Y, 0.6),
    wall((10.0, 10.0, 45.0), 9.0 * Y, 14.0 * X, 0.3, radiance=5.0),
    wall((-3.0, 0.0, 0.0), 40.0 * Y, 40.0 * Z, 0.9),
]
"""A floor, a lit panel and a wall beside the field."""


def starts_at(scene, points, normals, walls=None):
    """Starts at ``points`` with ``normals``, (3, g), on ``walls`` by number or on the first surface
    (-1).
    """
    points, normals = (np.ascontiguousarray(each, np.float64) for each in (points, normals))
    g = points.shape[1]
    levels = np.full(g, scene.surfaces.isovalues[0])
    seeds = np.arange(1, g + 1, dtype=np.uint64)
    return PathStarts(points, normals, levels, seeds, np.array(walls or [NO_WALL] * g, float))


def gather(scene, starts, samples, bounces, light, walls=None, survival=1.0):
    """E/π (g, 3) at the ``starts``: see ``starts_at``."""
    paths = starts_at(scene, *starts, walls)
    rules = PathRules(np.ones((bounces + 1, 3)), survival)
    sums = np.zeros(paths.points.T.shape)
    light_among_surfaces(scene, paths, SampleRange(0, samples), rules, light, sums)
    return sums / samples


def inner_ball(count):
    """Points and normals on the surface of the ball of radius 6 in BALL."""
    points, normals = on_ball(count)
    return 20.0 + (points - 20.0) / 2.0, normals


@pytest.mark.slow
@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("walls", [[], WALLS], ids=["open", "walls"])
def test_paths_are_those_of_one_ray_at_a_time(light: str, walls: list) -> None:
    """Walls shine, are seen from, and stand in the way."""
    field = field_of(NOISY)
    (points, normals) = inner_ball(6)
    points = np.column_stack([points, [21.0, 15.0, -2.0]])
    normals = np.column_stack([normals, Z])
    own = [*[NO_WALL] * 6, 0.0 if walls else NO_WALL]
    thin = [(0.1, 0.2, 0.3), 0.0, (0.6, 0.4, 0.0)]
    surfaces = among(field, 6.0, [0.0, 3.5], [0.5, 0.8, 0.3], [0.3, 0.6, 0.9], thin, walls)
    (samples,) = few((64,), (8,))
    found = gather(surfaces, (points, normals), samples, 3, LIGHTS[light], own, survival=0.8)
    world = several_surfaces(surfaces)
    starts = starts_at(surfaces, points, normals, own)
    expected = gathered(world, starts, SampleRange(0, samples), 3, LIGHTS[light], survival=0.8)[
        :, :, 0
    ].mean(axis=1)
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_a_black_clear_shell_dims_all_light_alike() -> None:
    """Every ray from the ball crosses the shell around it once: the share that passes is all that
    arrives.
    """
    (samples,) = few((4096,), (1024,))
    field = field_of(BALL)
    surfaces = among(field, 6.0, [0.0], [0.0, 0.0], [0.0, 0.4])
    found = gather(surfaces, inner_ball(8), samples, 0, surroundings(constant=2.0))
    np.testing.assert_allclose(found.mean(axis=0), 0.8, rtol=0.005)


def outer_and_inner(count):
    """The BALL, and the BALL inside out, with starts on their surfaces: the outer and the inner
    side of one shell.
    """
    points, normals = on_ball(count)
    return (field_of(BALL), (points, normals)), (field_of(-BALL), (points, -normals))


@pytest.mark.parametrize(
    ("albedo", "through"), [(0.6, 0.4), (0.0, 1.0), ((0.9, 0.5, 0.0), (0.1, 0.5, 1.0))]
)
def test_a_sheet_that_loses_nothing_is_as_bright_as_the_sky(albedo, through) -> None:
    """The white furnace on both sides of a closed shell: what is not reflected gets through."""
    (samples,) = few((4096,), (512,))
    for field, starts in outer_and_inner(8):
        surfaces = among(field, 0.0, [], [albedo], [0.0], [through])
        found = gather(surfaces, starts, samples, 200, surroundings(constant=1.0))
        np.testing.assert_allclose(
            found.mean(axis=0), 1.0, rtol=0.003 if np.ndim(albedo) == 0 else 0.02
        )


@pytest.mark.parametrize("bounces", [0, 1, 3])
def test_a_closed_sheet_under_an_even_sky_by_its_closed_form(bounces: int) -> None:
    """Inside, E_in = τ L Σ_k ρ^k over the bounces; leaving outside is ρ L + τ E_in, and inside ρ
    E_in + τ L.
    """
    (samples,) = few((16384,), (4096,))
    albedo = 0.5
    through = 0.3
    sky = 2.0
    within = through * sky * sum(albedo**k for k in range(bounces))
    leaving = albedo * sky + through * within, albedo * within + through * sky
    for (field, starts), expected in zip(outer_and_inner(8), leaving, strict=True):
        surfaces = among(field, 0.0, [], [albedo], [0.0], [through])
        found = gather(surfaces, starts, samples, bounces, surroundings(constant=sky))
        np.testing.assert_allclose((albedo + through) * found.mean(axis=0), expected, rtol=0.01)


def test_a_lamp_behind_a_sheet_lights_it_by_its_transmission() -> None:
    """Of a lamp below a floor its upper side sees nothing, and its other side a cosine of 1."""
    field = field_of(PLANE)
    starts = (
        np.array([[20.0, 18.0], [20.0, 23.0], [20.0, 20.0]]),
        np.array([[0.0, 0.0], [0.0, 0.0], [1.0, 1.0]]),
    )
    below = lamps((DIRECTIONAL, (0.0, 0.0, -1.0), None, (0.6, 0.6, 0.6)))
    surfaces = among(field, 0.0, [], [(0.2, 0.3, 0.0)], [0.0], [(0.6, 0.1, 0.0)])
    found = gather(surfaces, starts, 4096, 0, surroundings(lamps=below)) * (0.8, 0.4, 0.0)
    np.testing.assert_allclose(found.mean(axis=0), np.array([0.6, 0.1, 0.0]) * 0.6, rtol=0.01)


@pytest.mark.parametrize(
    ("albedo", "clear", "through"), [(0.4, 0.0, 0.6), (1.0, 0.6, 0.0), (0.2, 0.3, 0.8)]
)
def test_a_shell_that_loses_nothing_is_not_seen_in_a_room(
    albedo: float, clear: float, through: float
) -> None:
    """Black walls of radiance L are all that gives off light: L arrives at the walls, and on the
    shell.
    """
    (samples,) = few((1024,), (64,))
    walls = [(corner - 30.0, *rest) for corner, *rest in box(100.0, 0.0, 2.0)]
    shells = among(field_of(BALL), 0.0, [], [albedo], [clear], [through], walls)
    points, normals = on_ball(3)
    starts = (
        np.column_stack([[20.0, 20.0, -30.0], [-30.0, 20.0, 20.0], points]),
        np.column_stack([Z, X, normals]),
    )
    found = gather(shells, starts, samples, 60, sky(9.0), [4.0, 0.0, *[NO_WALL] * 3])
    np.testing.assert_allclose(found[:2].mean(), 2.0, rtol=0.005 if samples > 64 else 0.1)
    np.testing.assert_allclose(found[2:].mean(), 2.0, rtol=0.01 if samples > 64 else 0.2)
