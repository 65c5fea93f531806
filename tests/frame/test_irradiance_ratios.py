"""Light carried as shares of unshadowed light in frames: where it is, what it starts from, and what
it brings.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.bake_spec import spec_for
from isogi_core.frame import texel_normals, texel_shading
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.texel_normals import LatticeNormals, find_texel_normals
from isogi_core.frame.tiles import Tiles
from isogi_core.frame.view_texels import carries_irradiance_ratios
from isogi_core.kernels.shading.texel_normals import fill_texel_normals
from isogi_core.kernels.transport.harmonics import cosine_lobe_factors
from isogi_core.kernels.transport.lights import unshadowed
from isogi_core.kernels.transport.transfer import TEXEL_PROJECTED, project_texels
from isogi_core.model.view import Camera, View, quaternion_from_angles
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import PreparedScene
from tests.frame.conftest import (
    CONSTANT,
    LOOSE,
    SKY,
    Workbench,
    ball,
    relative_rmse,
    scene_of,
    soft_probe,
)
from tests.loaded import load_scene

LAMP = {"type": "directional", "azimuth": 90.0, "elevation": 30.0, "irradiance": 2.0}
ODD = quaternion_from_angles(33.0, -20.0, 71.0)
Make = Callable[[Scene], Workbench]


def turned(**settings: Any) -> RotatedLight:
    """The lights of the orbital, turned."""
    prepared = PreparedScene(load_scene("demo:orbital", **settings))
    return RotatedLight(
        spec_for(prepared, "gi"), View(0.03, Camera((10.0, 3.0, 4.0), (0.0, 0.0, 0.0)), ODD)
    )


def some_normals(count: int = 200) -> np.ndarray:
    """Unit vectors, (count, 3)."""
    normals = np.random.default_rng(8).normal(size=(count, 3))
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))


def bare_about(light: RotatedLight, normals: np.ndarray) -> np.ndarray:
    """What ``RotatedLight.unshadowed`` says of normals, by its polynomials; (n, 3)."""
    x, y, z = normals.T
    terms = np.stack([np.ones_like(x), y, z, x, x * y, y * z, z * z, x * z, x * x - y * y])
    quadric, least = light.unshadowed
    return np.asarray(np.maximum((quadric @ terms).T, least))


@pytest.mark.parametrize("albedo", [0.7, [0.2, 0.5, 1.0]])
def test_unshadowed_light_is_the_provisional_light(albedo: Any) -> None:
    light = turned(lights=[SKY], albedo=albedo, lobes=0)
    normals = some_normals()
    sky = light.sky
    basis = np.empty(9)
    expected = np.array(
        [unshadowed(sky.order, sky.lobe, sky.light, tuple(n), basis) for n in normals.tolist()]
    )
    # No side is nearly black, as ratios would become large there.
    least = light.unshadowed[1] * light.spec.unit / (light.albedo * light.mean)
    assert least.min() > 0.02 and least.max() < 0.1
    bare = np.maximum(expected, light.unshadowed[1])
    np.testing.assert_allclose(bare_about(light, normals), bare, rtol=2e-5)
    np.testing.assert_allclose(sky.lobe[[0, 1, 4]], cosine_lobe_factors(3) / math.pi)


def test_lamps_hidden_from_the_middle_are_not_lost() -> None:
    """A red area light that shows the middle its back, alone and beside a green lamp."""
    sides = {"u": [0.0, 5.0, 0.0], "v": [0.0, 0.0, 5.0]}
    area = {"type": "area", "corner": [4000.0, 0.0, 0.0], **sides, "radiance": [9.0, 0.0, 0.0]}
    green = {**LAMP, "irradiance": [0.0, 2.0, 0.0]}
    for lights in ([area], [area, green]):
        light = turned(lights=lights, albedo=[0.5, 0.5, 0.0])
        assert light.mean[0] == 0.0
        least = light.unshadowed.least
        assert (least > 0.0).tolist() == [True, len(lights) == 2, False]


@pytest.mark.parametrize(
    ("settings", "shading", "shared"),
    [
        ({"lights": [SKY]}, "gi", True),
        ({"lights": [SKY]}, "vicinity", False),
        ({"lights": [SKY], "rotating": False}, "gi", True),
        ({"lights": [CONSTANT]}, "gi", False),
        ({"lights": [CONSTANT], "representation": "transfer", "order": 2}, "gi", False),
        ({"lights": [CONSTANT], "bounces": 0, "projected": True}, "gi", True),
        ({"lights": [CONSTANT], "bounces": 0, "projected": True}, "vicinity", False),
        ({"lights": [CONSTANT, LAMP]}, "gi", True),
        ({"lights": [CONSTANT, LAMP]}, "vicinity", False),
    ],
)
def test_ratios_are_for_sided_light_and_projected_texels(
    settings: dict[str, Any], shading: str, shared: bool
) -> None:
    scene = load_scene("demo:orbital", **{"projected": False, **settings})
    assert carries_irradiance_ratios(scene, shading, scene.projection.any) is shared


def test_provisional_light_follows_the_pixels_normals(tmp_path: Path, workbench: Make) -> None:
    bench = workbench(scene_of(ball(), 0.0, lights=[soft_probe(tmp_path)], albedo=0.5, lobes=0))
    view = bench.view(size=40, light=ODD)
    frame = bench.renderer.render(view)
    light = RotatedLight(bench.caches.spec("gi"), view)
    normals = frame.gbuffer.normals(Tiles(1))
    shown = frame.radiance.reshape(-1, 3)[frame.gbuffer.pixels]
    np.testing.assert_allclose(shown, bare_about(light, normals) * light.spec.unit, rtol=1e-4)
    assert shown.std() > 0.1 * shown.mean()


def test_ratios_are_nearer_to_the_truth_than_plain_light(
    tmp_path: Path, workbench: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a ball under light that falls off from one pole, by texels two voxels apart."""
    settings = {
        "lights": [soft_probe(tmp_path)],
        "albedo": 0.5,
        "bounces": 0,
        "lobes": 0,
        "lattice": 0.5,
    }
    bench = workbench(scene_of(ball(20, 6.0), 0.0, target_error=0.01, **settings))
    view = bench.view(size=48, light=ODD)
    shared = bench.bake(view)
    truth = bench.renderer.render(replace(view, shading="path_traced", samples=4096))
    monkeypatch.setattr(texel_shading, "carries_irradiance_ratios", lambda *_: False)
    bench.renderer.forget_views()
    plain = bench.renderer.render(view)
    assert relative_rmse(shared, truth) < 0.5 * relative_rmse(plain, truth)


def test_normals_of_projected_texels_are_found_once(
    orbital: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    view = orbital.view(size=24)
    asked = []
    gbuffer = orbital.renderer.gbuffer(view)
    texels = orbital.renderer.surface.texels(view, gbuffer)
    found = find_texel_normals(texels, LatticeNormals(1 << 20), orbital.prepared, Tiles(2))
    monkeypatch.setattr(
        texel_normals,
        "fill_texel_normals",
        lambda *each: (asked.append(len(each[4])), fill_texel_normals(*each)),
    )
    assert (
        found.select(
            np.zeros(len(found.at_positions), np.bool_), texels, orbital.prepared, Tiles(1)
        )
        is found.at_positions
    )
    places = texels.positions
    count = len(found.at_positions)
    there = np.empty((3, count))
    normals = np.empty((3, count))
    verdicts = np.empty(count, np.uint8)
    project_texels(
        orbital.prepared.field,
        orbital.prepared.step,
        gbuffer.isovalue,
        places,
        there,
        normals,
        verdicts,
    )
    projected = verdicts == TEXEL_PROJECTED
    projected[::3] = False
    for mask in (projected & (np.arange(count) % 2 == 0), projected, projected):
        facing = found.select(mask, texels, orbital.prepared, Tiles(1))
        np.testing.assert_allclose(facing[mask], normals.T[mask], atol=2e-3)
        assert np.array_equal(facing[~mask], found.at_positions[~mask])
    assert sum(asked) == projected.sum() > 100, "each is found once"
    assert found.nbytes == 25 * count


def test_ratios_leave_light_from_all_sides_as_it_is(
    evenly_lit: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where shares are asked for nevertheless, they are the light itself but for weights."""
    view = evenly_lit.view()
    plain = evenly_lit.renderer.render(view)
    monkeypatch.setattr(texel_shading, "carries_irradiance_ratios", lambda *_: True)
    evenly_lit.renderer.forget_views()
    shared = evenly_lit.renderer.render(view)
    assert relative_rmse(shared, plain) < 0.01
    assert shared.radiance.tobytes() != plain.radiance.tobytes()
    assert shared.noise == pytest.approx(plain.noise, rel=0.1)
    assert LOOSE > shared.noise > 0.0
