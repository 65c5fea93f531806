"""What is taken away of volumes: cuts by planes, masks in the world, and masks of glows."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import nrrd
import numpy as np
import pytest

from isogi_core.cache.scene_assets import receive_assets, receive_glow_bits, send_assets
from isogi_core.errors import IsogiError, SceneError, VolumeError
from isogi_core.frame.gbuffer import trace
from isogi_core.frame.tiles import Tiles
from isogi_core.model.value_survey import no_progress
from isogi_core.model.view import View
from isogi_core.model.volume import Orientation, Volume
from isogi_core.plan.assembly import build_scene
from isogi_core.plan.scene import Scene
from isogi_core.plan.variants import cut_open
from isogi_core.plan.volumes.masks import (
    box_left,
    cut_away,
    is_one_of,
    values_beyond,
    voxels_left,
)
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_core.storage.store import Store
from tests.files.formats.phantom import SIZE, WAYS, affine, letter, lying
from tests.frame.conftest import MIDDLE, shell
from tests.frame.conftest import scene_of as bare_scene
from tests.loaded import load_scene

FIELD = np.random.default_rng(6).integers(20, 90, (9, 7, 8)).astype(np.uint8)


def save(path: Path, array: np.ndarray, placed: np.ndarray | None = None) -> None:
    """An array (z, y, x) as NRRD, in a patient's world where it is ``placed`` by an affine (4,
    4).
    """
    header: dict[str, Any] = {}
    if placed is not None:
        rows = {"space directions": placed[:3, :3].T, "space origin": placed[:3, 3]}
        header = {"space": "right-anterior-superior", **rows}
    nrrd.write(str(path), array, header, index_order="C")


def scene_of(folder: Path, more: str = "", table: str = "") -> Scene:
    """The scene of v.nrrd in a folder, masked by m.nrrd."""
    text = f'volume = "v.nrrd"\n{more}\n[[volumes]]\nfile = "m.nrrd"\nuse = "mask"\n{table}\n'
    (folder / "s.toml").write_text(text)
    return load_scene(folder / "s.toml")


def values(volume: Volume) -> np.ndarray:
    """Voxels in the units of the file."""
    return volume.offset + volume.scale * volume.voxels.astype(np.float64)


@pytest.mark.parametrize(("solid", "outside"), [("above", 20), ("below", 89)])
def test_outside_of_a_mask_is_the_value_farthest_outside(
    tmp_path: Path, solid: str, outside: int
) -> None:
    save(tmp_path / "v.nrrd", FIELD)
    inside = np.random.default_rng(7).random(FIELD.shape) < 0.4
    save(tmp_path / "m.nrrd", inside.astype(np.uint8) * 3)
    scene = scene_of(tmp_path, f'solid = "{solid}"')
    np.testing.assert_array_equal(values(scene.volume), np.where(inside, FIELD, outside))
    assert "Outside of 'm.nrrd' there is no surface." in scene.volume.orientation.notes
    plain = load_scene(tmp_path / "v.nrrd", solid=solid)
    assert plain.bake_digest != scene.bake_digest and plain.volume.dtype == scene.volume.dtype


def test_labels_choose_what_is_inside_and_masks_intersect(tmp_path: Path) -> None:
    labels = np.random.default_rng(8).integers(0, 5, FIELD.shape).astype(np.int16)
    other = np.where(FIELD > 50, 1.0, np.nan).astype(np.float32)
    for name, array in {"v": FIELD, "m": labels, "n": other}.items():
        save(tmp_path / f"{name}.nrrd", array)
    scene = scene_of(tmp_path, table='labels = [2, 4]\n[[volumes]]\nfile = "n.nrrd"\nuse = "mask"')
    kept = np.isin(labels, (2, 4)) & (FIELD > 50)
    np.testing.assert_array_equal(values(scene.volume), np.where(kept, FIELD, 20))


@pytest.mark.parametrize("way", WAYS[::5])
def test_a_mask_lies_in_the_world_and_not_in_the_file(tmp_path: Path, way: Any) -> None:
    """The volume and its mask are stored along other axes, and the mask has a coarser grid over a
    part.
    """
    array, placed = lying(*way)
    save(tmp_path / "v.nrrd", array, placed)
    coarse = affine() @ np.array(
        [[2.0, 0, 0, 2.5], [0, 3.0, 0, 4.0], [0, 0, 2.0, 0.5], [0, 0, 0, 1.0]]
    )
    save(tmp_path / "m.nrrd", np.ones((4, 3, 5), np.uint8), coarse)
    volume = scene_of(tmp_path).volume
    z, y, x = np.indices(volume.shape)
    world = volume.orientation.to_world(np.stack([x, y, z], -1) * np.array(volume.spacing))
    index = np.rint((world - affine()[:3, 3]) / np.diag(affine())[:3]).astype(int)
    span = [(2, 11), (3, 11), (0, 7)]  # half a coarse voxel around its outermost ones
    inside = np.logical_and.reduce(
        [(index[..., i] >= low) & (index[..., i] <= high) for i, (low, high) in enumerate(span)]
    )
    expected = np.where(inside, letter()[index[..., 2], index[..., 1], index[..., 0]], 0)
    np.testing.assert_array_equal(values(volume), expected)


def test_a_turned_mask_is_met_by_its_nearest_voxels(tmp_path: Path) -> None:
    save(tmp_path / "v.nrrd", letter(), affine())
    c, s = np.cos(0.5), np.sin(0.5)
    turn = np.array([[c, -s, 0, 4.0], [s, c, 0, -3.0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    marks = np.random.default_rng(9).random((12, 24, 20)) < 0.5
    save(tmp_path / "m.nrrd", marks.astype(np.uint8), affine() @ turn)
    volume = scene_of(tmp_path).volume
    expected = np.zeros_like(letter())
    for x, y, z in np.ndindex(*SIZE):
        i, j, k, _ = np.floor(np.linalg.solve(turn, [x, y, z, 1.0]) + 0.5).astype(int)
        there = 0 <= i < 20 and 0 <= j < 24 and 0 <= k < 12
        if there and marks[k, j, i]:
            expected[z, y, x] = letter()[z, y, x]
        else:
            expected[z, y, x] = 0
    np.testing.assert_array_equal(values(volume), expected)


def test_a_copy_of_a_masked_volume_is_that_of_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    field = np.tile(FIELD, (5, 6, 7))
    save(tmp_path / "v.nrrd", field)
    save(tmp_path / "m.nrrd", (field % 3).astype(np.uint8))
    own = scene_of(tmp_path)
    monkeypatch.setenv("ISOGI_VOLUME_CACHE", str(tmp_path / "copies"))
    monkeypatch.setenv("ISOGI_VOLUME_MB", "1")
    copied = scene_of(tmp_path)
    assert (
        list((tmp_path / "copies").glob("*.voxels")) and copied.volume.digest == own.volume.digest
    )
    save(tmp_path / "m.nrrd", (field % 3 == 1).astype(np.int16))
    assert scene_of(tmp_path).volume.digest != own.volume.digest, (
        "a changed mask makes another copy"
    )


def test_workers_elsewhere_get_the_masked_volume(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ISOGI_VOLUME_CACHE", str(tmp_path / "copies"))
    save(tmp_path / "v.nrrd", FIELD)
    save(tmp_path / "m.nrrd", FIELD % 3)
    scene = scene_of(tmp_path)
    store = Store(tmp_path / "store")
    source, volume = receive_assets(scene.source, send_assets(scene, store), store)
    assert build_scene(source, volume=volume).bake_digest == scene.bake_digest


MISTAKES = [
    ({}, "", 'use = "label"', SceneError, "use = 'label'"),
    ({}, "", "tint = 3", SceneError, "sets tint, unknown here"),
    ({"m": np.zeros_like(FIELD)}, "", "", VolumeError, "No voxel of the volume is inside 'm.nrrd'"),
    ({"m": FIELD}, "", "labels = [200]", VolumeError, "No voxel of the volume is inside"),
    ({"m": FIELD[:1]}, "", "", VolumeError, "The mask 'm.nrrd' cannot be used"),
    (
        {"v": (FIELD, np.eye(4)), "m": FIELD[:5]},
        "",
        "",
        SceneError,
        "one does not say where it lies",
    ),
    (
        {"v": (FIELD, np.eye(4))},
        "spacing = [1, 1, 2]",
        "",
        SceneError,
        "moves the volume away from its masks",
    ),
]


@pytest.mark.parametrize(("files", "more", "table", "error", "message"), MISTAKES)
def test_mistakes_with_masks_are_told(
    tmp_path: Path,
    files: dict[str, Any],
    more: str,
    table: str,
    error: type[IsogiError],
    message: str,
) -> None:
    for name, given in {"v": FIELD, "m": FIELD, **files}.items():
        save(tmp_path / f"{name}.nrrd", *(given if isinstance(given, tuple) else (given,)))
    text = f'volume = "v.nrrd"\n{more}\n[[volumes]]\nfile = "m.nrrd"\n{table}\n'
    (tmp_path / "s.toml").write_text(text if "use" in table else f'{text}use = "mask"\n')
    with pytest.raises(error, match=message):
        load_scene(tmp_path / "s.toml")


def test_a_demo_has_no_masks(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(
        'volume = "demo:casting"\n[[volumes]]\nfile = "m.nrrd"\nuse = "mask"\n'
    )
    with pytest.raises(SceneError, match="leave out"):
        load_scene(tmp_path / "s.toml")


@pytest.mark.parametrize("kind", [np.uint64, np.int64])
def test_masks_tell_labels_of_64_bits_apart(kind: type) -> None:
    slab = np.array([[[0, 2**53, 2**53 + 1, 2**62 + 1]]], kind)
    assert is_one_of(slab, (2**53 + 1,)).tolist() == [[[False, False, True, False]]]
    assert is_one_of(slab, (2**53, 2**62, -1, 0.5)).tolist() == [[[False, True, False, False]]]


def test_masks_find_labels_in_the_type_of_their_values() -> None:
    assert is_one_of(np.array([[[0.1, 0.2]]], np.float32), (0.1,)).tolist() == [[[True, False]]]
    assert is_one_of(np.array([[[True, False]]]), (1,)).tolist() == [[[True, False]]]


# --- cuts
# --------------------------------------------------------------------------------------------------


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
    assert np.array_equal(cut.voxels[inside], volume.voxels[inside])
    taken = cut.voxels[~inside]
    # Of values from 0 to 1, the face of any isovalue is within an eighth of a voxel of the last;
    # were it nearer by as much again, edges beside it would be rounder.
    assert (taken <= -7.0).all() and (taken >= -10.0).all() and len({*taken.tolist()}) <= 1


@pytest.mark.parametrize(
    "text", ["x>20", "x<9;x>25;z>3", "y<4;y>9", "y<16;z<16.5", "x>900", "x>1;y>1;z>1"]
)
def test_values_beyond_are_those_of_all_cells_there(text: str) -> None:
    voxels = np.random.default_rng(1).random((33, 33, 33), np.float32)
    volume = replace(shell(), voxels=voxels)
    box = box_left(voxels_left(volume, text), volume.size)
    corners = np.moveaxis(np.indices((32, 32, 32)), 0, -1)[..., ::-1]
    beyond = ~((corners >= box[0]) & (corners + 1 <= box[1])).all(axis=-1)
    cells = np.lib.stride_tricks.sliding_window_view(voxels, (2, 2, 2))[beyond]
    if beyond.any():
        expected = (cells.min(), cells.max())
    else:
        expected = (np.inf, -np.inf)
    assert values_beyond(volume, box) == expected


def test_a_cut_keeps_all_that_is_told_of_values() -> None:
    volume = shell()
    cut = cut_away(shell(), "x>16")
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
        orientation=Orientation(
            ((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)), (5.0, 0.0, 0.0)
        ),
    )
    assert voxels_left(turned, "x>15")[1] == range(11), "world x is the box's y, moved by 5"
    assert voxels_left(turned, "y<-20")[0] == range(11), (
        "world y is the box's x backwards, of 2 units a voxel"
    )


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("1,1,0>3", "across the voxels"),
        ("x>-5", "leaves nothing"),
        ("x=3", "cannot be read"),
        ("", "cannot be read"),
    ],
)
def test_a_cut_that_cannot_be_made_says_why(text: str, reason: str) -> None:
    with pytest.raises(SceneError, match=reason):
        cut_away(shell(), text)


@pytest.mark.parametrize("isovalue", [0.0, 1.0, 2.0])
def test_faces_are_flat_and_at_one_place_for_all_isovalues(isovalue: float) -> None:
    scene = bare_scene(cut_away(shell(), "x>16.3"), isovalue)
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


# --- masks of glows
# --------------------------------------------------------------------------------------------------


LABELS = np.zeros(FIELD.shape, np.int16)
LABELS[2:5, 1:4, 3:7] = 4
LABELS[6:, 5:, :2] = 9


def glowing_scene(folder: Path, *glows: dict[str, Any], **settings: Any) -> Scene:
    """The scene of v.nrrd in a folder, in which ``glows`` have m.nrrd for a mask."""
    nrrd.write(str(folder / "v.nrrd"), FIELD, index_order="C")
    nrrd.write(str(folder / "m.nrrd"), LABELS, index_order="C")
    mask = str(folder / "m.nrrd")
    return load_scene(
        folder / "v.nrrd",
        glow=[{"mask": mask, **each} for each in glows],
        isovalue=50.0,
        **settings,
    )


def test_masks_are_bits_of_voxels_and_their_boxes_regions(tmp_path: Path) -> None:
    glowing = glowing_scene(tmp_path, {}, {"labels": [4], "radiance": [3, 2, 1]}).lighting.glowing
    np.testing.assert_array_equal(
        glowing.bits, (LABELS != 0) * np.uint8(1) + (LABELS == 4) * np.uint8(2)
    )
    lows = glowing.middles - glowing.halves
    highs = glowing.middles + glowing.halves
    np.testing.assert_allclose(lows, [[0.0, 0.5, 1.5], [2.5, 0.5, 1.5]])
    np.testing.assert_allclose(highs, [[6.5, 6.0, 8.0], [6.5, 3.5, 4.5]])
    sphere = glowing_scene(tmp_path, {"sphere": [4, 3, 3, 2]}).lighting.glowing
    assert sphere.round.all() and sphere.masked.all() and sphere.halves[0, 0] == 2.0


def test_light_depends_on_a_mask_and_not_on_its_file(tmp_path: Path) -> None:
    one, other = (
        glowing_scene(tmp_path, {"labels": [label], "box": [[0, 0, 0], [7, 6, 8]]})
        for label in (4, 9)
    )
    assert one.lighting.glowing.halves.tolist() == other.lighting.glowing.halves.tolist()
    assert one.bake_digest != other.bake_digest
    nrrd.write(str(tmp_path / "same.nrrd"), (LABELS == 4).astype(np.uint8), index_order="C")
    same = load_scene(
        tmp_path / "v.nrrd",
        isovalue=50.0,
        glow=[{"mask": str(tmp_path / "same.nrrd"), "box": [[0, 0, 0], [7, 6, 8]], "radiance": 3}],
    )
    assert same.bake_digest == one.bake_digest and same.digest != one.digest


def test_other_machines_are_given_what_masks_take(tmp_path: Path) -> None:
    scene = glowing_scene(tmp_path, {"labels": [4]})
    store = Store(tmp_path / "store")
    assets = send_assets(scene, store)
    (tmp_path / "m.nrrd").unlink()
    source, volume = receive_assets(replace(scene.source, base=Path("/nowhere")), assets, store)
    made = build_scene(source, no_progress, volume, None, receive_glow_bits(assets, store))
    assert made.bake_digest == scene.bake_digest
    cut = cut_open(scene, "z>6", "cut")
    np.testing.assert_array_equal(cut.lighting.glowing.bits, scene.lighting.glowing.bits)


@pytest.mark.parametrize(
    ("glow", "sentence"),
    [
        ({"labels": [7]}, "No voxel of the volume is in the glow's mask"),
        ({"labels": 4}, "A glow's labels are 4: give a list"),
        ({"mask": 3}, "A glow's mask is 3: give the file"),
        ({"mask": "nowhere.nrrd"}, "nowhere.nrrd"),
    ],
)
def test_a_bad_mask_is_refused_in_a_sentence(
    glow: dict[str, Any], sentence: str, tmp_path: Path
) -> None:
    with pytest.raises(IsogiError, match=sentence):
        glowing_scene(tmp_path, glow)


def test_labels_without_a_mask_are_refused() -> None:
    with pytest.raises(IsogiError, match="A glow has labels and no mask: add mask"):
        load_scene("demo:orbital", glow=[{"labels": [1], "sphere": [40, 50, 60, 5]}])
