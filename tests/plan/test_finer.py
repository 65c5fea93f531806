"""Finer light: more texels and bands of the same scene, as far as there may be."""

import pytest

from isogi_core.plan.assembly import build_scene, load_scene
from isogi_core.plan.variants import FURTHER, finer, has_finer

SKY = {"type": "sky"}


def test_finer_light_has_more_texels_and_bands() -> None:
    scene = load_scene("demo:orbital", lights=[SKY])
    better = finer(scene)
    assert better.settings.lattice == 2.0 and better.volume is scene.volume
    before, after = ({layer.kind: layer.order for layer in each.plan.layers} for each in (scene, better))
    assert after == {kind: order + FURTHER for kind, order in before.items()}
    assert better.plan.order == max(after.values()) and better.plan.lobes == scene.plan.lobes
    assert not {scene.layer_digest(layer) for layer in scene.plan.layers} & set(
        map(better.layer_digest, better.plan.layers)
    )
    assert dict(better.plan.errors)["harmonics"] < dict(scene.plan.errors)["harmonics"]


def test_light_without_bands_has_more_texels_alone() -> None:
    scene = load_scene("demo:orbital", lights=[{"type": "constant"}])
    assert finer(scene).plan.layers == scene.plan.layers and finer(scene).settings.lattice == 2.0


def test_another_process_finds_the_same_light() -> None:
    """Workers are told the source of a scene, and the plan."""
    better = finer(load_scene("demo:orbital", lights=[SKY], lattice=0.5))
    built = build_scene(better.source)
    assert built.plan_digest(better.plan) == better.bake_digest


@pytest.mark.parametrize(
    ("settings", "expected"), [({}, True), ({"lattice": 2.5}, False), ({"room": "cornell"}, False)]
)
def test_there_is_finer_light_to_a_quarter_of_a_voxel(settings: dict[str, object], expected: bool) -> None:
    assert has_finer(load_scene("demo:orbital", **settings)) == expected
