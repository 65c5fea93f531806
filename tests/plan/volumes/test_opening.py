"""Large volumes: the copy that is made of them is the volume that memory would hold, made once, and
bounded.
"""

import json
import os
import shutil
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import nrrd
import numpy as np
import pytest
import zarr

from isogi_core.errors import SceneError, VolumeError
from isogi_core.files.grid import Grid
from isogi_core.model.value_survey import no_progress
from isogi_core.model.volume import Volume, make_volume
from isogi_core.plan.variants import at_time
from isogi_core.plan.volumes.opening import volume_of
from tests.loaded import load_scene

SHAPE = (33, 41, 35)
FIELD = np.random.default_rng(5).random(SHAPE)
TYPES = ["?", "i1", "u1", "<i2", ">u2", "<i4", ">u4", "<i8", ">u8", "<f2", ">f4", "<f8"]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A megabyte is the budget, and copies have a folder of their own."""
    monkeypatch.setenv("ISOGI_VOLUME_MB", "1")
    monkeypatch.setenv("ISOGI_VOLUME_CACHE", str(tmp_path / "copies"))
    return tmp_path / "copies"


def values(kind: str) -> np.ndarray:
    """A field of a type, with outliers and holes where the type has them."""
    dtype = np.dtype(kind)
    if dtype.kind == "f":
        field = (FIELD * 100.0).astype(dtype)
        field[3, 4, 5] = 3e4
        field[30, 2, 1] = np.nan
        field[10] = -99.0
        return field
    return (FIELD * (1 if kind == "?" else 100)).round().astype(dtype)


def grid_of(array: np.ndarray, layers: int, stamp: str = "a") -> Grid:
    """An array in slabs of so many layers."""
    parts = range(0, len(array), layers)
    return Grid(
        array.shape,
        array.dtype,
        (1.0, 2.0, 0.5),
        lambda: (array[z : z + layers] for z in parts),
        lambda: stamp,
    )


def same(one: Volume, other: Volume) -> None:
    """That two volumes are equal in every bit and every fact but the notes on their file."""
    one, other = (
        replace(each, orientation=replace(each.orientation, notes=())) for each in (one, other)
    )
    np.testing.assert_array_equal(one.voxels.view(np.uint32), other.voxels.view(np.uint32))
    names = [field.name for field in fields(Volume) if field.name != "voxels"]
    facts = [[getattr(each.counted(), name) for name in names] for each in (one, other)]
    assert facts[0] == facts[1]
    for ours, theirs in zip(one.histogram(), other.histogram(), strict=True):
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize(
    ("kind", "solid"), [*((kind, "above") for kind in TYPES), ("u1", "below"), (">f4", "below")]
)
def test_a_copy_is_the_volume_that_memory_would_hold(kind: str, solid: str) -> None:
    array = values(kind)
    if np.dtype(kind).kind == "f":
        missing = (-99.0,)
    else:
        missing = ()
    mapped = volume_of(grid_of(array, 9), solid, "v", missing, no_progress)
    same(mapped, make_volume(array, (1.0, 2.0, 0.5), solid, "v", missing))
    assert mapped.span == replace(mapped, span=()).core_span()
    assert len(mapped.counts) == len(mapped.histogram()[0])
    assert (
        mapped.voxels.flags.c_contiguous
        and mapped.voxels.flags.writeable
        and mapped.voxels.flags.aligned
    )
    assert type(mapped.voxels) is np.ndarray and not mapped.voxels.flags.owndata


@pytest.mark.parametrize("layers", [1, 5, 32, 33])
def test_slabs_of_any_height_make_the_same_volume(layers: int) -> None:
    array = values("<u2")
    same(
        volume_of(grid_of(array, layers), "above", "v", (), no_progress),
        make_volume(array, (1.0, 2.0, 0.5), name="v"),
    )


@pytest.mark.parametrize(
    ("suffix", "encoding"), [("nrrd", "raw"), ("nhdr", "gzip"), ("nrrd", "bzip2")]
)
def test_large_files_are_opened_as_copies(
    tmp_path: Path, suffix: str, encoding: str, folder: Path
) -> None:
    path = tmp_path / f"v.{suffix}"
    nrrd.write(str(path), values(">u2"), {"encoding": encoding, "endian": "big"}, index_order="C")
    mapped = load_scene(path).volume
    assert list(folder.glob("*.voxels"))
    same(mapped, make_volume(values(">u2"), name="v"))


def test_zarr_volumes_are_opened_with_the_settings_of_the_scene(
    tmp_path: Path, folder: Path
) -> None:
    field = np.stack([values("f4"), values("f4")[::-1]])
    saved = zarr.create_array(
        tmp_path / "v.zarr", shape=field.shape, dtype="f4", chunks=(1, 16, 32, 33)
    )
    saved[:] = field
    text = (
        'volume = "v.zarr"\nchannel = 1\nspacing = [1, 2, 3]\nmissing = -99\nsolid = '
        '"below"\nisovalues = [10, 20]\n'
    )
    (tmp_path / "s.toml").write_text(text)
    mapped = load_scene(tmp_path / "s.toml").volume
    same(mapped, make_volume(field[1], (1.0, 2.0, 3.0), "below", "v", (-99.0,)))
    assert len(list(folder.glob("*.voxels"))) == 2  # both names of one file
    with pytest.raises(SceneError, match=r"series = 1 chooses nothing in 'v.zarr'"):
        load_scene(tmp_path / "s.toml", series=1)
    whole = load_scene(f"{tmp_path / 'v.zarr'}#channel=0", isovalue=50).volume
    same(whole, make_volume(field[0], name="v"))
    nrrd.write(str(tmp_path / "plain.nrrd"), field[0], index_order="C")
    with pytest.raises(VolumeError, match="has no 'level' to choose"):
        load_scene(tmp_path / "plain.nrrd", level=1)


def test_an_array_in_a_zarr_folder_is_named_by_its_path(tmp_path: Path) -> None:
    zarr.open_group(tmp_path / "v.zarr", mode="w")
    zarr.create_array(tmp_path / "v.zarr" / "inner", shape=(4, 4, 4), chunks=(2, 2, 2), dtype="f4")[
        :
    ] = FIELD[:4, :4, :4]
    scene = load_scene(tmp_path / "v.zarr" / "inner")
    assert (scene.name, scene.volume.name, scene.volume.shape) == ("v-inner", "v-inner", (4, 4, 4))


def test_a_series_opens_at_its_first_step_with_a_note(tmp_path: Path) -> None:
    nib = pytest.importorskip("nibabel")
    field = np.random.default_rng(2).random((6, 7, 8, 3)).astype(np.float32)
    nib.save(nib.Nifti1Image(field, np.eye(4)), tmp_path / "bold.nii")
    scene = load_scene(tmp_path / "bold.nii")
    assert scene.volume.moment == (0, 3)
    assert any(
        "holds 3 steps in time: the first is shown" in note
        for note in scene.volume.orientation.notes
    )
    assert scene.volume.digest == load_scene(f"{tmp_path / 'bold.nii'}#time=0").volume.digest
    for chosen in (at_time(scene, 1, "later"), load_scene(f"{tmp_path / 'bold.nii'}#time=1")):
        assert chosen.volume.moment == (1, 3)
        assert not any("first" in note for note in chosen.volume.orientation.notes)


def test_a_mask_of_several_steps_has_one_chosen(tmp_path: Path) -> None:
    nib = pytest.importorskip("nibabel")
    nib.save(nib.Nifti1Image(np.ones((6, 7, 8, 2), np.uint8), np.eye(4)), tmp_path / "m.nii")
    nib.save(
        nib.Nifti1Image(np.random.default_rng(2).random((6, 7, 8)), np.eye(4)), tmp_path / "v.nii"
    )
    text = 'volume = "v.nii"\n[[volumes]]\nfile = "m.nii{}"\nuse = "mask"\n'
    (tmp_path / "s.toml").write_text(text.format(""))
    with pytest.raises(
        VolumeError, match=r"'m.nii' has 2 time steps: choose one, such as 'm.nii#time=0'"
    ):
        load_scene(tmp_path / "s.toml")
    (tmp_path / "s.toml").write_text(text.format("#time=1"))
    load_scene(tmp_path / "s.toml")


def opened(stamp: str = "a", array: np.ndarray = FIELD, **changes: Any) -> Volume:
    """The field as a volume."""
    return volume_of(replace(grid_of(array, 9, stamp), **changes), "above", "v", (), no_progress)


def never() -> Iterator[np.ndarray]:
    raise AssertionError("the source was read")


def test_a_copy_is_made_once_and_anew_where_the_source_changed() -> None:
    first = opened()
    same(first, opened(slabs=never))
    other = opened("b", FIELD[::-1])
    assert other.digest != first.digest
    same(first, opened(slabs=never))


def test_many_that_ask_at_once_have_it_made_once() -> None:
    made: list[int] = []

    def slabs() -> Iterator[np.ndarray]:
        made.append(1)
        time.sleep(0.05)
        yield FIELD

    with ThreadPoolExecutor(4) as threads:
        found = list(threads.map(lambda _: opened(slabs=slabs), range(4)))
    assert (
        len(made) == 2 and len({volume.digest for volume in found}) == 1
    )  # a copy takes two looks


def test_a_source_that_changes_meanwhile_makes_no_copy(folder: Path) -> None:
    stamps = iter("aabc")
    with pytest.raises(VolumeError, match="changed while it was read"):
        volume_of(
            replace(grid_of(FIELD, 9), stamp=lambda: next(stamps)), "above", "v", (), no_progress
        )
    assert [path.suffix for path in folder.iterdir()] == [".lock"]


def test_a_damaged_source_makes_no_copy(tmp_path: Path, folder: Path) -> None:
    path = tmp_path / "v.nrrd"
    nrrd.write(str(path), values("f4"), {"encoding": "raw"}, index_order="C")
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(VolumeError, match="holds fewer than"):
        load_scene(path)
    assert [each.suffix for each in folder.iterdir()] == [".lock"]


def cut(path: Path) -> None:
    os.truncate(path, path.stat().st_size - 1)


def spoil(path: Path) -> None:
    with path.open("r+b") as file:
        file.seek(200)
        file.write(b"\0")


@pytest.mark.parametrize(
    "damage", [cut, spoil, lambda path: path.write_bytes(b""), lambda path: path.unlink()]
)
def test_a_damaged_copy_is_made_again(damage: Any, folder: Path) -> None:
    first = opened().digest
    for path in folder.glob("*.voxels"):
        damage(path)
    again = opened()
    assert again.digest == first
    same(again, make_volume(FIELD, (1.0, 2.0, 0.5), name="v"))


def test_what_was_left_half_made_is_swept(folder: Path) -> None:
    folder.mkdir()
    (folder / "dead.partial").write_bytes(b"x" * 1000)
    opened()
    assert not list(folder.glob("*.partial"))


def test_copies_used_longest_ago_go_first(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ISOGI_VOLUME_CACHE_MB", "1")  # five copies, of 0.2 MB
    first, second, *_ = [opened(str(n), FIELD * (n + 1) + n) for n in range(5)]
    for place, digest in enumerate((second.digest, first.digest)):
        os.utime(folder / f"{digest}.voxels", (place, place))
    opened("5", 1 - FIELD)
    assert (folder / f"{first.digest}.voxels").exists() and not (
        folder / f"{second.digest}.voxels"
    ).exists()
    same(second, make_volume(FIELD * 2 + 1, (1.0, 2.0, 0.5), name="v"))  # who has it goes on


def test_a_full_disk_is_an_error(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = shutil.disk_usage(folder.parent)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=1000))
    with pytest.raises(VolumeError, match=r"takes 0\.0 GB in .*make room, or name another folder"):
        opened()


def test_a_folder_that_cannot_be_written_is_an_error(folder: Path) -> None:
    folder.write_text("no folder")
    with pytest.raises(VolumeError, match="cannot be kept in"):
        opened()


@pytest.mark.parametrize(
    ("name", "told"), [("ISOGI_VOLUME_MB", "-5"), ("ISOGI_VOLUME_CACHE_MB", "lots")]
)
def test_settings_that_are_no_numbers_are_errors(
    name: str, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(name, told)
    with pytest.raises(VolumeError, match=f"{name} is '{told}'"):
        opened()


def test_progress_goes_from_the_first_to_the_last_layer() -> None:
    told: list[tuple[int, int]] = []
    volume_of(grid_of(FIELD, 9), "above", "v", (), lambda done, total: told.append((done, total)))
    assert told == [(n + 1, 3 * len(FIELD)) for n in range(2 * len(FIELD))] + [
        (3 * len(FIELD), 3 * len(FIELD))
    ]


def test_a_copy_tells_its_facts_in_its_header(folder: Path) -> None:
    volume = opened()
    head = json.loads((folder / f"{volume.digest}.voxels").read_bytes()[:16384])
    assert json.loads(head["body"])["facts"]["digest"] == volume.digest
