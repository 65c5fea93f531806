"""Masks cut a volume where they lie in the world, whatever their grids; a scene without them is what it was."""

from pathlib import Path
from typing import Any

import nrrd
import numpy as np
import pytest

from isogi_core.cache.scene_assets import receive_assets, send_assets
from isogi_core.errors import IsogiError, SceneError, VolumeError
from isogi_core.model.volume import Volume
from isogi_core.plan.assembly import build_scene
from isogi_core.plan.scene import Scene
from isogi_core.plan.volumes.masks import is_one_of
from isogi_core.storage.store import Store
from tests.files.formats.phantom import SIZE, WAYS, affine, letter, lying
from tests.loaded import load_scene

FIELD = np.random.default_rng(6).integers(20, 90, (9, 7, 8)).astype(np.uint8)


def save(path: Path, array: np.ndarray, placed: np.ndarray | None = None) -> None:
    """An array (z, y, x) as NRRD, in a patient's world where it is ``placed`` by an affine (4, 4)."""
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
def test_outside_of_a_mask_is_the_value_farthest_outside(tmp_path: Path, solid: str, outside: int) -> None:
    save(tmp_path / "v.nrrd", FIELD)
    inside = np.random.default_rng(7).random(FIELD.shape) < 0.4
    save(tmp_path / "m.nrrd", inside.astype(np.uint8) * 3)
    scene = scene_of(tmp_path, f'solid = "{solid}"')
    np.testing.assert_array_equal(values(scene.volume), np.where(inside, FIELD, outside))
    assert scene.volume.orientation.notes == ("Outside of 'm.nrrd' there is no surface.",)
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
    """The volume and its mask are stored along other axes, and the mask has a coarser grid over a part."""
    array, placed = lying(*way)
    save(tmp_path / "v.nrrd", array, placed)
    coarse = affine() @ np.array([[2.0, 0, 0, 2.5], [0, 3.0, 0, 4.0], [0, 0, 2.0, 0.5], [0, 0, 0, 1.0]])
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
        expected[z, y, x] = letter()[z, y, x] if there and marks[k, j, i] else 0
    np.testing.assert_array_equal(values(volume), expected)


def test_a_copy_of_a_masked_volume_is_that_of_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    field = np.tile(FIELD, (5, 6, 7))
    save(tmp_path / "v.nrrd", field)
    save(tmp_path / "m.nrrd", (field % 3).astype(np.uint8))
    own = scene_of(tmp_path)
    monkeypatch.setenv("ISOGI_VOLUME_CACHE", str(tmp_path / "copies"))
    monkeypatch.setenv("ISOGI_VOLUME_MB", "1")
    copied = scene_of(tmp_path)
    assert list((tmp_path / "copies").glob("*.voxels")) and copied.volume.digest == own.volume.digest
    save(tmp_path / "m.nrrd", (field % 3 == 1).astype(np.int16))
    assert scene_of(tmp_path).volume.digest != own.volume.digest, "a changed mask makes another copy"


def test_workers_elsewhere_get_the_masked_volume(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ISOGI_VOLUME_CACHE", str(tmp_path / "copies"))
    save(tmp_path / "v.nrrd", FIELD)
    save(tmp_path / "m.nrrd", FIELD % 3)
    scene, store = scene_of(tmp_path), Store(tmp_path / "store")
    source, volume = receive_assets(scene.source, send_assets(scene, store), store)
    assert build_scene(source, volume=volume).bake_digest == scene.bake_digest


MISTAKES = [
    ({}, "", 'use = "label"', SceneError, "use = 'label'"),
    ({}, "", "tint = 3", SceneError, "sets tint, unknown here"),
    ({"m": np.zeros_like(FIELD)}, "", "", VolumeError, "No voxel of the volume is inside 'm.nrrd'"),
    ({"m": FIELD}, "", "labels = [200]", VolumeError, "No voxel of the volume is inside"),
    ({"m": FIELD[:1]}, "", "", VolumeError, "The mask 'm.nrrd' cannot be used"),
    ({"v": (FIELD, np.eye(4)), "m": FIELD[:5]}, "", "", SceneError, "one does not say where it lies"),
    ({"v": (FIELD, np.eye(4))}, "spacing = [1, 1, 2]", "", SceneError, "moves the volume away from its masks"),
]


@pytest.mark.parametrize(("files", "more", "table", "error", "message"), MISTAKES)
def test_mistakes_with_masks_are_told(
    tmp_path: Path, files: dict[str, Any], more: str, table: str, error: type[IsogiError], message: str
) -> None:
    for name, given in {"v": FIELD, "m": FIELD, **files}.items():
        save(tmp_path / f"{name}.nrrd", *(given if isinstance(given, tuple) else (given,)))
    text = f'volume = "v.nrrd"\n{more}\n[[volumes]]\nfile = "m.nrrd"\n{table}\n'
    (tmp_path / "s.toml").write_text(text if "use" in table else f'{text}use = "mask"\n')
    with pytest.raises(error, match=message):
        load_scene(tmp_path / "s.toml")


def test_a_demo_has_no_masks(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text('volume = "demo:casting"\n[[volumes]]\nfile = "m.nrrd"\nuse = "mask"\n')
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
