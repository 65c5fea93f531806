"""Regions of volumes and levels of images: what is shown is where it was, and no more is read than
it takes.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import nrrd
import numpy as np
import pytest
import zarr

from isogi_core.errors import SceneError, VolumeError
from isogi_core.files import zarr_volume
from isogi_core.files.grid import Grid
from isogi_core.files.ome import write_image
from isogi_core.files.zarr_volume import open_zarr
from isogi_core.model.volume import Volume
from isogi_core.plan.scene import Scene
from tests.loaded import load_scene

FIELD = np.random.default_rng(8).integers(0, 200, (20, 18, 16)).astype(np.uint8)
REGION = [[3, 12], [5, 17], [2, 19]]
PART = FIELD[2:19, 5:17, 3:12]
AXES = [{"name": name, "type": "space", "unit": "micrometer"} for name in "zyx"]


def image(path: Path, arrays: list[np.ndarray], names: str = "zyx", chunk: int = 4) -> Path:
    """An image of these levels, each half as fine as the one before, of voxels of 2 × 3 × 4 µm at
    the finest.
    """
    group = zarr.open_group(path, mode="w")
    datasets = []
    order = ["zyx".index(name) for name in names]
    steps = np.array([4.0, 3.0, 2.0])
    for level, array in enumerate(arrays):
        turned = array.transpose(order)
        zarr.create_array(
            path / str(level), shape=turned.shape, dtype=turned.dtype, chunks=(chunk,) * 3
        )[:] = turned
        scale = steps[order] * 2**level
        shift = steps[order] * (2**level - 1) / 2
        placed: list[Any] = [{"type": "scale", "scale": scale.tolist()}]
        placed.append({"type": "translation", "translation": shift.tolist()})
        datasets.append({"path": str(level), "coordinateTransformations": placed})
    axes: Any = [AXES[n] for n in order]
    group.attrs["ome"] = {"version": "0.5", "multiscales": [{"axes": axes, "datasets": datasets}]}
    return path


def zyx(folder: Path) -> Path:
    return image(folder / "v.zarr", [FIELD])


def xzy(folder: Path) -> Path:
    return image(folder / "v.zarr", [FIELD], "xzy")


def placed_nrrd(folder: Path) -> Path:
    header = {
        "space": "RAS",
        "space directions": np.diag([2.0, 3.0, 4.0]),
        "space origin": np.zeros(3),
    }
    nrrd.write(str(folder / "v.nrrd"), FIELD, header, index_order="C")
    return folder / "v.nrrd"


def spaced_nrrd(folder: Path) -> Path:
    nrrd.write(str(folder / "v.nrrd"), FIELD, {"spacings": [2.0, 3.0, 4.0]}, index_order="C")
    return folder / "v.nrrd"


def scene_of(path: Path, **settings: Any) -> Scene:
    (path.parent / "s.toml").write_text(f'volume = "{path.name}"\n')
    return load_scene(path.parent / "s.toml", **settings)


WRITERS: list[Callable[[Path], Path]] = [zyx, xzy, placed_nrrd, spaced_nrrd]


@pytest.mark.parametrize("write", WRITERS)
@pytest.mark.parametrize("axes", ["world", "raw"])
def test_a_region_is_shown_where_it_lies_in_the_whole(
    tmp_path: Path, write: Any, axes: str
) -> None:
    path = write(tmp_path)
    whole, part = (scene_of(path, axes=axes, **more).volume for more in ({}, {"region": REGION}))
    values = part.offset + part.scale * part.voxels
    np.testing.assert_array_equal(values, PART)
    for place in ((3, 5, 2), (11, 16, 18), (4, 9, 7)):
        there = whole.orientation.to_world(np.array(place) * whole.spacing)
        box = np.array(part.orientation.point_to_box(tuple(there))) / part.spacing
        np.testing.assert_allclose(box, np.array(place) - (3, 5, 2), atol=1e-6)
    assert "voxels x 3 to 11, y 5 to 16, z 2 to 18 of 16 × 18 × 20" in part.orientation.notes[-1]
    assert not any("region" in note for note in whole.orientation.notes)


def test_of_an_image_of_too_many_chunks_a_region_is_shown(tmp_path: Path) -> None:
    zarr.create_array(tmp_path / "v.zarr", shape=(1000,) * 3, chunks=(1, 1, 1), dtype="u1")
    with pytest.raises(VolumeError, match="are too many"):
        open_zarr(tmp_path / "v.zarr")
    with pytest.raises(VolumeError, match="are too many"):
        open_zarr(tmp_path / "v.zarr", region=((0, 200), (0, 200), (0, 200)))
    assert open_zarr(tmp_path / "v.zarr", region=((5, 9), (5, 8), (5, 7))).whole().shape == (
        2,
        3,
        4,
    )


@pytest.mark.parametrize("write", [zyx, xzy])
def test_of_a_region_its_own_chunks_alone_are_read(tmp_path: Path, write: Any) -> None:
    """All others are damaged."""
    path = write(tmp_path)
    region = ((4, 12), (5, 16), (8, 15))
    spans = {
        name: range(low // 4, (high - 1) // 4 + 1)
        for name, (low, high) in zip("xyz", region, strict=True)
    }
    names = "zyx" if write is zyx else "xzy"
    spoiled = 0
    for chunk in (path / "0" / "c").rglob("*"):
        place = chunk.relative_to(path / "0" / "c").parts
        if chunk.is_file() and not all(
            int(n) in spans[name] for n, name in zip(place, names, strict=True)
        ):
            chunk.write_bytes(b"no chunk")
            spoiled += 1
    assert spoiled > 60
    np.testing.assert_array_equal(open_zarr(path, region=region).whole(), FIELD[8:15, 5:16, 4:12])
    with pytest.raises(VolumeError, match="are damaged"):
        open_zarr(path).whole()


def test_regions_have_light_and_copies_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ISOGI_VOLUME_MB", "1")
    monkeypatch.setenv("ISOGI_VOLUME_CACHE", str(tmp_path / "copies"))
    big = np.random.default_rng(3).random((40, 40, 60)).astype(np.float32)
    np.save(tmp_path / "v.npy", big)
    found = []
    for low in (0, 5, 0):
        volume = scene_of(tmp_path / "v.npy", region=[[low, low + 50], [0, 40], [0, 40]]).volume
        np.testing.assert_allclose(
            volume.offset + volume.scale * volume.voxels, big[..., low : low + 50], rtol=1e-6
        )
        found.append(volume.digest)
    assert found[0] == found[2] != found[1]


@pytest.mark.parametrize(
    ("region", "words"),
    [
        ([[3, 17], [5, 17], [2, 19]], r"has \[3, 17\] along x: give first and end of 0 to 16"),
        ([[3, 4], [5, 17], [2, 19]], "at least two voxels"),
        ([[3, 12], [5, 17]], "a list of 3 pairs"),
        ([[3, 12], [5, 17], [2.5, 19]], "whole numbers"),
        ([[3, 12], [5, 17], [-2, 19]], "from 0 on"),
        ([[12, 3], [5, 17], [2, 19]], "ascending"),
        ("all", "a list of 3 pairs"),
    ],
)
@pytest.mark.parametrize("write", [zyx, spaced_nrrd])
def test_regions_that_are_not_there_are_refused(
    tmp_path: Path, write: Any, region: Any, words: str
) -> None:
    with pytest.raises((SceneError, VolumeError), match=words):
        scene_of(write(tmp_path), region=region)


def pyramid(folder: Path) -> Path:
    halves = FIELD[:, :, :].reshape(10, 2, 9, 2, 8, 2).mean(axis=(1, 3, 5)).astype(np.uint8)
    return image(folder / "v.zarr", [FIELD, halves, halves[::2, ::2, ::2]])


def test_an_image_opens_at_the_level_that_memory_has_room_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = pyramid(tmp_path)
    assert scene_of(path).volume.shape == FIELD.shape
    monkeypatch.setattr(zarr_volume, "budget", lambda: 4 * FIELD.size - 1)
    scene = scene_of(path)
    assert (scene.volume.shape, scene.volume.spacing) == ((10, 9, 8), (4.0, 6.0, 8.0))
    note = scene.volume.orientation.notes[-1]
    assert "Level 1 of 0 to 2 is shown" in note and "level = 0 in the scene" in note
    np.testing.assert_allclose(scene.volume.orientation.origin, (1.0, 1.5, 2.0))
    assert scene_of(path, level=0, region=REGION).volume.shape == PART.shape
    assert scene_of(path, region=REGION).volume.shape == PART.shape
    assert scene_of(path, level=0).volume.shape == FIELD.shape
    monkeypatch.setattr(zarr_volume, "budget", lambda: 4)
    assert scene_of(path).volume.shape == (5, 5, 4)


def test_what_cannot_be_shown_at_any_level_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = pyramid(tmp_path)
    monkeypatch.setattr(zarr_volume, "budget", lambda: 4)
    monkeypatch.setattr(zarr_volume, "MAX_VOXELS", 10)
    for settings in ({}, {"level": 0}):
        with pytest.raises(VolumeError, match="choose a coarser level, or a region"):
            scene_of(path, **settings)


def test_no_level_is_finer_than_a_picture_of_it_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = pyramid(tmp_path)
    for most, shape in ((11, FIELD.shape), (10, (10, 9, 8)), (5, (5, 5, 4)), (1, (5, 5, 4))):
        monkeypatch.setattr(zarr_volume, "MAX_PICTURE_VOXELS", most)
        assert open_zarr(path).shape == shape


def test_a_level_without_a_translation_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = pyramid(tmp_path)
    monkeypatch.setattr(zarr_volume, "budget", lambda: 4 * FIELD.size - 1)
    assert not any("no translation" in note for note in open_zarr(path).notes)
    told = zarr.open_group(path).attrs.asdict()["ome"]
    for each in told["multiscales"][0]["datasets"]:
        del each["coordinateTransformations"][1]
    zarr.open_group(path).attrs["ome"] = told
    assert any("up to half a voxel off" in note for note in open_zarr(path).notes)
    assert not any("no translation" in note for note in open_zarr(path, level=0).notes)


def halved(field: np.ndarray) -> np.ndarray:
    nz, ny, nx = (n // 2 for n in field.shape)
    return field.reshape(nz, 2, ny, 2, nx, 2).mean(axis=(1, 3, 5)).astype(np.float32)


def by_others(field: np.ndarray, path: Path) -> None:
    image(path, [field, halved(field), halved(halved(field))], "xzy", chunk=32)


def by_isogi(field: np.ndarray, path: Path) -> None:
    write_image(Grid.of(field, (2.0, 3.0, 4.0)), path, lambda *_: None)


def crossings(volume: Volume, isovalue: float) -> np.ndarray:
    """Where edges between voxels cross an isosurface, in the world, (n, 3)."""
    values = volume.offset + volume.scale * volume.voxels.astype(float) - isovalue
    found = []
    for axis in range(3):
        low, high = (np.take(values, np.arange(values.shape[axis] - 1) + n, axis) for n in (0, 1))
        places = np.argwhere((low < 0.0) != (high < 0.0)).astype(float)
        between = tuple(places.T.astype(int))
        places[:, axis] += low[between] / (low[between] - high[between])
        found.append(places[:, ::-1] * volume.spacing)
    return volume.orientation.to_world(np.concatenate(found))


@pytest.mark.parametrize("write", [by_others, by_isogi])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_levels_have_their_surfaces_at_the_same_places(
    tmp_path: Path, write: Any, axis: int
) -> None:
    """A plane stands across x, y or z of 272 × 240 × 144 µm: means of voxels keep it, and where it
    lies shows.
    """
    depth, rows, columns = (
        np.indices((36, 80, 136)) * np.array([4.0, 3.0, 2.0])[:, None, None, None]
    )
    write((columns, rows, depth)[axis].astype(np.float32), tmp_path / "v.zarr")
    for level in (0, 1, 2):
        volume = scene_of(tmp_path / "v.zarr", level=level).volume
        points = crossings(volume, 71.3)
        assert len(points) > 300 / 4**level
        assert np.abs(points[:, axis] - 71.3).max() < 0.1 * (2.0, 3.0, 4.0)[axis]


def test_channels_and_times_do_not_count_as_voxels(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fields = np.stack([FIELD, FIELD, FIELD])
    zarr.create_array(tmp_path / "v.zarr", shape=fields.shape, dtype="u1", chunks=(1, 8, 8, 8))[
        :
    ] = fields
    monkeypatch.setattr(zarr_volume, "MAX_VOXELS", FIELD.size)
    assert open_zarr(tmp_path / "v.zarr", channel=1).shape == FIELD.shape
