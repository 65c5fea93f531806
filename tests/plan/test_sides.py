"""The scenes in which the sides of several surfaces are lit."""

from pathlib import Path
from typing import Any

import nrrd
import numpy as np
import pytest

from isogi_core.errors import SceneError
from isogi_core.files.scene_file import read_clears
from isogi_core.plan.assembly import build_scene, load_scene
from isogi_core.plan.scene import Scene
from isogi_core.plan.variants import OUTER, Side, scene_of_side, sides_of, with_clears

SKIN = {"isovalue": 60.0, "clear": 0.5, "albedo": [0.8, 0.5, 0.4]}


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("demo:casting", surfaces=[SKIN, {"isovalue": 90.0}], isovalue=127.0)


def test_there_are_two_sides_of_each_surface(scene: Scene) -> None:
    sides = sides_of(scene)
    assert sides == tuple(Side(number, inner) for number in range(3) for inner in (False, True))
    made = [scene_of_side(scene, side, 127.0) for side in sides]
    assert len({each.bake_digest for each in made}) == 6
    assert [each.solid for each in made] == ["above", "below"] * 3
    assert [each.isovalue for each in made] == [127.0, 127.0, 60.0, 60.0, 90.0, 90.0]
    assert [each.surfaces.clear for each in made] == [0.0, 0.0, 0.5, 0.5, 0.0, 0.0]


def test_both_sides_transmit_alike() -> None:
    leaf = {"isovalue": 60.0, "albedo": 0.3, "transmission": [0.1, 0.5, 0.1]}
    scene = load_scene("demo:casting", albedo=0.2, transmission=0.6, surfaces=[leaf], isovalue=127.0)
    made = {side: scene_of_side(scene, side, 127.0) for side in sides_of(scene)}
    assert [each.surfaces.transmission for each in made.values()] == [(0.6,) * 3] * 2 + [(0.1, 0.5, 0.1)] * 2
    assert made[Side(1, True)].surfaces.pinned[0].transmission == (0.6,) * 3
    assert len({each.bake_digest for each in made.values()}) == 4
    for each in made.values():
        assert build_scene(each.source).bake_digest == each.bake_digest, "as workers open it"


def test_pinned_light_depends_on_what_is_shown_alone(scene: Scene) -> None:
    """One cache of the surface that slides serves every isovalue; pinned ones have one for each."""
    for side in sides_of(scene):
        one, other = (scene_of_side(scene, side, shown).bake_digest for shown in (127.0, 140.0))
        assert (one == other) == (side.number == 0), side


def test_a_pinned_surface_is_lit_by_all_others(scene: Scene) -> None:
    made = scene_of_side(scene, Side(1), 140.0)
    assert {each.isovalue: each.clear for each in made.surfaces.pinned} == {140.0: 0.0, 90.0: 0.0}
    assert made.surfaces.albedo == (0.8, 0.5, 0.4)
    assert made.span[0] == made.span[1]


def test_a_surface_at_the_shown_isovalue_lights_others_once(scene: Scene) -> None:
    made = scene_of_side(scene, Side(1), 90.0)
    assert [each.isovalue for each in made.surfaces.pinned] == [90.0]
    ends = [scene_of_side(scene, Side(1, True), shown).surfaces.pinned for shown in scene.volume.value_range]
    assert [len(each) for each in ends] == [2, 2]


@pytest.mark.parametrize("settings", [{"cut": "x<30"}, {"inside_out": True}, {"solid": "below"}])
def test_sides_of_what_is_cut_or_turned_are_found_again(settings: dict[str, Any], tmp_path: Path) -> None:
    nrrd.write(str(tmp_path / "ball.nrrd"), shell_of(33), index_order="C")
    scene = load_scene(tmp_path / "ball.nrrd", surfaces=[{"isovalue": 60.0, "clear": 0.5}], isovalue=90.0, **settings)
    for side in sides_of(scene):
        made = scene_of_side(scene, side, 100.0)
        assert (made.solid == scene.solid) != side.inner
        assert build_scene(made.source).bake_digest == made.bake_digest, side


def shell_of(side: int) -> np.ndarray:
    """A ball that is brightest in its middle, (side, side, side) uint8."""
    z, y, x = np.mgrid[:side, :side, :side] - (side - 1) / 2.0
    return np.clip(200.0 - 12.0 * np.sqrt(x**2 + y**2 + z**2), 0.0, 255.0).astype(np.uint8)


def test_a_process_that_opens_a_side_finds_the_same_light(scene: Scene) -> None:
    """The document of a side is all that workers are given."""
    for side in sides_of(scene):
        made = scene_of_side(scene, side, 133.0)
        assert build_scene(made.source).bake_digest == made.bake_digest, side
    assert scene_of_side(scene, OUTER, 133.0) is scene


def test_a_scene_with_other_clears_is_one_of_its_own(scene: Scene) -> None:
    changed = with_clears(scene, read_clears("0.25, off", 2), "other")
    assert [(each.isovalue, each.clear) for each in changed.surfaces.pinned] == [(60.0, 0.25)]
    assert changed.id == "other" and changed.volume is scene.volume
    assert changed.bake_digest != scene.bake_digest == with_clears(scene, (0.5, 0.0), "same").bake_digest
    assert build_scene(changed.source).bake_digest == changed.bake_digest, "as workers open it"
    alone = with_clears(scene, (None, None), "alone")
    assert not alone.surfaces.several and not alone.lighting.rotating


@pytest.mark.parametrize(
    ("text", "pinned", "reason"),
    [
        ("0.5", 2, "each of the 2"),
        ("1.5", 1, "from 0, opaque"),
        ("nan", 1, "or off"),
        ("", 1, "or off"),
        ("off", 0, "leave it"),
    ],
)
def test_clears_without_meaning_are_refused(text: str, pinned: int, reason: str) -> None:
    with pytest.raises(SceneError, match=reason):
        read_clears(text, pinned)


def test_a_target_may_name_what_its_surfaces_let_pass(tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    file.write_text("[[surfaces]]\nisovalue = 0.03\n[[surfaces]]\nisovalue = 0.05\nclear = 0.5\n")
    assert [each.clear for each in load_scene(f"{file}#surfaces=0.25,0.5").surfaces.pinned] == [0.25, 0.5]
    (left,) = load_scene(f"{file}#surfaces=off,0.75&environment=studio").surfaces.pinned
    assert (left.isovalue, left.clear) == (0.05, 0.75)
    with pytest.raises(SceneError, match="each of the 2 pinned surfaces"):
        load_scene(f"{file}#surfaces=0.5")
    with pytest.raises(SceneError, match="leave it out"):
        load_scene("demo:casting#surfaces=0.5")
