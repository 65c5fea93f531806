"""Light carried as shares of unshadowed light in frames: where it is, what it starts from, and what it brings."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.look import look_for
from isogi_core.bake.recipe import Recipe
from isogi_core.frame import facings, shader
from isogi_core.frame.facings import find_facings, shares_light
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.surroundings import Turned
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.facing import face_texels
from isogi_core.kernels.harmonics import cosine_lobe_factors
from isogi_core.kernels.lights import unshadowed
from isogi_core.kernels.moves import MOVED, move_texels
from isogi_core.kernels.shares import LEAST
from isogi_core.model.scene import Scene, load_scene
from isogi_core.model.view import Camera, View, quaternion_from_angles
from tests.frame.conftest import CONSTANT, LOOSE, SKY, Workbench, ball, relative_rmse, scene_of, soft_probe

LAMP = {"type": "directional", "azimuth": 90.0, "elevation": 30.0, "irradiance": 2.0}
ODD = quaternion_from_angles(33.0, -20.0, 71.0)
Make = Callable[[Scene], Workbench]


def turned(**settings: Any) -> Turned:
    """The lights of the orbital, turned."""
    recipe = Recipe(load_scene("demo:orbital", **settings))
    return Turned(look_for(recipe, "gi"), View(0.03, Camera((10.0, 3.0, 4.0), (0.0, 0.0, 0.0)), ODD))


def some_normals(count: int = 200) -> np.ndarray:
    """Unit vectors, (count, 3)."""
    normals = np.random.default_rng(8).normal(size=(count, 3))
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))


def bare_about(light: Turned, normals: np.ndarray) -> np.ndarray:
    """What ``Turned.bare`` says of normals, by its polynomials; (n, 3)."""
    x, y, z = normals.T
    terms = np.stack([np.ones_like(x), y, z, x, x * y, y * z, z * z, x * z, x * x - y * y])
    quadric, least, reflected = light.bare
    return np.asarray(np.maximum((quadric @ terms).T, least) + reflected)


@pytest.mark.parametrize("albedo", [0.7, [0.2, 0.5, 1.0]])
def test_bare_light_is_what_stands_in_for_light_that_is_not_baked(albedo: Any) -> None:
    light, normals = turned(lights=[SKY], albedo=albedo, lobes=0), some_normals()
    sky, basis = light.sky, np.empty(9)
    expected = np.array([unshadowed(sky.order, sky.lobe, sky.light, tuple(n), basis) for n in normals.tolist()])
    least = LEAST * light.albedo * light.mean / light.look.unit
    assert (expected < least).any() or (expected > least).all()
    np.testing.assert_allclose(bare_about(light, normals), np.maximum(expected, least), rtol=2e-5)
    assert not light.bare.reflected.any()
    np.testing.assert_allclose(sky.lobe[[0, 1, 4]], cosine_lobe_factors(3) / math.pi)


def test_what_texels_hold_of_lobes_is_taken_to_come_from_all_sides() -> None:
    whole, beside = turned(lights=[SKY], albedo=0.7, lobes=0), turned(lights=[SKY], albedo=0.7, lobes=1)
    (sun,) = beside.look.lobes
    flux = beside.albedo * np.array(sun.flux) / (4.0 * math.pi * beside.look.unit)
    np.testing.assert_allclose(beside.bare.reflected, flux, rtol=1e-5)
    means = [bare_about(light, some_normals(40000)).mean(axis=0) for light in (whole, beside)]
    np.testing.assert_allclose(means[1], means[0], rtol=0.1)


def test_lamps_that_the_middle_of_the_volume_does_not_see_are_not_lost() -> None:
    """A red area light that shows the middle its back, alone and beside a green lamp."""
    sides = {"u": [0.0, 5.0, 0.0], "v": [0.0, 0.0, 5.0]}
    area = {"type": "area", "corner": [4000.0, 0.0, 0.0], **sides, "radiance": [9.0, 0.0, 0.0]}
    green = {**LAMP, "irradiance": [0.0, 2.0, 0.0]}
    for lights in ([area], [area, green]):
        light = turned(lights=lights, albedo=[0.5, 0.5, 0.0])
        assert light.mean[0] == 0.0
        least = light.bare.least
        assert (least > 0.0).tolist() == [True, len(lights) == 2, False]


@pytest.mark.parametrize(
    ("settings", "shading", "shared"),
    [
        ({"lights": [SKY]}, "gi", True),
        ({"lights": [SKY]}, "vicinity", False),
        ({"lights": [SKY], "rotating": False}, "gi", True),
        ({"lights": [CONSTANT]}, "gi", False),
        ({"lights": [CONSTANT], "representation": "transfer", "order": 2}, "gi", False),
        ({"lights": [CONSTANT], "bounces": 0, "sharpen": True}, "gi", True),
        ({"lights": [CONSTANT], "bounces": 0, "sharpen": True}, "vicinity", False),
        ({"lights": [CONSTANT, LAMP]}, "gi", True),
        ({"lights": [CONSTANT, LAMP]}, "vicinity", False),
    ],
)
def test_light_is_shared_where_it_has_sides_and_where_texels_are_sharp(
    settings: dict[str, Any], shading: str, shared: bool
) -> None:
    assert shares_light(load_scene("demo:orbital", **settings), shading) is shared


def test_provisional_light_of_a_convex_surface_follows_its_own_normals(tmp_path: Path, workbench: Make) -> None:
    bench = workbench(scene_of(ball(), 0.0, lights=[soft_probe(tmp_path)], albedo=0.5, lobes=0))
    view = bench.view(size=40, light=ODD)
    frame = bench.renderer.render(view)
    light = Turned(bench.caches.look("gi"), view)
    normals = frame.gbuffer.normals(bench.recipe, Tiles(1), None)
    shown = frame.radiance.reshape(-1, 3)[frame.gbuffer.pixels]
    np.testing.assert_allclose(shown, bare_about(light, normals) * light.look.unit, rtol=1e-4)
    assert shown.std() > 0.1 * shown.mean()


def test_shares_are_nearer_to_the_truth_than_light_as_it_is(
    tmp_path: Path, workbench: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a ball under light that falls off from one pole, by texels two voxels apart."""
    settings = {"lights": [soft_probe(tmp_path)], "albedo": 0.5, "bounces": 0, "lobes": 0, "lattice": 0.5}
    bench = workbench(scene_of(ball(20, 6.0), 0.0, target_error=0.01, **settings))
    view = bench.view(size=48, light=ODD)
    shared, truth = bench.bake(view), bench.renderer.render(replace(view, shading="path_traced", samples=4096))
    monkeypatch.setattr(shader, "shares_light", lambda *_: False)
    plain = bench.renderer.render(view)
    assert relative_rmse(shared, truth) < 0.5 * relative_rmse(plain, truth)


def test_a_frame_has_the_same_bits_on_any_number_of_threads(orbital: Workbench) -> None:
    view = orbital.view(size=40, light=ODD)
    frames = [Renderer(orbital.caches, Tiles(threads)).render(view) for threads in (1, 3)]
    assert frames[0].radiance.tobytes() == frames[1].radiance.tobytes()
    assert frames[0].error.tobytes() == frames[1].error.tobytes()


def test_normals_of_moved_texels_are_found_once_and_beside_their_own(
    orbital: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    view, asked = orbital.view(size=24), []
    gbuffer = orbital.renderer.gbuffer(view)
    texels = orbital.renderer.texels(view, gbuffer)
    found = find_facings(texels, orbital.recipe, Tiles(2))
    monkeypatch.setattr(facings, "face_texels", lambda *each: (asked.append(len(each[4])), face_texels(*each)))
    assert found.where(np.zeros(len(found.own), np.bool_), texels, orbital.recipe, Tiles(1)) is found.own
    places, count = texels.positions, len(found.own)
    there, normals, verdicts = np.empty((3, count)), np.empty((3, count)), np.empty(count, np.uint8)
    move_texels(orbital.recipe.field, orbital.recipe.step, gbuffer.isovalue, places, there, normals, verdicts)
    moved = verdicts == MOVED
    moved[::3] = False
    for mask in (moved & (np.arange(count) % 2 == 0), moved, moved):
        facing = found.where(mask, texels, orbital.recipe, Tiles(1))
        np.testing.assert_allclose(facing[mask], normals.T[mask], atol=2e-3)
        assert np.array_equal(facing[~mask], found.own[~mask])
    assert sum(asked) == moved.sum() > 100, "each is found once"
    assert found.nbytes == 25 * count


def test_light_from_all_sides_is_carried_as_it_was(calm: Workbench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where shares are asked for nevertheless, they are the light itself but for weights."""
    view = calm.view()
    plain = calm.renderer.render(view)
    monkeypatch.setattr(shader, "shares_light", lambda *_: True)
    shared = calm.renderer.render(view)
    assert relative_rmse(shared, plain) < 0.01
    assert shared.radiance.tobytes() != plain.radiance.tobytes()
    assert shared.estimated_error == pytest.approx(plain.estimated_error, rel=0.1)
    assert LOOSE > shared.estimated_error > 0.0
