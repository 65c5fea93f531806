"""Albedos that reflected light is kept for, and light of others that is mixed of theirs."""

from itertools import pairwise

import numpy as np
import pytest

from isogi_core.errors import SceneError
from isogi_core.model.scene_plan import Layer
from isogi_core.plan.budget import MIXING
from isogi_core.plan.left_out import percent
from isogi_core.plan.surfaces import MAX_NODES, choose_nodes, mixing_error, mixing_weights, spread_nodes
from tests.loaded import load_scene

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
    assert nodes[-1] == pytest.approx(most, rel=1e-15) and all(a < b for a, b in pairwise((0.0, *nodes)))
    for number, node in enumerate(nodes):
        np.testing.assert_allclose(mixing_weights(node, nodes, bounces), np.eye(len(nodes))[number], atol=1e-6)
    assert not mixing_weights(0.0, nodes, bounces).any()


@pytest.mark.parametrize(("most", "bounces"), SCENES)
def test_mixed_light_of_any_cavity_is_within_the_error(most: float, bounces: int) -> None:
    nodes = choose_nodes(most, bounces, 0.005)
    rng = np.random.default_rng(5)
    chances, shares = rng.uniform(0.002, 0.97, (40, 3)), rng.random((40, 3))
    for albedo in most * rng.random(20):
        weights = mixing_weights(float(albedo), nodes, bounces)
        for own, parts in zip(chances, shares, strict=True):
            direct = parts @ own
            true = sum(p * series(f, float(albedo), bounces) for f, p in zip(own, parts, strict=True))
            kept = [sum(p * series(f, node, bounces) for f, p in zip(own, parts, strict=True)) for node in nodes]
            assert abs(weights @ kept - true) <= (1.1 * mixing_error(nodes, bounces) + 1e-12) * (direct + true)


@pytest.mark.parametrize("allowed", [0.02, 0.005, 0.001])
def test_nodes_are_the_fewest_within_what_is_allowed(allowed: float) -> None:
    nodes = choose_nodes(0.9, 43, allowed)
    assert mixing_error(nodes, 43) <= allowed < mixing_error(spread_nodes(len(nodes) - 1, 0.9, 43), 43)


def test_where_no_nodes_are_enough_there_are_the_most() -> None:
    assert len(choose_nodes(1.0, 64, 1e-9)) == MAX_NODES


def test_three_nodes_mix_no_noise_up() -> None:
    """Noise of the nodes is of the same paths; even if it were not, it would not be doubled."""
    nodes = choose_nodes(0.9, 43, 0.005)
    assert len(nodes) == 3
    assert all(np.abs(mixing_weights(albedo, nodes, 43)).sum() < 2.0 for albedo in np.linspace(0.0, 0.9, 31))


# --- plans -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("light", "representation"), [(SKY, "transfer"), (CONSTANT, "constant")])
def test_a_scene_of_several_albedos_keeps_direct_light_and_nodes(light: dict[str, object], representation: str) -> None:
    scene = load_scene("demo:orbital", lights=[light], albedo=0.3, albedos=[0.0, 0.9])
    direct, indirect = scene.plan.layers
    assert scene.plan.representation == representation and scene.surfaces.albedos == (0.0, 0.9)
    assert (direct.kind, indirect.kind, scene.plan.channels) == ("direct", "indirect", 1)
    assert indirect.nodes == choose_nodes(0.9, scene.bounces, MIXING * 0.02) == scene.plan.nodes
    assert indirect.channels == len(indirect.nodes) == 3
    fixed = load_scene("demo:orbital", lights=[light], albedo=0.9)
    assert (scene.bounces, scene.plan.survival) == (fixed.bounces, fixed.plan.survival), "as the highest asks"
    assert dict(scene.plan.errors)["albedo"] == mixing_error(indirect.nodes, scene.bounces)
    left = next(each for each in scene.left_out if each.what == "light after each bounce")
    assert percent(dict(scene.plan.errors)["albedo"]) in left.why and left.saves[0].amount > 0


def test_light_for_several_albedos_ignores_the_scenes_own() -> None:
    scenes = [load_scene("demo:orbital", albedo=albedo, albedos=[0.0, 0.9]) for albedo in (0.3, [0.9, 0.5, 0.1])]
    assert len({scene.bake_digest for scene in scenes}) == 1 and len({scene.digest for scene in scenes}) == 2
    assert scenes[0].bake_digest != load_scene("demo:orbital", albedo=0.3, albedos=[0.0, 0.8]).bake_digest


def test_light_of_one_albedo_has_the_name_that_it_had() -> None:
    """Digests of layers without nodes are those of stores that were baked before there were any."""
    scene = load_scene("demo:orbital", lights=[CONSTANT], albedo=0.5, bounces=2, lattice=0.5)
    assert scene.layer_digest(Layer("whole")) == "1b7b2449fc554d7aa6d2"


def test_unreflected_light_is_of_any_albedo() -> None:
    scene = load_scene("demo:orbital", lights=[SKY], albedo=0.3, bounces=0)
    assert scene.surfaces.albedos == (0.0, 1.0) and [layer.nodes for layer in scene.plan.layers] == [()]
    assert load_scene("demo:orbital", lights=[SKY], albedo=0.0).surfaces.albedos is None, (
        "none that could be shown brighter"
    )
    assert load_scene("demo:orbital", lights=[SKY], albedo=0.3).surfaces.albedos is None


@pytest.mark.parametrize(
    ("settings", "complaint"),
    [
        ({"albedos": [0.5, 0.9]}, "leaves out the scene's own albedo"),
        ({"albedos": [0.3, 0.3]}, "two ascending numbers from 0 to 1"),
        ({"albedos": [0.0, 1.5]}, "two ascending numbers from 0 to 1"),
        ({"albedos": 0.9}, "a list of 2 numbers"),
        ({"albedos": [0.0, 0.9], "rotating": False}, "set rotating = true"),
        ({"albedos": [0.0, 0.9], "lights": [LAMP]}, "bounces = 0"),
    ],
)
def test_albedos_that_make_no_sense_are_refused(settings: dict[str, object], complaint: str) -> None:
    with pytest.raises(SceneError, match=complaint):
        load_scene("demo:orbital", **{"albedo": 0.3, "lights": [SKY], **settings})
