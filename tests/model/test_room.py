"""Walls and rooms as scenes name them: what they are, what they mean for the plan, and what is
refused.
"""

from typing import Any

import numpy as np
import pytest

from isogi_core.errors import SceneError
from isogi_core.plan.assembly import load_scene
from isogi_core.plan.scene import Scene

WALL = {"corner": [0, 0, -1], "edges": [[9, 0, 0], [0, 9, 0]]}
CONSTANT = {"type": "constant", "radiance": 1.0}


def scene_of(**settings: Any) -> Scene:
    return load_scene("demo:orbital", **settings)


def test_a_cornell_room_stands_about_the_volume() -> None:
    scene = scene_of(room="cornell")
    low, high = np.array(scene.volume.world_bounds)
    corners = (
        scene.lighting.room.corners[:, None]
        + np.array([[0, 0], [1, 0], [0, 1], [1, 1]]) @ scene.lighting.room.edges
    )
    assert (corners.min(axis=(0, 1)) < low).all()
    assert (corners.max(axis=(0, 1)) > high).all()
    middle = (low + high) / 2.0
    normals = np.cross(scene.lighting.room.edges[:, 0], scene.lighting.room.edges[:, 1])
    assert (
        ((middle - scene.lighting.room.corners) * normals).sum(axis=1) > 0.0
    ).all()  # all are lit inside
    assert all(wall.sides == 1 for wall in scene.lighting.room.walls)
    assert sum(any(wall.radiance) for wall in scene.lighting.room.walls) == 1


def test_a_room_with_a_luminaire_has_no_sky() -> None:
    scene = scene_of(room="cornell")
    assert scene.lighting.lights == ()
    assert not scene.lighting.environment.image.any()
    assert scene.lighting.lamps.any
    assert scene_of(walls=[WALL]).lighting.environment.image.any()


def test_the_plan_of_a_room_keeps_irradiance_in_colour() -> None:
    scene = scene_of(room="cornell", albedo=0.3)
    (layer,) = scene.plan.layers
    assert (layer.kind, layer.channels) == ("irradiance", 3)
    assert scene.plan.bounces == scene_of(albedo=0.73).plan.bounces
    assert not scene.lighting.rotating
    assert "bake_irradiance" in next(
        each.what for each in scene.left_out if each.what.startswith("kernels")
    )


def test_light_in_the_store_depends_on_the_walls() -> None:
    """On where they are, what they reflect and what they give off; a scene without walls has the
    name it had.
    """
    scenes = [
        scene_of(lights=[CONSTANT], rotating=False, representation="irradiance"),
        *(
            scene_of(lights=[CONSTANT], walls=[{**WALL, **more}])
            for more in ({}, {"albedo": 0.2}, {"sides": 1})
        ),
        scene_of(lights=[CONSTANT], walls=[{**WALL, "radiance": [1, 0, 0]}]),
        scene_of(lights=[CONSTANT], walls=[{**WALL, "corner": [0, 0, -2]}]),
    ]
    assert (
        len({scene.bake_digest for scene in scenes})
        == len({scene.digest for scene in scenes})
        == len(scenes)
    )


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"room": "dining"}, "room = 'dining' .* is not one of cornell"),
        ({"walls": [{"corner": [0, 0, 0]}]}, "A wall lacks its 'edges'"),
        ({"walls": [{**WALL, "colour": 1}]}, "A wall has no 'colour': choose from corner, edges"),
        ({"walls": [{**WALL, "edges": [[1, 0, 0], [2, 0, 0]]}]}, "span no area"),
        ({"walls": [{**WALL, "edges": [[1, 0, 0], [1, 1, 0]]}]}, "not at a right angle"),
        ({"walls": [{**WALL, "edges": [1, 0, 0]}]}, "give two"),
        ({"walls": [{**WALL, "corner": [0, "x", 0]}]}, "give \\[x, y, z\\]"),
        (
            {"walls": [{**WALL, "albedo": 1.5}]},
            "A wall's albedo is 1.5, 1.5, 1.5: it must be from 0 to 1",
        ),
        ({"walls": [{**WALL, "albedo": [1, 2]}]}, "give a number or \\[r, g, b\\]"),
        ({"walls": [{**WALL, "radiance": -1}]}, "A wall's radiance is -1, -1, -1"),
        ({"walls": [{**WALL, "sides": 3}]}, "give 1 or 2, as many as are lit"),
        ({"walls": [WALL] * 65}, "has 65 walls: give it at most 64"),
        ({"walls": [WALL], "rotating": True}, "Walls stay where they are"),
        (
            {"walls": [WALL], "representation": "transfer"},
            "there are walls or other surfaces: leave it out",
        ),
    ],
)
def test_a_bad_wall_is_refused_in_a_sentence(settings: dict[str, Any], sentence: str) -> None:
    with pytest.raises(SceneError, match=sentence) as refused:
        scene_of(**settings)
    assert "\n" not in str(refused.value)
