"""Glows as scenes name them: what they are, what they mean for the plan, and what is refused."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from isogi_core.errors import SceneError
from isogi_core.files.vector import triple
from isogi_core.model.glow import Glow, place_glows
from isogi_core.model.volume import Orientation, make_volume
from isogi_core.plan.assembly import load_scene
from isogi_core.plan.scene import Scene

BALL = {"sphere": [40, 50, 60, 5], "radiance": 2}
BLOCK = {"box": [[20, 20, 20], [30, 24, 28]]}
CONSTANT = {"type": "constant", "radiance": 1.0}
WALL = {"corner": [0, 0, -1], "edges": [[9, 0, 0], [0, 9, 0]]}


def scene_of(*glows: dict[str, Any], **settings: Any) -> Scene:
    return load_scene("demo:orbital", glow=list(glows), **settings)


def test_a_ray_gathers_the_radiance_over_the_mean_chord() -> None:
    """Against the mean chord of rays that are spread evenly over the body's surface, by cosine: 4 V
    / S.
    """
    glowing = scene_of(BALL, BLOCK).lighting.glowing
    rng = np.random.default_rng(3)
    half = np.array([5.0, 2.0, 4.0])
    areas = np.array([half[1] * half[2], half[0] * half[2], half[0] * half[1]])
    axis = rng.choice(3, 200_000, p=areas / areas.sum())
    start = half * rng.uniform(-1.0, 1.0, (len(axis), 3))
    start[np.arange(len(axis)), axis] = -half[axis]
    u = rng.random(len(axis))
    turn = rng.uniform(0.0, 2.0 * np.pi, len(axis))
    local = np.stack(
        [np.sqrt(u) * np.cos(turn), np.sqrt(u) * np.sin(turn), np.sqrt(1.0 - u)], axis=-1
    )
    way = np.stack([np.choose((c - axis) % 3, local[:, [2, 0, 1]].T) for c in range(3)], axis=-1)
    chord = np.min(np.where(way > 0.0, half - start, -half - start) / way, axis=1)
    np.testing.assert_allclose(glowing.chords, [4.0 / 3.0 * 5.0, chord.mean()], rtol=0.01)


def test_glow_has_a_layer_of_its_own_beside_all_other_light() -> None:
    """Keyed by place, and by what reflects it; not by colour and strength, nor by other lights."""
    plain = load_scene("demo:orbital", albedo=0.5)
    glowing = scene_of(BALL, albedo=0.5)
    *others, layer = glowing.plan.layers
    assert tuple(others) == plain.plan.layers and glowing.lighting.rotating
    assert (layer.kind, layer.channels) == ("glow", 1)
    assert [glowing.layer_digest(each) for each in others] == [
        plain.layer_digest(each) for each in others
    ]
    same = [
        scene_of({**BALL, "radiance": [9, 0, 1]}, albedo=0.5),
        scene_of(BALL, albedo=0.5, lights=[CONSTANT]),
    ]
    assert {scene.layer_digest(scene.plan.layers[-1]) for scene in (glowing, *same)} == {
        glowing.layer_digest(layer)
    }
    assert len({scene.digest for scene in (glowing, *same)}) == 3
    others = [
        scene_of({**BALL, "sphere": [41, 50, 60, 5]}),
        scene_of(BALL, BALL),
        scene_of(BALL, albedo=0.6),
    ]
    others += [scene_of(BALL, walls=[{**WALL, "albedo": albedo}]) for albedo in (0.2, 0.4)]
    lit = scene_of(BALL, walls=[{**WALL, "albedo": 0.4, "radiance": 3}])
    assert len({scene.layer_digest(scene.plan.layers[-1]) for scene in (glowing, *others)}) == 6
    assert lit.layer_digest(lit.plan.layers[-1]) == others[-1].layer_digest(
        others[-1].plan.layers[-1]
    )


def test_coloured_surfaces_keep_three_channels_of_each_glow() -> None:
    layer = scene_of(BALL, BLOCK, albedo=[0.8, 0.5, 0.2]).plan.layers[-1]
    assert (layer.channels, layer.colours) == (6, 3)
    assert scene_of(BALL, albedo=[0.8, 0.5, 0.2], bounces=0).plan.layers[-1].channels == 1
    left = [each.what for each in scene_of(BALL).left_out]
    assert "two of three channels of what glows" in left


def test_regions_lie_in_the_world_of_a_turned_volume() -> None:
    quarter = Orientation(((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)), (100.0, 50.0, 7.0))
    volume = replace(
        make_volume(np.linspace(0.0, 1.0, 9) * np.ones((9, 9, 9)), (1.0, 2.0, 3.0)),
        orientation=quarter,
    )
    one, other, middle = (
        quarter.to_world(np.array(each)) for each in ((1.0, 2.0, 3.0), (4.0, 8.0, 15.0), (4, 6, 9))
    )
    glows = Glow(box=(triple(other), triple(one))), Glow(sphere=(*triple(middle), 2.0))
    glowing = place_glows(glows, volume)
    np.testing.assert_allclose(glowing.middles, [[2.5, 5.0, 9.0], [4.0, 6.0, 9.0]])
    np.testing.assert_allclose(glowing.halves, [[1.5, 3.0, 6.0], [2.0, 2.0, 2.0]])
    with pytest.raises(
        SceneError, match="reaches out of the volume's box, \\[84, 50, 7\\] to \\[100, 58, 31\\]"
    ):
        place_glows([Glow(sphere=(50.0, 54.0, 20.0, 1.0))], volume)


def test_values_are_those_of_the_file_on_either_solid_side() -> None:
    values = np.linspace(100.0, 300.0, 9)[None, None] * np.ones((9, 9, 1))
    for solid in ("above", "below"):
        volume = make_volume(values, solid=solid)
        low, high = place_glows([Glow(values=(150.0, 200.0))], volume).ranges[0]
        inside = (volume.voxels[0, 0] >= low) & (volume.voxels[0, 0] <= high)
        assert inside.tolist() == [150.0 <= value <= 200.0 for value in values[0, 0]]


@pytest.mark.parametrize(
    ("glow", "sentence"),
    [
        (
            {"radiance": 1},
            "A glow has no place: give it a box, a sphere, a range of values or a mask",
        ),
        ({**BALL, **BLOCK}, "A glow has a box and a sphere: give one of them"),
        ({**BALL, "radiance": -1}, "A glow's radiance is -1, -1, -1: it must be from 0"),
        ({**BALL, "radiance": "red"}, "A glow's radiance is 'red': give a number or \\[r, g, b\\]"),
        (
            {**BALL, "colour": 1},
            "A glow has no 'colour': choose from box, sphere, values, mask, labels, radiance",
        ),
        ({"sphere": [40, 50, 60, 0]}, "A glow's sphere has the radius 0: give it one above 0"),
        ({"sphere": [40, 50, 60]}, "give its middle and radius"),
        (
            {"sphere": [400, 50, 60, 5]},
            "A glow reaches out of the volume's box, \\[0, 0, 0\\] to \\[95, 95, 95\\]: move",
        ),
        ({"box": [[20, 20, 20], [30, 24, 20]]}, "A glow's box has no volume"),
        ({"box": [20, 20, 20]}, "give two opposite corners"),
        ({"box": [[20, 20, 20], [30, 24, 96]]}, "A glow reaches out of the volume's box"),
        ({"values": [2, 1]}, "A glow's values are \\[2, 1\\]: give the least and the greatest"),
        (
            {"values": [2, 3]},
            "A glow's values are 2 to 3, and the volume's .* to 1: no voxel glows",
        ),
    ],
)
def test_a_bad_glow_is_refused_in_a_sentence(glow: dict[str, Any], sentence: str) -> None:
    with pytest.raises(SceneError, match=sentence) as refused:
        scene_of(glow)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"glow": [BALL] * 9}, "The scene has 9 glows: give it at most 8"),
        (
            {"glow": [BALL], "albedos": [0.0, 0.9]},
            "something glows: set bounces = 0, or leave it out",
        ),
        ({"glow": BALL}, "is not a list of \\[\\[glow\\]\\] tables"),
    ],
)
def test_glows_that_a_scene_cannot_have_are_refused(
    settings: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(SceneError, match=sentence):
        load_scene("demo:orbital", **settings)
