"""What keeps a graphics card from drawing a view, each thing by its name."""

from typing import Any

import pytest

from isogi_core.frame.card.obstacles import find_obstacles
from isogi_core.model.view import View, read_window
from isogi_core.plan.scene import Scene
from tests.frame.conftest import SKY
from tests.loaded import load_scene

LAMP = {"type": "directional", "azimuth": -30, "elevation": 40, "irradiance": 2.0}


def view_of(scene: Scene, **settings: Any) -> View:
    """A view of a scene."""
    return View(scene.isovalue, scene.camera(30.0, 20.0, 3.0, 30.0), **settings)


@pytest.mark.parametrize(
    ("settings", "names"),
    [
        ({}, []),
        ({"lights": [SKY], "albedos": [0.2, 0.8], "cut": "x>40"}, []),
        ({"room": "cornell"}, ["rooms"]),
        ({"material": "glass"}, ["glass"]),
        ({"material": "subsurface", "mean_free_path": 2.0}, ["subsurface"]),
        ({"surfaces": [{"isovalue": 0.1, "clear": 0.5}]}, []),
        ({"shine": {"kind": "plastic"}}, []),
        ({"lights": [SKY, LAMP], "shine": {"kind": "plastic"}}, ["shine"]),
        ({"glow": [{"sphere": [40, 40, 40, 5]}]}, ["glow"]),
        ({"volumes": [{"use": "colour", "of": "gradient"}]}, []),
        ({"room": "cornell", "shine": {"kind": "metal"}}, ["rooms", "shine"]),
    ],
)
def test_a_scene_is_named_by_what_a_card_lacks(settings: dict[str, Any], names: list[str]) -> None:
    scene = load_scene("demo:orbital", **settings)
    found = find_obstacles(scene, view_of(scene), 1000)
    assert [each.name for each in found] == names
    assert all(each.why.endswith(".") for each in found)


@pytest.mark.parametrize(
    ("settings", "names"),
    [
        ({"shading": "lambert"}, []),
        ({"shading": "phong_shadow"}, []),
        ({"shading": "vicinity"}, ["shading"]),
        ({"shading": "path_traced"}, ["shading"]),
        ({"window": read_window("x>40")}, []),
    ],
)
def test_a_view_is_named_by_what_a_card_lacks(settings: dict[str, Any], names: list[str]) -> None:
    scene = load_scene("demo:orbital")
    assert [each.name for each in find_obstacles(scene, view_of(scene, **settings), 1000)] == names


def test_a_volume_beyond_the_limit_is_too_large() -> None:
    scene = load_scene("demo:orbital")
    assert not find_obstacles(scene, view_of(scene), 64 << 20)
    (found,) = find_obstacles(scene, view_of(scene), (64 << 20) + 1)
    assert found.name == "volume too large" and "64 MB" in found.why
