"""Surfaces of scenes: their material, the albedos and levels that light is kept for, and what is
refused.
"""

import json
from itertools import pairwise

import numpy as np
import pytest

from isogi_core.errors import SceneError
from isogi_core.model.material import DIFFUSE, Material
from isogi_core.model.scene_plan import Layer, LeftOut
from isogi_core.model.volume import make_volume
from isogi_core.plan.albedo_nodes import (
    choose_nodes,
    mixing_error,
    mixing_weights,
    spread_nodes,
)
from isogi_core.plan.isovalue_levels import find_levels, levels_around
from isogi_core.plan.left_out import percent
from isogi_core.plan.materials import unrefracted
from tests.frame.conftest import ball
from tests.loaded import load_scene

GLASS = {"material": "glass"}
INSIDE = {"material": "subsurface"}
SUN = {"type": "directional", "azimuth": 0, "elevation": 50, "irradiance": 1}


def test_glass_has_an_index_and_an_absorption() -> None:
    assert load_scene("demo:orbital").surfaces.material == DIFFUSE
    scene = load_scene("demo:orbital", **GLASS, absorption=0.1)
    assert not scene.bakes
    assert scene.surfaces.material == Material("glass", 1.5, (0.1, 0.1, 0.1))
    others = [
        load_scene("demo:orbital", **GLASS, **more)
        for more in ({}, {"index": 1.3}, {"absorption": [0.1, 0, 0]})
    ]
    digests = [each.digest for each in (load_scene("demo:orbital"), scene, *others)]
    assert len(set(digests)) == len(digests)


def test_a_subsurface_has_a_mean_free_path_and_light_of_its_own() -> None:
    scene = load_scene("demo:orbital", **INSIDE, mean_free_path=2, albedo=0.8)
    assert scene.surfaces.material.mean_free_path == 2.0
    assert scene.plan.representation == "irradiance"
    assert not scene.lighting.rotating
    assert scene.bakes == {"inside"}
    others = [
        load_scene("demo:orbital", **INSIDE, albedo=0.8, **more)
        for more in ({}, {"mean_free_path": 1})
    ]
    assert len({each.bake_digest for each in (scene, *others)}) == 3
    scene.require_texels()


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"material": "jelly"}, "material"),
        ({**GLASS, "index": 0.5}, "number from 1 to 4"),
        ({**GLASS, "absorption": -1}, "must not be less than 0"),
        ({**GLASS, "absorption": [1, 2]}, "give one, or three"),
        ({"index": 1.5}, 'add material = "glass"'),
        ({**GLASS, "albedo": 0.5}, "reflects no diffuse light: leave albedo out"),
        ({**GLASS, "shine": {}}, "leave shine out"),
        ({**GLASS, "glow": [{"sphere": [40, 40, 40, 5]}]}, "leave glow out"),
        ({**GLASS, "surfaces": [{"isovalue": 0.01}]}, "leave surfaces out"),
        ({**INSIDE, "mean_free_path": 0}, "more than 0"),
        ({**INSIDE, "albedo": [0.5, 0.5, 0]}, "0.01 or more"),
        ({**INSIDE, "lights": [SUN]}, "Lamps do not reach inside"),
        ({**INSIDE, "clear": 0.5}, "leave clear out"),
        ({"mean_free_path": 2}, 'add material = "subsurface"'),
    ],
)
def test_what_has_no_meaning_is_refused_in_a_sentence(
    settings: dict[str, object], said: str
) -> None:
    with pytest.raises(SceneError) as refused:
        load_scene("demo:orbital", **settings)
    assert said in str(refused.value)
    assert json.dumps(str(refused.value)).count("\\n") == 0


def left_out(**settings: object) -> tuple[LeftOut, ...]:
    """What the material of the orbital leaves out."""
    scene = load_scene("demo:orbital", **settings)
    return unrefracted(
        scene.surfaces.material, scene.lighting.lights, scene.lighting.environment.sharp
    )


def test_caustics_of_lamps_that_no_ray_meets_are_left_out() -> None:
    found = {each.what: each.why for each in left_out(lights=[SUN], **GLASS)}
    assert "texels of the isosurface" in found
    assert any("caustics" in what and "wall with radiance" in why for what, why in found.items())
    assert not any("caustic" in each.what for each in left_out(room="cornell", **GLASS))
    assert not left_out(lights=[SUN])


def test_light_that_glass_does_not_keep_is_not_given_away() -> None:
    load_scene("demo:orbital").require_texels()
    with pytest.raises(SceneError, match="keeps no light of its own"):
        load_scene("demo:orbital", **GLASS).require_texels()


# --- albedos
# --------------------------------------------------------------------------------------------------


SKY = {"type": "sky", "sun_azimuth": 20.0, "sun_elevation": 35.0}
CONSTANT = {"type": "constant", "radiance": 1.0}
LAMP = {"type": "point", "position": [10.0, 10.0, 90.0], "intensity": 100.0}
SCENES = ((0.3, 3), (0.7, 12), (0.9, 43), (0.9, 4), (1.0, 64), (0.05, 1))


def series(chance: float, albedo: float, bounces: int) -> float:
    """Light of a cavity whose walls all let the share ``chance`` out, term by term."""
    return sum(albedo**k * chance * (1.0 - chance) ** k for k in range(1, bounces + 1))


@pytest.mark.parametrize(("most", "bounces"), SCENES)
def test_mixed_light_is_exact_at_nodes_and_at_zero(most: float, bounces: int) -> None:
    nodes = choose_nodes(most, bounces, 0.005)
    assert nodes[-1] == pytest.approx(most, rel=1e-15) and all(
        a < b for a, b in pairwise((0.0, *nodes))
    )
    for number, node in enumerate(nodes):
        np.testing.assert_allclose(
            mixing_weights(node, nodes, bounces), np.eye(len(nodes))[number], atol=1e-6
        )
    assert not mixing_weights(0.0, nodes, bounces).any()


@pytest.mark.parametrize(("most", "bounces"), SCENES)
def test_mixed_light_of_any_cavity_is_within_the_error(most: float, bounces: int) -> None:
    nodes = choose_nodes(most, bounces, 0.005)
    rng = np.random.default_rng(5)
    chances = rng.uniform(0.002, 0.97, (40, 3))
    shares = rng.random((40, 3))
    for albedo in most * rng.random(20):
        weights = mixing_weights(float(albedo), nodes, bounces)
        for own, parts in zip(chances, shares, strict=True):
            direct = parts @ own
            true = sum(
                p * series(f, float(albedo), bounces) for f, p in zip(own, parts, strict=True)
            )
            kept = [
                sum(p * series(f, node, bounces) for f, p in zip(own, parts, strict=True))
                for node in nodes
            ]
            assert abs(weights @ kept - true) <= (1.1 * mixing_error(nodes, bounces) + 1e-12) * (
                direct + true
            )


@pytest.mark.parametrize("allowed", [0.02, 0.005, 0.001])
def test_nodes_are_the_fewest_within_what_is_allowed(allowed: float) -> None:
    nodes = choose_nodes(0.9, 43, allowed)
    assert (
        mixing_error(nodes, 43) <= allowed < mixing_error(spread_nodes(len(nodes) - 1, 0.9, 43), 43)
    )


def test_where_no_nodes_are_enough_there_are_the_most() -> None:
    assert 4 <= len(choose_nodes(1.0, 64, 1e-9)) <= 10, "each takes a channel of every texel"


def test_three_nodes_mix_no_noise_up() -> None:
    """Noise of the nodes is of the same paths; even if it were not, it would not be doubled."""
    nodes = choose_nodes(0.9, 43, 0.005)
    assert len(nodes) == 3
    assert all(
        np.abs(mixing_weights(albedo, nodes, 43)).sum() < 2.0
        for albedo in np.linspace(0.0, 0.9, 31)
    )


# --- plans
# --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("light", "representation"), [(SKY, "transfer"), (CONSTANT, "constant")])
def test_a_scene_of_several_albedos_keeps_direct_light_and_nodes(
    light: dict[str, object], representation: str
) -> None:
    scene = load_scene("demo:orbital", lights=[light], albedo=0.3, albedos=[0.0, 0.9])
    direct, indirect = scene.plan.layers
    assert scene.plan.representation == representation and scene.surfaces.albedos == (0.0, 0.9)
    assert (direct.kind, indirect.kind, scene.plan.channels) == ("direct", "indirect", 1)
    assert indirect.nodes == scene.plan.nodes and mixing_error(indirect.nodes, scene.bounces) < 0.01
    assert indirect.channels == len(indirect.nodes) == 3
    fixed = load_scene("demo:orbital", lights=[light], albedo=0.9)
    assert (scene.bounces, scene.plan.survival) == (fixed.bounces, fixed.plan.survival), (
        "as the highest asks"
    )
    assert dict(scene.plan.errors)["albedo"] == mixing_error(indirect.nodes, scene.bounces)
    left = next(each for each in scene.left_out if each.what == "light after each bounce")
    assert percent(dict(scene.plan.errors)["albedo"]) in left.why and left.saves[0].amount > 0


def test_light_for_several_albedos_ignores_the_scenes_own() -> None:
    scenes = [
        load_scene("demo:orbital", albedo=albedo, albedos=[0.0, 0.9])
        for albedo in (0.3, [0.9, 0.5, 0.1])
    ]
    assert (
        len({scene.bake_digest for scene in scenes}) == 1
        and len({scene.digest for scene in scenes}) == 2
    )
    assert (
        scenes[0].bake_digest
        != load_scene("demo:orbital", albedo=0.3, albedos=[0.0, 0.8]).bake_digest
    )


def test_light_of_one_albedo_has_the_name_that_it_had() -> None:
    """Digests of layers without nodes are those of stores that were baked before there were any."""
    scene = load_scene("demo:orbital", lights=[CONSTANT], albedo=0.5, bounces=2, lattice=0.5)
    assert scene.layer_digest(Layer("whole")) == "1b7b2449fc554d7aa6d2"


def test_unreflected_light_is_of_any_albedo() -> None:
    scene = load_scene("demo:orbital", lights=[SKY], albedo=0.3, bounces=0)
    assert scene.surfaces.albedos == (0.0, 1.0) and [
        layer.nodes for layer in scene.plan.layers
    ] == [()]
    assert load_scene("demo:orbital", lights=[SKY], albedo=0.0).surfaces.albedos is None, (
        "none that could be shown brighter"
    )
    assert load_scene("demo:orbital", lights=[SKY], albedo=0.3).surfaces.albedos is None


@pytest.mark.parametrize(
    ("settings", "complaint"),
    [
        ({"albedos": [0.5, 0.9]}, "leaves out the scene's albedo"),
        ({"albedos": [0.3, 0.3]}, "two ascending numbers from 0 to 1"),
        ({"albedos": [0.0, 1.5]}, "two ascending numbers from 0 to 1"),
        ({"albedos": 0.9}, "a list of 2 numbers"),
        ({"albedos": [0.0, 0.9], "rotating": False}, "set rotating = true"),
        ({"albedos": [0.0, 0.9], "lights": [LAMP]}, "bounces = 0"),
    ],
)
def test_albedos_that_make_no_sense_are_refused(
    settings: dict[str, object], complaint: str
) -> None:
    with pytest.raises(SceneError, match=complaint):
        load_scene("demo:orbital", **{"albedo": 0.3, "lights": [SKY], **settings})


# --- levels
# --------------------------------------------------------------------------------------------------


LEVELS = (10.0, 20.0, 40.0, 50.0)


def test_a_surface_moves_a_voxel_from_level_to_level() -> None:
    """Of a distance field that is the distance itself, whatever it is multiplied by."""
    slow = ball()
    fast = make_volume(7.0 * ball().voxels, (1.0, 1.0, 1.0))
    levels = np.array(find_levels(slow, (-4.0, 8.0), []))
    assert len(levels) == pytest.approx(13, abs=1)
    np.testing.assert_allclose(np.diff(levels), 12.0 / (len(levels) - 1), atol=0.1)
    assert len(find_levels(fast, fast.value_range, [])) == len(
        find_levels(slow, slow.value_range, [])
    )


def test_steep_parts_of_a_range_have_few_levels() -> None:
    """Where a field is 20 times as steep, levels are 20 times as far apart: surfaces are as near as
    elsewhere.
    """
    away = ball().voxels.astype(np.float64) * ball().scale + ball().offset
    steep = make_volume(
        np.where(away > 2.0, 2.0 + 20.0 * (away - 2.0), away).astype(np.float32), (1.0, 1.0, 1.0)
    )
    levels = np.array(find_levels(steep, (-4.0, 122.0), [62.0]))
    assert 62.0 in levels
    ways = np.where(levels > 2.0, 2.0 + (levels - 2.0) / 20.0, levels)
    np.testing.assert_allclose(np.diff(ways), 12.0 / (len(ways) - 1), atol=0.3)


def test_a_range_of_one_isovalue_has_one_level() -> None:
    assert find_levels(ball(), (2.0, 2.0), [2.0]) == (2.0,)


@pytest.mark.parametrize(
    ("shown", "expected"),
    [
        (20.0, {20.0: 1.0}),
        (25.0, {20.0: 0.75, 40.0: 0.25}),
        (10.0, {10.0: 1.0}),
        (60.0, {60.0: 1.0}),
    ],
)
def test_views_mix_the_levels_around_theirs(shown: float, expected: dict[float, float]) -> None:
    assert dict(levels_around(LEVELS, [], shown)) == expected


def test_light_is_not_mixed_across_a_pinned_surface() -> None:
    assert levels_around(LEVELS, [41.0], 45.0) == ((45.0, 1.0),)
    assert levels_around(LEVELS, [40.0], 39.0) == ((39.0, 1.0),)
    assert len(levels_around(LEVELS, [41.0], 35.0)) == 2
