"""Pinned surfaces as scenes name them, what is refused, and volumes that are turned inside out."""

from typing import Any

import numpy as np
import pytest

from isogi_core.errors import SceneError, ViewError
from isogi_core.plan.assembly import load_scene
from tests.frame.conftest import shell

SKIN = {"isovalue": 60.0, "clear": 0.5, "albedo": [0.8, 0.5, 0.4], "name": "skin"}


def test_a_scene_has_pinned_surfaces_and_light_that_stays() -> None:
    scene = load_scene("demo:casting", surfaces=[SKIN], clear=0.25)
    (pinned,) = scene.surfaces.pinned
    assert pinned.table == SKIN
    assert (scene.surfaces.clear, scene.lighting.rotating, scene.plan.representation) == (
        0.25,
        False,
        "irradiance",
    )
    assert scene.bakes == {"among"}
    assert scene.inputs.reflecting == (0.8, 0.7, 0.7)
    told = {each.what for each in scene.left_out}
    assert {"light of pinned surfaces at each isovalue", "turning of the light"} <= told


def test_no_surface_beside_leaves_digests_as_they_were() -> None:
    plain = load_scene("demo:casting", rotating=False)
    assert load_scene("demo:casting", rotating=False, clear=0).digest == plain.digest
    clear = load_scene("demo:casting", clear=0.5)
    assert clear.bake_digest != plain.bake_digest
    other = load_scene("demo:casting", surfaces=[{**SKIN, "name": "hide"}])
    assert other.bake_digest == load_scene("demo:casting", surfaces=[SKIN]).bake_digest


def test_light_that_gets_through_is_planned_for() -> None:
    """Paths carry what is reflected or let through, at most their sum, and texels keep what leaves
    one side.
    """
    scene = load_scene("demo:casting", albedo=[0.5, 0.4, 0.3], transmission=0.4)
    assert (scene.surfaces.several, scene.surfaces.transmits, scene.lighting.rotating) == (
        True,
        True,
        False,
    )
    assert (scene.plan.representation, scene.bakes) == ("irradiance", {"among"})
    assert (
        scene.surfaces.leaving_for(None)
        == scene.inputs.albedo
        == scene.inputs.reflecting
        == (0.9, 0.8, 0.7)
    )
    assert not scene.inputs.grey
    told = {each.what: each for each in scene.left_out}
    assert told["irradiance of each side by itself"].saves[0].amount == scene.plan.bytes_per_texel
    assert "surfaces behind the first 8 in a pixel" not in told
    green = load_scene(
        "demo:casting", surfaces=[{**SKIN, "albedo": 0.1, "transmission": [0.1, 0.7, 0.1]}]
    )
    assert green.surfaces.pinned[0].table["transmission"] == [0.1, 0.7, 0.1] and not any(
        green.surfaces.transmission
    )
    assert (green.surfaces.transmits, green.inputs.grey) == (True, False)
    np.testing.assert_allclose(green.inputs.reflecting, (0.7, 0.8, 0.7))


def test_light_that_gets_through_is_in_digests() -> None:
    """The same sum of both is another light where what is reflected is another share of it."""
    some = [
        {},
        {"transmission": 0.2},
        {"albedo": 0.6, "transmission": 0.3},
        {"surfaces": [SKIN]},
        {"surfaces": [{**SKIN, "transmission": 0.1}]},
    ]
    scenes = [load_scene("demo:casting", rotating=False, **settings) for settings in some]
    assert (
        len({each.bake_digest for each in scenes})
        == len({each.digest for each in scenes})
        == len(some)
    )
    for settings, scene in zip(some, scenes, strict=True):
        none = load_scene("demo:casting", **{"rotating": False, "transmission": 0, **settings})
        assert none.digest == scene.digest


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"transmission": 0.4}, r"albedo \+ transmission = 1.1: lower one"),
        ({"albedo": [0.2, 0.2, 0.5], "transmission": [0.8, 0.8, 0.6]}, "transmission = 1.1"),
        ({"surfaces": [{**SKIN, "transmission": 0.3}]}, r"at 60 has albedo \+ transmission = 1.1"),
        ({"surfaces": [{**SKIN, "transmission": -1}]}, "has transmission -1: give"),
        ({"transmission": 2}, "transmission = 2"),
        ({"albedo": 0.2, "transmission": 0.5, "rotating": True}, "leave out rotating"),
        ({"albedo": 0.2, "transmission": 0.5, "shine": {}}, "transmission and a shine"),
        ({"albedo": 0.2, "transmission": 0.5, "material": "subsurface"}, "leave transmission out"),
        ({"transmission": 0.5, "material": "glass"}, "leave transmission out"),
        ({"surfaces": [{"isovalue": 1e9}]}, "isovalue is 1000000000.0: give a number from"),
        ({"surfaces": [{}]}, "isovalue is None"),
        ({"surfaces": [{**SKIN, "clear": 1.5}]}, "has clear = 1.5"),
        ({"surfaces": [{**SKIN, "albedo": 2}]}, "has albedo 2"),
        ({"surfaces": [{**SKIN, "name": 3}]}, "is named 3"),
        ({"surfaces": [{**SKIN, "colour": 3}]}, "no 'colour': choose from isovalue"),
        ({"surfaces": [{**SKIN, "isovalue": 50 + i} for i in range(4)]}, "has 4 .* give at most 3"),
        ({"surfaces": [SKIN, SKIN]}, "same isovalue"),
        ({"clear": 2}, "clear = 2"),
        ({"clear": 0.5, "rotating": True}, "leave out rotating"),
        ({"clear": 0.5, "room": "cornell", "rotating": True}, "leave out rotating"),
        ({"surfaces": [SKIN], "shine": {}}, "surfaces.* and a shine"),
        ({"surfaces": [SKIN], "albedos": [0, 0.9]}, "albedos that views choose"),
        ({"surfaces": [SKIN], "representation": "transfer"}, "irradiance|transfer"),
    ],
)
def test_what_has_no_meaning_is_refused(settings: dict[str, Any], words: str) -> None:
    with pytest.raises(SceneError, match=words):
        load_scene("demo:casting", **settings)


def test_views_choose_no_albedo_among_surfaces() -> None:
    scene = load_scene("demo:casting", surfaces=[SKIN])
    with pytest.raises(ViewError, match="leave albedo out"):
        scene.surfaces.albedo_for((0.1, 0.1, 0.1))


def test_a_volume_inside_out_has_the_same_values() -> None:
    volume = shell()
    turned = volume.inside_out
    assert turned.solid != volume.solid and turned.digest != volume.digest
    values, others = (
        each.offset + each.scale * each.voxels.astype(np.float64) for each in (volume, turned)
    )
    np.testing.assert_allclose(others, values, atol=1e-5)
    level, other = (float(each.normalise_isovalue(2.0)) for each in (volume, turned))
    np.testing.assert_array_equal(turned.voxels > other, volume.voxels < level)
    assert volume.inside_out is turned and turned.inside_out is volume
