"""Zarr volumes: both formats, images with their resolutions, units and axes, and what is
refused.
"""

import threading
from collections.abc import Callable
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr

from isogi_core.errors import VolumeError
from isogi_core.files.grid import Grid
from isogi_core.files.zarr_volume import open_zarr
from isogi_core.model.volume import make_volume
from isogi_core.plan.assembly import load_scene
from tests.s3 import S3Server

FIELD = np.arange(7 * 5 * 6).reshape(7, 5, 6)
TYPES = ["?", "i1", "u1", "<i2", ">u2", "<i4", ">u4", "<i8", ">u8", "<f2", ">f4", "<f8"]
SPACE = [{"name": name, "type": "space", "unit": "micrometer"} for name in "zyx"]


def save(path: Path, array: np.ndarray, form: Any = 3, chunks: Any = None, **more: Any) -> Any:
    """An array of these values, in chunks that do not divide it."""
    chunks = chunks or tuple(min(4, n) for n in array.shape)
    made = zarr.create_array(
        path, shape=array.shape, dtype=array.dtype, chunks=chunks, zarr_format=form, **more
    )
    made[:] = array
    return made


def image(
    path: Path, arrays: list[np.ndarray], axes: list[Any], form: Any = 3, **more: Any
) -> None:
    """An OME-Zarr image of these resolutions, each half as fine as the one before."""
    group = zarr.open_group(path, mode="w", zarr_format=form)
    for level, array in enumerate(arrays):
        save(path / str(level), array, form)
    steps = [
        [1.0] * (array.ndim - 3) + [2.0**n * step for step in (2.0, 1.0, 0.5)]
        for n, array in enumerate(arrays)
    ]
    datasets = [
        {"path": str(n), "coordinateTransformations": [{"type": "scale", "scale": step}]}
        for n, step in enumerate(steps)
    ]
    told = {"multiscales": [{"axes": axes, "datasets": datasets, **more}]}
    group.attrs.update({"ome": {"version": "0.5", **told}} if form == 3 else told)


def check(grid: Grid, values: np.ndarray) -> None:
    """That a grid holds these values, twice in a row."""
    for _ in range(2):
        slabs = list(grid.slabs())
        assert sum(map(len, slabs)) == len(values)
        np.testing.assert_array_equal(np.concatenate(slabs), values)
    assert grid.shape == values.shape


@pytest.mark.parametrize("form", [2, 3])
@pytest.mark.parametrize("kind", TYPES)
def test_bare_arrays_of_all_types(tmp_path: Path, kind: str, form: int) -> None:
    values = (FIELD % 251).astype(kind)
    save(tmp_path / "v.zarr", values, form)
    grid = open_zarr(tmp_path / "v.zarr")
    check(grid, values)
    assert grid.dtype == values.dtype or grid.dtype.newbyteorder("=") == values.dtype.newbyteorder(
        "="
    )
    assert tuple(grid.spacing) == (1.0, 1.0, 1.0)


@pytest.mark.parametrize("chunks", [(1, 5, 6), (7, 1, 1), (3, 2, 5), (100, 100, 100)])
def test_slabs_follow_the_chunks_and_hold_all(
    tmp_path: Path, chunks: tuple[int, ...], monkeypatch: Any
) -> None:
    monkeypatch.setattr("isogi_core.files.grid.SLAB_BYTES", 1)
    save(tmp_path / "v.zarr", FIELD, chunks=chunks)
    grid = open_zarr(tmp_path / "v.zarr")
    check(grid, FIELD)
    assert len(next(grid.slabs())) == min(chunks[0], 7)


def test_a_layer_of_chunks_too_large_for_memory_is_read_in_parts(
    tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.setattr("isogi_core.files.grid.SLAB_BYTES", 1)
    monkeypatch.setattr("isogi_core.files.zarr_volume.MAX_LAYER_BYTES", 1000)
    save(tmp_path / "v.zarr", FIELD, chunks=(7, 5, 6))
    grid = open_zarr(tmp_path / "v.zarr")
    check(grid, FIELD)
    assert len(next(grid.slabs())) == 1


def test_shards_are_read(tmp_path: Path) -> None:
    values = np.arange(8 * 8 * 8).reshape(8, 8, 8)
    save(tmp_path / "v.zarr", values, chunks=(2, 4, 4), shards=(8, 8, 8))
    check(open_zarr(tmp_path / "v.zarr"), values)


@pytest.mark.parametrize("form", [2, 3])
def test_chunks_that_are_missing_hold_the_fill_value(tmp_path: Path, form: Any) -> None:
    made = zarr.create_array(
        tmp_path / "v.zarr",
        shape=(4, 4, 4),
        chunks=(2, 4, 4),
        dtype="f4",
        fill_value=np.nan,
        zarr_format=form,
    )
    made[:2] = 3.0
    grid = open_zarr(tmp_path / "v.zarr").whole()
    assert (grid[:2] == 3.0).all() and np.isnan(grid[2:]).all()


@pytest.mark.parametrize("form", [2, 3])
def test_images_are_read_at_their_finest_or_at_a_level(tmp_path: Path, form: Any) -> None:
    path = tmp_path / "v.zarr"
    image(path, [FIELD, FIELD[::2, ::2, ::2]], SPACE, form)
    finest = open_zarr(path)
    coarse = open_zarr(path, level=1)
    named = open_zarr(path / "1")
    check(finest, FIELD)
    assert tuple(finest.spacing) == (0.5, 1.0, 2.0)
    for grid in (coarse, named):
        check(grid, FIELD[::2, ::2, ::2])
        assert tuple(grid.spacing) == (1.0, 2.0, 4.0)


def test_scales_of_the_whole_image_and_units_count(tmp_path: Path) -> None:
    axes = [dict(SPACE[0], unit="millimeter"), SPACE[1], dict(SPACE[2], unit="micrometre")]
    whole = [
        {"type": "scale", "scale": [3.0, 3.0, 3.0]},
        {"type": "translation", "translation": [9.0, 9.0, 9.0]},
    ]
    image(tmp_path / "v.zarr", [FIELD], axes, coordinateTransformations=whole)
    np.testing.assert_allclose(open_zarr(tmp_path / "v.zarr").spacing, (1.5, 3.0, 6000.0))


def test_one_channel_and_time_are_chosen(tmp_path: Path) -> None:
    axes = [{"name": "t", "type": "time"}, {"name": "c", "type": "channel"}, *SPACE]
    values = np.arange(2 * 3 * 7 * 5 * 6).reshape(2, 3, 7, 5, 6)
    image(tmp_path / "v.zarr", [values], axes)
    check(open_zarr(tmp_path / "v.zarr", channel=2, time=1), values[1, 2])
    first = open_zarr(tmp_path / "v.zarr", channel=0)
    check(first, values[0, 0])
    assert (first.moment, first.unchosen) == ((0, 2), True)
    assert not open_zarr(tmp_path / "v.zarr", channel=0, time=0).unchosen
    with pytest.raises(
        VolumeError,
        match=r"has 3 elements along its axis 'c': set channel in the scene, from 0 to 2",
    ):
        open_zarr(tmp_path / "v.zarr", time=0)
    with pytest.raises(VolumeError, match=r"channel = 3 is not in .*, which has 0 to 2"):
        open_zarr(tmp_path / "v.zarr", channel=3, time=0)


def test_axes_of_one_element_need_no_choice(tmp_path: Path) -> None:
    save(tmp_path / "v.zarr", FIELD[None, None])
    check(open_zarr(tmp_path / "v.zarr"), FIELD)


def test_dimensions_may_have_names_of_their_own(tmp_path: Path) -> None:
    save(tmp_path / "v.zarr", FIELD, dimension_names=["depth", "lat", "lon"])
    check(open_zarr(tmp_path / "v.zarr"), FIELD)
    save(tmp_path / "c.zarr", FIELD[:, None], dimension_names=["z", "c", "y", "x"])
    check(open_zarr(tmp_path / "c.zarr"), FIELD)


def test_an_array_whose_first_dimension_is_time_is_a_series(tmp_path: Path) -> None:
    save(
        tmp_path / "v.zarr",
        np.stack([FIELD, FIELD + 1]),
        dimension_names=["time", "depth", "lat", "lon"],
    )
    first = open_zarr(tmp_path / "v.zarr")
    check(first, FIELD)
    assert (first.moment, first.unchosen) == ((0, 2), True)
    check(open_zarr(tmp_path / "v.zarr", time=1), FIELD + 1)


def test_the_stamp_tells_when_anything_was_written(tmp_path: Path) -> None:
    made = save(tmp_path / "v.zarr", FIELD)
    grid = open_zarr(tmp_path / "v.zarr")
    before = grid.stamp()
    assert grid.stamp() == before
    made[0, 0, 0] = 77
    assert grid.stamp() != before


def flat_group(path: Path) -> None:
    group = zarr.open_group(path, mode="w")
    for name in "ab":
        group.create_array(name, data=FIELD[0])


def bad_group(path: Path) -> None:
    save(path / "inner", FIELD)
    save(path / "other", FIELD)
    zarr.open_group(path, mode="a")


def bad_link(path: Path) -> None:
    save(path, FIELD)
    (path.parent / "secret").write_bytes(b"x")
    (path / "c" / "9").symlink_to(path.parent / "secret")


def bad_chunk(path: Path) -> None:
    save(path, FIELD)
    next(each for each in sorted((path / "c").rglob("*")) if each.is_file()).write_bytes(
        b"no chunk"
    )


def bad_codec(path: Path) -> None:
    save(path, FIELD)
    told = (path / "zarr.json").read_text()
    (path / "zarr.json").write_text(told.replace('"zstd"', '"nobodys"'))


def bad_metadata(path: Path) -> None:
    path.mkdir()
    (path / "zarr.json").write_text("{")


def no_axes_match(path: Path) -> None:
    image(path, [FIELD], [SPACE[0], SPACE[1]])


def other_names(path: Path) -> None:
    image(path, [FIELD[:1]], [dict(SPACE[0], name="depth"), *SPACE[1:]])


def large_chunks(path: Path) -> None:
    zarr.create_array(path, shape=(2048, 1024, 1024), chunks=(2048, 1024, 1024), dtype="f4")


def huge(path: Path) -> None:
    zarr.create_array(path, shape=(1 << 20, 1 << 20, 1 << 20), chunks=(8, 8, 8), dtype="u1")


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda path: None, "There is no Zarr array"),
        (lambda path: path.mkdir(), "holds no Zarr array"),
        (bad_group, r"holds several fields: choose of '.*v.zarr/inner', '.*v.zarr/other'"),
        (flat_group, r"is a Zarr group and no image: it holds 'v.zarr/a', 'v.zarr/b'; give an"),
        (bad_link, "is a link out of the volume's folder"),
        (bad_chunk, "are damaged"),
        (bad_codec, "cannot be read as Zarr .*nobodys"),
        (bad_metadata, "cannot be read as Zarr"),
        (no_axes_match, "a scale of 3 numbers for 2 axes"),
        (other_names, "they must be z, y and x"),
        (large_chunks, "write it in chunks of 1 GiB or less"),
        (huge, "claims a shape"),
        (lambda path: save(path, FIELD[0]), "has 2 dimensions and 0 axes"),
        (lambda path: save(path, FIELD[:, None, None, None]), "has 6 dimensions and 0 axes"),
        (lambda path: image(path, [FIELD], SPACE, datasets=[{"path": "5"}]), "has no array '5'"),
        (lambda path: image(path, [FIELD], SPACE, datasets=[{}]), "OME metadata .* is damaged"),
    ],
)
def test_unreadable_files_are_errors(
    tmp_path: Path, make: Callable[[Path], object], told: str
) -> None:
    make(tmp_path / "v.zarr")
    with pytest.raises(VolumeError, match=told):
        open_zarr(tmp_path / "v.zarr").whole()


def test_missing_levels_are_an_error(tmp_path: Path) -> None:
    image(tmp_path / "v.zarr", [FIELD], SPACE)
    with pytest.raises(VolumeError, match=r"level = 3 of .* is not there: it has levels 0 to 0"):
        open_zarr(tmp_path / "v.zarr", level=3)
    with pytest.raises(VolumeError, match="leave out 'level'"):
        open_zarr(tmp_path / "v.zarr" / "0", level=0)


@pytest.fixture
def bucket(s3: S3Server, tmp_path: Path) -> str:
    """The URL of an image with two resolutions."""
    image(tmp_path / "v.zarr", [FIELD, FIELD[::2, ::2, ::2]], SPACE)
    for path in (tmp_path / "v.zarr").rglob("*"):
        if path.is_file():
            s3.objects[f"{s3.prefix}/v.zarr/{path.relative_to(tmp_path / 'v.zarr')}"] = (
                path.read_bytes()
            )
    return f"{s3.url}/v.zarr"


def test_images_are_read_from_urls(bucket: str, s3: S3Server) -> None:
    for grid, values in (
        (open_zarr(bucket), FIELD),
        (open_zarr(f"{bucket}/1"), FIELD[::2, ::2, ::2]),
    ):
        check(grid, values)
    assert tuple(open_zarr(f"{bucket}/1").spacing) == (1.0, 2.0, 4.0)
    with pytest.raises(VolumeError, match="has no array '7'"):
        open_zarr(f"{bucket}/7")
    grid = open_zarr(bucket)
    before = grid.stamp()
    assert grid.stamp() == before
    s3.objects[f"{s3.prefix}/v.zarr/0/c/0/0/0"] = b"other"
    assert grid.stamp() != before
    with pytest.raises(VolumeError, match="are damaged"):
        grid.whole()


def test_images_are_read_over_plain_http(tmp_path: Path) -> None:
    """A server that lists nothing: its metadata tell whether it changed."""
    image(tmp_path / "v.zarr", [FIELD], SPACE)
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Silent, directory=tmp_path)) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        grid = open_zarr(f"http://127.0.0.1:{server.server_port}/v.zarr")
        check(grid, FIELD)
        assert tuple(grid.spacing) == (0.5, 1.0, 2.0) and grid.stamp() == grid.stamp()
        server.shutdown()


class Silent(SimpleHTTPRequestHandler):
    """Files of a folder, without a log."""

    def log_message(self, *_: Any) -> None: ...


def test_scenes_and_the_command_line_name_urls(bucket: str, tmp_path: Path) -> None:
    scene = load_scene(bucket)
    assert (scene.name, scene.volume.name) == ("v", "v")
    np.testing.assert_array_equal(scene.volume.voxels, make_volume(FIELD).voxels)
    (tmp_path / "s.toml").write_text(f'volume = "{bucket}"\nlevel = 1\n')
    assert load_scene(tmp_path / "s.toml").volume.size == (3, 3, 4)


@pytest.mark.parametrize(
    "url",
    [
        "s3://user:word@isogi/v.zarr",
        "s3://isogi/v.zarr?key=1",
        "file:///v.zarr",
        "github://a/v.zarr",
    ],
)
def test_urls_that_hold_secrets_or_lead_elsewhere_are_refused(url: str) -> None:
    with pytest.raises(VolumeError, match="must begin with s3://"):
        open_zarr(url)


def xarray_group(path: Path, metres: dict[str, str], dims: str = "tzyx") -> np.ndarray:
    """A group as Xarray writes it: a field in time with coordinates next to it, and one of maps."""
    field = np.arange(2 * 4 * 5 * 6, dtype=np.float32).reshape(2, 4, 5, 6)
    group = zarr.open_group(path, mode="w", zarr_format=2)
    names = {"t": "time", "z": "lev", "y": "lat", "x": "lon"}
    values = {"t": [0.0, 1], "z": [9.0, 6, 3, 0], "y": -2.0 * np.arange(5), "x": np.arange(6.0)}
    kinds = {"t": {"units": "days since 2000-01-01"}, "z": {"positive": "down", **metres}}
    for axis in "tzyx":
        made = group.create_array(names[axis], data=np.array(values[axis]))
        made.attrs.update({"_ARRAY_DIMENSIONS": [names[axis]], **kinds.get(axis, metres)})
    data = field.transpose(["tzyx".index(axis) for axis in dims])
    made = group.create_array("ta", data=data)
    made.attrs["_ARRAY_DIMENSIONS"] = [names[axis] for axis in dims]
    maps = group.create_array("ps", data=field[:, 0])
    maps.attrs["_ARRAY_DIMENSIONS"] = ["time", "lat", "lon"]
    return field


@pytest.mark.parametrize("dims", ["tzyx", "xyzt"])
@pytest.mark.parametrize("inside", ["", "ta"])
def test_coordinates_next_to_an_array_place_it(tmp_path: Path, dims: str, inside: str) -> None:
    field = xarray_group(tmp_path / "v.zarr", {"units": "m"}, dims)
    grid = open_zarr(tmp_path / "v.zarr" / inside)
    np.testing.assert_array_equal(grid.whole(), field[0])
    assert tuple(grid.spacing) == (1.0, 2.0, 3.0) and grid.unit == "m"
    assert grid.affine is not None
    np.testing.assert_array_equal(np.diag(grid.affine.array[:, :3]), (1.0, -2.0, 3.0))
    assert grid.unchosen and grid.read_as.endswith("placed by the coordinates of its axes")
    assert inside or "only field of the group is shown: 'ta'" in grid.notes[0]


def test_coordinates_that_are_no_lengths_are_told(tmp_path: Path) -> None:
    xarray_group(tmp_path / "v.zarr", {"units": "m"})
    group = zarr.open_group(tmp_path / "v.zarr", mode="r+")
    group["lat"].attrs["units"] = "degrees_north"
    group["lon"].attrs["units"] = "degrees_east"
    grid = open_zarr(tmp_path / "v.zarr" / "ta")
    assert tuple(grid.spacing) == (1.0, 1.0, 1.0) and grid.affine is not None
    np.testing.assert_array_equal(np.diag(grid.affine.array[:, :3]), (1.0, -1.0, 1.0))
    assert "cubes, as its axes are in degrees_east, degrees_north, m: #spacing=" in grid.notes[0]


def test_coordinates_of_another_number_are_left_out(tmp_path: Path) -> None:
    xarray_group(tmp_path / "v.zarr", {"units": "m"})
    group = zarr.open_group(tmp_path / "v.zarr", mode="r+")
    del group["lev"]
    group.create_array("lev", data=np.arange(5.0)).attrs["positive"] = "down"
    grid = open_zarr(tmp_path / "v.zarr" / "ta")
    assert grid.notes[0] == "'lev' has 5 coordinates for 4 voxels: they are left out."
    assert "cubes, as the file gives no coordinates along z" in grid.notes[1]


def test_maps_in_time_of_xarray_are_layers(tmp_path: Path) -> None:
    field = xarray_group(tmp_path / "v.zarr", {"units": "m"})
    grid = open_zarr(tmp_path / "v.zarr" / "ps")
    np.testing.assert_array_equal(grid.whole(), field[:, 0])
    assert "Its planes are steps in time: they are shown as layers." in grid.notes


def test_fields_of_a_group_are_named(tmp_path: Path) -> None:
    field = xarray_group(tmp_path / "v.zarr", {"units": "m"})
    group = zarr.open_group(tmp_path / "v.zarr", mode="r+")
    more = group.create_array("ua", data=field)
    more.attrs["_ARRAY_DIMENSIONS"] = ["time", "lev", "lat", "lon"]
    with pytest.raises(VolumeError, match=r"several fields: choose of '.*/ps', '.*/ta', '.*/ua'"):
        open_zarr(tmp_path / "v.zarr")


def test_units_that_are_unknown_are_told(tmp_path: Path) -> None:
    axes = [{"name": name, "type": "space", "unit": "micrometer"} for name in "zyx"]
    axes[0]["unit"] = "pixel"
    image(tmp_path / "v.zarr", [FIELD], axes)
    grid = open_zarr(tmp_path / "v.zarr")
    assert "in micrometer, micrometer, pixel, taken as one unit: #spacing=" in grid.notes[0]
