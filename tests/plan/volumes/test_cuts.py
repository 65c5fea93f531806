"""Cuts: what is left of a volume, where its faces lie, and that light comes in."""

from dataclasses import replace

import numpy as np
import pytest

from isogi_core.errors import SceneError
from isogi_core.frame.gbuffer import trace
from isogi_core.frame.tiles import Tiles
from isogi_core.model.orientation import Orientation
from isogi_core.model.view import View
from isogi_core.plan.variants import cut_open
from isogi_core.plan.volumes.masks import CUT_AWAY_VALUE, box_left, cut_away, values_beyond, voxels_left
from isogi_core.prepared.prepared_scene import PreparedScene
from tests.frame.conftest import MIDDLE, scene_of, shell
from tests.loaded import load_scene


@pytest.mark.parametrize(
    ("text", "left"),
    [
        ("x>20", (range(21), range(33), range(33))),
        ("x>20.5", (range(21), range(33), range(33))),
        ("x<20.5;z>3", (range(21, 33), range(33), range(4))),
        ("y<4;y>9", (range(33), range(4, 10), range(33))),
        ("0,0,-2>-8", (range(33), range(33), range(4, 33))),
        ("x>900", (range(33), range(33), range(33))),
    ],
)
def test_planes_leave_the_voxels_before_them(text: str, left: tuple[range, ...]) -> None:
    volume = shell()
    assert voxels_left(volume, text) == left
    cut = cut_away(volume, text)
    inside = np.zeros(volume.shape, bool)
    inside[tuple(slice(each.start, each.stop) for each in left[::-1])] = True
    assert np.array_equal(cut.voxels, np.where(inside, volume.voxels, np.float32(CUT_AWAY_VALUE)))


@pytest.mark.parametrize("text", ["x>20", "x<9;x>25;z>3", "y<4;y>9", "y<16;z<16.5", "x>900", "x>1;y>1;z>1"])
def test_values_beyond_are_those_of_all_cells_there(text: str) -> None:
    voxels = np.random.default_rng(1).random((33, 33, 33), np.float32)
    volume = replace(shell(), voxels=voxels)
    box = box_left(voxels_left(volume, text), volume.size)
    corners = np.moveaxis(np.indices((32, 32, 32)), 0, -1)[..., ::-1]
    beyond = ~((corners >= box[0]) & (corners + 1 <= box[1])).all(axis=-1)
    cells = np.lib.stride_tricks.sliding_window_view(voxels, (2, 2, 2))[beyond]
    expected = (cells.min(), cells.max()) if beyond.any() else (np.inf, -np.inf)
    assert values_beyond(volume, box) == expected


def test_a_cut_keeps_all_that_is_told_of_values() -> None:
    volume, cut = shell(), cut_away(shell(), "x>16")
    assert cut.digest != volume.digest
    assert cut.digest != cut_away(shell(), "x>17").digest
    assert (cut.value_range, cut.core, cut.offset, cut.scale) == (
        *(volume.value_range, volume.core, volume.offset, volume.scale),
    )
    assert np.array_equal(cut.histogram()[0], volume.histogram()[0])
    assert cut_away(volume, "x>900") is volume


def test_planes_are_in_world_units_and_turned_with_the_volume() -> None:
    turned = replace(
        shell(),
        spacing=(2.0, 1.0, 1.0),
        orientation=Orientation(((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)), (5.0, 0.0, 0.0)),
    )
    assert voxels_left(turned, "x>15")[1] == range(11), "world x is the box's y, moved by 5"
    assert voxels_left(turned, "y<-20")[0] == range(11), "world y is the box's x backwards, of 2 units a voxel"


@pytest.mark.parametrize(
    ("text", "reason"),
    [("1,1,0>3", "across the voxels"), ("x>-5", "leaves nothing"), ("x=3", "cannot be read"), ("", "cannot be read")],
)
def test_a_cut_that_cannot_be_made_says_why(text: str, reason: str) -> None:
    with pytest.raises(SceneError, match=reason):
        cut_away(shell(), text)


@pytest.mark.parametrize("isovalue", [0.0, 1.0, 2.0])
def test_faces_are_flat_and_at_one_place_for_all_isovalues(isovalue: float) -> None:
    scene = scene_of(cut_away(shell(), "x>16.3"), isovalue)
    view = View(isovalue, scene.camera(0.0, 0.0, 3.0, 30.0), width=64, height=64)
    gbuffer = trace(view, PreparedScene(scene).surface(isovalue), Tiles(2))
    rings = np.linalg.norm(gbuffer.points[:, 1:] - MIDDLE, axis=1)
    face = gbuffer.points[(rings > 6.5 + isovalue) & (rings < 11.5 - isovalue)]
    assert len(face) > 20
    assert face[:, 0].min() >= 16.0 and face[:, 0].max() < 16.12


def test_a_scene_file_may_have_a_cut_of_its_own() -> None:
    scene = load_scene("demo:casting", cut="z>10")
    again = cut_open(load_scene("demo:casting"), "z>10", "casting-cut")
    assert scene.volume.digest == again.volume.digest
    assert scene.digest == again.digest and again.id == "casting-cut"
    twice = cut_open(scene, "x>20", "both")
    assert twice.source.document["cut"] == "z>10;x>20"
    assert twice.volume.digest == load_scene("demo:casting", cut="z>10;x>20").volume.digest
    with pytest.raises(SceneError, match="leaves nothing"):
        cut_open(scene, "z<20", "nothing")
