"""OME-Zarr as others write it and as isogi does: what is read back is what was there, where it
was.
"""

from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr

from isogi_core.errors import VolumeError
from isogi_core.files.grid import Affine, Grid, LabelName, on_right_angles
from isogi_core.files.ome import halved, write_image
from isogi_core.files.zarr_volume import open_zarr
from isogi_core.model.value_survey import no_progress
from isogi_core.model.volume import Orientation
from tests.files.formats.phantom import WAYS, landmarks, letter, lying, world
from tests.loaded import load_scene

FIELD = np.arange(7 * 5 * 6).reshape(7, 5, 6)


def axis(name: str, unit: str = "micrometer") -> dict[str, str]:
    """An axis of space."""
    return {"name": name, "type": "space", "unit": unit}


def image(
    path: Path, array: np.ndarray, axes: list[Any], *steps: Any, version: str = "0.5", **more: Any
) -> Path:
    """An image of one array, at level 0, placed by these steps."""
    group = zarr.open_group(path, mode="w")
    saved = zarr.create_array(
        path / "0",
        shape=array.shape,
        dtype=array.dtype,
        chunks=tuple(min(4, n) for n in array.shape),
    )
    saved[:] = array
    dataset = {"path": "0", "coordinateTransformations": list(steps)}
    if version >= "0.6":
        for step in steps[:1]:
            step.update(input="0", output="world")
        multiscales = [
            {"coordinateSystems": [{"name": "world", "axes": axes}], "datasets": [dataset]}
        ]
    else:
        multiscales = [{"axes": axes, "datasets": [dataset]}]
    group.attrs.update({"ome": {"version": version, "multiscales": multiscales, **more}})
    return path


def scale(*steps: float) -> dict[str, Any]:
    return {"type": "scale", "scale": list(steps)}


def translation(*steps: float) -> dict[str, Any]:
    return {"type": "translation", "translation": list(steps)}


@pytest.mark.parametrize("names", ["".join(each) for each in permutations("xyz")])
@pytest.mark.parametrize("version", ["0.5", "0.6"])
def test_axes_of_space_may_have_any_order(tmp_path: Path, names: str, version: str) -> None:
    turned = FIELD.transpose([("zyx").index(name) for name in names])
    steps = [{"z": 2.0, "y": 1.5, "x": 0.5}[name] for name in names]
    path = image(
        tmp_path / "v.zarr", turned, [axis(name) for name in names], scale(*steps), version=version
    )
    grid = open_zarr(path)
    for _ in range(2):
        np.testing.assert_array_equal(grid.whole(), FIELD)
    assert (tuple(grid.spacing), grid.unit, grid.affine) == ((0.5, 1.5, 2.0), "µm", None)


def test_a_channel_may_stand_anywhere(tmp_path: Path) -> None:
    fields = np.stack([FIELD, FIELD + 1], axis=-1).transpose(2, 1, 0, 3)
    axes = [axis("x"), axis("y"), axis("z"), {"name": "c", "type": "channel"}]
    path = image(tmp_path / "v.zarr", fields, axes, scale(1, 1, 1, 1))
    np.testing.assert_array_equal(open_zarr(path, channel=1).whole(), FIELD + 1)


def test_a_translation_says_where_the_first_voxel_lies(tmp_path: Path) -> None:
    axes = [axis("z", "millimeter"), axis("y"), axis("x", "micrometre")]
    grid = open_zarr(
        image(tmp_path / "v.zarr", FIELD, axes, scale(2, 1.5, 0.5), translation(3, 20, 10))
    )
    assert grid.affine is not None and grid.unit == "µm"
    np.testing.assert_allclose(grid.affine.origin, (10.0, 20.0, 3000.0))
    np.testing.assert_allclose(grid.spacing, (0.5, 1.5, 2000.0))


def placed(path: Path) -> np.ndarray:
    """The matrix of the image's array, (3, 4), x, y, z."""
    grid = open_zarr(path)
    assert grid.affine is not None
    np.testing.assert_array_equal(grid.whole(), FIELD)
    return grid.affine.array


ZYX = [axis(name) for name in "zyx"]


def test_coordinate_systems_are_read_as_far_as_they_are_affine(tmp_path: Path) -> None:
    steps = [scale(2, 1.5, 0.5), translation(3, 2, 1)]
    sequence = {"type": "sequence", "transformations": steps}
    expected = [[0.5, 0, 0, 1], [0, 1.5, 0, 2], [0, 0, 2, 3]]
    path = tmp_path / "v.zarr"
    np.testing.assert_allclose(placed(image(path, FIELD, ZYX, sequence, version="0.6")), expected)
    affine = {"type": "affine", "affine": [[2, 0, 0, 3], [0, 1.5, 0, 2], [0, 0, 0.5, 1]]}
    np.testing.assert_allclose(placed(image(path, FIELD, ZYX, affine, version="0.6")), expected)
    rotation = {"type": "rotation", "rotation": [[1, 0, 0], [0, 0.8, 0.6], [0, -0.6, 0.8]]}
    both = {"type": "sequence", "transformations": [rotation, *steps]}
    found = placed(image(path, FIELD, ZYX, both, version="0.6"))
    np.testing.assert_allclose(found, [[0.4, -0.3, 0, 1], [0.9, 1.2, 0, 2], [0, 0, 2, 3]])
    bijection = {"type": "bijection", "forward": sequence, "inverse": {"type": "identity"}}
    np.testing.assert_allclose(placed(image(path, FIELD, ZYX, bijection, version="0.6")), expected)


def test_an_axis_may_be_mapped_to_another(tmp_path: Path) -> None:
    mapped = {
        "type": "sequence",
        "transformations": [{"type": "mapAxis", "mapAxis": [2, 1, 0]}, scale(2, 1.5, 0.5)],
    }
    path = image(tmp_path / "v.zarr", FIELD.transpose(2, 1, 0), ZYX, mapped, version="0.6")
    grid = open_zarr(path)
    np.testing.assert_array_equal(grid.whole(), FIELD)
    assert tuple(grid.spacing) == (0.5, 1.5, 2.0)


@pytest.mark.parametrize(
    ("step", "words"),
    [
        ({"type": "displacements", "path": "warp"}, "'displacements', which is not read here"),
        ({"type": "affine", "path": "matrix"}, "'affine' that is not in its metadata"),
        ({"type": "affine", "affine": [[1, 2], [3, 4]]}, "metadata of .* is damaged"),
        ({"type": "mapAxis", "mapAxis": [0, 1, 7]}, "metadata of .* is damaged"),
        ({"type": "scale", "scale": [1, 2]}, "a scale of 2 numbers for 3 axes"),
        ({"scale": [1, 2, 3]}, "metadata of .* is damaged"),
    ],
)
def test_what_is_not_affine_is_refused_in_a_sentence(tmp_path: Path, step: Any, words: str) -> None:
    path = image(tmp_path / "v.zarr", FIELD, ZYX, step, version="0.6")
    with pytest.raises(VolumeError, match=words):
        open_zarr(path)


def plate(path: Path, wells: dict[str, list[str]]) -> Path:
    """A plate of wells with these fields; each image holds numbers of its own."""
    group = zarr.open_group(path, mode="w")
    group.attrs["ome"] = {"version": "0.5", "plate": {"wells": [{"path": well} for well in wells]}}
    number = 0
    for well, fields in wells.items():
        zarr.open_group(path / well.split("/")[0], mode="a")
        held = zarr.open_group(path / well, mode="w")
        held.attrs["ome"] = {
            "version": "0.5",
            "well": {"images": [{"path": each} for each in fields]},
        }
        for each in fields:
            image(path / well / each, FIELD + number, ZYX, scale(2, 1, 1))
            number += 1
    return path


def test_a_plate_shows_the_first_field_of_its_first_well(tmp_path: Path) -> None:
    path = plate(tmp_path / "p.zarr", {"A/1": ["0", "1"], "B/2": ["0"]})
    scene = load_scene(path)
    assert scene.volume.value_range[0] == 0.0 and scene.volume.spacing == (1.0, 1.0, 2.0)
    assert scene.volume.orientation.notes == (
        "The plate has 2 wells: A/1 is shown, and #B/2 chooses another.",
        "The well has 2 fields: 0 is shown, and #A/1/1 chooses another.",
    )
    for part, first in (
        ("A/1/0", 0.0),
        ("A/1/1", 1.0),
        ("B/2", 2.0),
        ("B/2/0", 2.0),
        ("B/2/0/0", 2.0),
    ):
        assert load_scene(f"{path}#{part}").volume.value_range[0] == first
    (tmp_path / "s.toml").write_text('volume = "p.zarr#B/2/0"\n')
    assert load_scene(tmp_path / "s.toml").volume.name == "p-B-2-0"
    with pytest.raises(VolumeError, match="leads out of"):
        load_scene(f"{path}#../other.zarr")
    with pytest.raises(VolumeError, match="There is no Zarr array"):
        load_scene(f"{path}#C/3")


def test_a_damaged_plate_is_refused(tmp_path: Path) -> None:
    zarr.open_group(tmp_path / "p.zarr", mode="w").attrs["ome"] = {"plate": {"wells": []}}
    with pytest.raises(VolumeError, match=r"metadata of .* is damaged"):
        open_zarr(tmp_path / "p.zarr")


def test_of_several_images_in_a_file_the_first_is_shown(tmp_path: Path) -> None:
    zarr.open_group(tmp_path / "v.zarr", mode="w").attrs["bioformats2raw.layout"] = 3
    for number in range(2):
        image(tmp_path / "v.zarr" / str(number), FIELD + number, ZYX, scale(1, 1, 1))
    grid = open_zarr(tmp_path / "v.zarr")
    np.testing.assert_array_equal(grid.whole(), FIELD)
    assert "the first is shown" in grid.notes[0]
    np.testing.assert_array_equal(open_zarr(tmp_path / "v.zarr" / "1").whole(), FIELD + 1)


def test_an_image_of_labels_names_them(tmp_path: Path) -> None:
    about = {
        "colors": [
            {"label-value": 1, "rgba": [255, 0, 16, 255]},
            {"label-value": 0, "rgba": [0, 0, 0, 0]},
        ],
        "properties": [{"label-value": 1, "class": "nucleus"}, {"label-value": 2, "name": "cell"}],
    }
    path = image(tmp_path / "v.zarr", FIELD % 3, ZYX, scale(1, 1, 1), **{"image-label": about})
    assert open_zarr(path).labels == (LabelName(1, "nucleus", "#ff0010"), LabelName(2, "cell"))
    colours = load_scene(path).surfaces.colours
    assert colours is not None and [each.name for each in colours.scale.labels] == [
        "nucleus",
        "cell",
    ]


@pytest.mark.parametrize(
    "colour", [{"rgba": [1, 2, 3]}, {"label-value": 1, "rgba": [0.5, 0.5, 0.5]}, 7]
)
def test_damaged_labels_are_refused(tmp_path: Path, colour: object) -> None:
    about = {"image-label": {"colors": [colour]}}
    path = image(tmp_path / "v.zarr", FIELD % 3, ZYX, scale(1, 1, 1), **about)
    with pytest.raises(VolumeError, match=r"The OME metadata of '.*v\.zarr' is damaged"):
        open_zarr(path)


# --- written images
# --------------------------------------------------------------------------------------------------


def grid_of(array: np.ndarray, placed: Any = None, letters: str = "", **more: Any) -> Grid:
    """An array as a grid in slabs of five layers, placed by an affine."""
    if placed is None:
        affine = None
    else:
        affine = Affine.of(placed, letters)
    if placed is None:
        steps = (1.0, 1.0, 1.0)
    else:
        steps = tuple(np.linalg.norm(placed[:3, :3], axis=0).tolist())
    parts = range(0, len(array), 5)
    return Grid(
        array.shape,
        array.dtype,
        steps,
        lambda: (array[z : z + 5] for z in parts),
        affine=affine,
        **more,
    )


@pytest.mark.parametrize("way", WAYS[::5], ids=str)
def test_what_is_written_lies_where_it_was(tmp_path: Path, way: Any) -> None:
    array, placed = lying(*way)
    assert not write_image(
        grid_of(array, placed, "RAS", unit="mm"), tmp_path / "v.zarr", no_progress
    )
    read = open_zarr(tmp_path / "v.zarr")
    grid = on_right_angles(read)
    voxels = grid.whole()
    orientation = Orientation.of(grid)
    assert (grid.unit, orientation.letters) == ("mm", "RAS")
    assert np.allclose(orientation.matrix, np.eye(3)), "axes of the file ascend in the world"
    for index, place in zip(landmarks(), world(landmarks()), strict=True):
        x, y, z = np.rint(
            np.array(orientation.point_to_box(tuple(place))) / np.array(grid.spacing)
        ).astype(int)
        assert voxels[z, y, x] == letter()[tuple(index[::-1])]


@pytest.mark.parametrize("kind", ["u1", "i2", ">u2", "f4", "f8", "?"])
def test_numbers_of_all_types_are_kept(tmp_path: Path, kind: str) -> None:
    array = (np.random.default_rng(1).random((70, 9, 130)) * 3).astype(kind)
    write_image(grid_of(array), tmp_path / "v.zarr", no_progress)
    np.testing.assert_array_equal(open_zarr(tmp_path / "v.zarr").whole(), array)
    coarse = open_zarr(tmp_path / "v.zarr", level=1)
    assert coarse.shape == (35, 5, 65) and tuple(coarse.spacing) == (2.0, 2.0, 2.0)
    inside = array[:, :8].astype(float).reshape(35, 2, 4, 2, 65, 2).mean(axis=(1, 3, 5))
    if np.dtype(kind).kind != "f":
        expected = np.rint(inside)
    else:
        expected = inside
    np.testing.assert_allclose(coarse.whole()[:, :4].astype(float), expected, rtol=1e-6)
    last = open_zarr(tmp_path / "v.zarr", level=2)
    assert last.shape == (18, 5, 33) and tuple(last.spacing) == (4.0, 2.0, 4.0), (
        "thin sides are not halved"
    )
    with pytest.raises(VolumeError, match="levels 0 to 2"):
        open_zarr(tmp_path / "v.zarr", level=3)


def test_holes_stay_holes_and_make_no_others() -> None:
    block = np.arange(16, dtype=np.float32).reshape(2, 2, 4)
    block[0, 0, 0] = np.nan
    block[:, :, 2:] = np.nan
    found = halved(block, [True, True, True])
    assert found.shape == (1, 1, 2) and np.isnan(found[0, 0, 1])
    assert found[0, 0, 0] == np.nanmean(block[:, :, :2])


def test_labels_are_never_mixed_and_keep_their_names(tmp_path: Path) -> None:
    array = np.random.default_rng(2).choice([0, 3, 900], (66, 66, 66)).astype(np.uint16)
    names = (LabelName(3, "left", "#ff0010"), LabelName(900, "right"))
    write_image(grid_of(array, labels=names), tmp_path / "v.zarr", no_progress)
    coarse = open_zarr(tmp_path / "v.zarr", level=1)
    assert coarse.labels == names and coarse.affine is None
    np.testing.assert_array_equal(coarse.whole(), array[::2, ::2, ::2])


def test_a_turned_volume_is_written_without_its_place(tmp_path: Path) -> None:
    turn = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0]
    placed = np.column_stack([turn * np.sign(np.linalg.det(turn)), [1.0, 2.0, 3.0]])
    (note,) = write_image(grid_of(letter(), placed, "RAS"), tmp_path / "v.zarr", no_progress)
    assert "OME-Zarr keeps no turned axes" in note
    grid = open_zarr(tmp_path / "v.zarr")
    np.testing.assert_array_equal(grid.whole(), letter())
    assert grid.affine is None


def test_nothing_is_left_of_what_fails_and_nothing_is_replaced(tmp_path: Path) -> None:
    def broken() -> Any:
        yield letter()[:5]
        raise VolumeError("The source is damaged.")

    failing = Grid(letter().shape, letter().dtype, (1.0, 1.0, 1.0), broken)
    with pytest.raises(VolumeError, match="is damaged"):
        write_image(failing, tmp_path / "v.zarr", no_progress)
    assert not list(tmp_path.iterdir())
    write_image(grid_of(letter()), tmp_path / "v.zarr", no_progress)
    with pytest.raises(VolumeError, match="already: remove it"):
        write_image(grid_of(letter()), tmp_path / "v.zarr", no_progress)


def test_others_read_the_image(tmp_path: Path) -> None:
    """By the names that NGFF 0.5 gives, without isogi's reader."""
    write_image(grid_of(letter(), unit="µm"), tmp_path / "v.zarr", no_progress)
    group = zarr.open_group(tmp_path / "v.zarr", mode="r")
    held: Any = group.attrs["ome"]
    (image,) = held["multiscales"]
    assert (held["version"], [axis["name"] for axis in image["axes"]]) == ("0.5", ["z", "y", "x"])
    assert {axis["unit"] for axis in image["axes"]} == {"micrometer"}
    found: Any = group[image["datasets"][0]["path"]]
    np.testing.assert_array_equal(found[:], letter())


def test_progress_counts_the_layers_of_all_levels(tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    array = np.zeros((70, 70, 70), np.uint8)
    write_image(grid_of(array), tmp_path / "v.zarr", lambda done, total: seen.append((done, total)))
    assert seen[-1] == (105, 105) and [done for done, _ in seen] == sorted(
        {done for done, _ in seen}
    )
