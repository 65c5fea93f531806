"""Fields that repeat: closed across the faces of their cell, side by side, for any lattice."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import nrrd
import numpy as np
import pytest

from isogi_core.errors import SceneError
from isogi_core.files.cells import Cells, set_side_by_side
from isogi_core.files.grid import Affine, Grid
from isogi_core.files.scene_file import Settings
from isogi_core.plan.assembly import load_scene
from isogi_core.plan.volumes.masks import cut_away
from isogi_core.plan.volumes.opening import open_beside
from isogi_core.prepared.isosurface_mesh import surface_size
from isogi_server.inspect.inspection import stiffness_schema

LATTICE = np.array([[4.0, 0.0, 0.0], [2.0, 3.5, 0.0], [0.5, -1.0, 6.0]])
"""Vectors of a triclinic lattice, rows."""


def field_at(points: np.ndarray, lattice: np.ndarray = LATTICE) -> np.ndarray:
    """A field of the lattice at ``points`` (..., 3) of the world."""
    a, b, c = np.moveaxis(2.0 * np.pi * points @ np.linalg.inv(lattice), -1, 0)
    return np.cos(a) + np.cos(b + 0.5) + np.cos(c) + 0.5 * np.cos(a + b - c)


def crystal(shape: tuple[int, int, int], lattice: np.ndarray = LATTICE) -> Grid:
    """One cell of that field, of a ``shape`` (z, y, x)."""
    steps = lattice / np.array(shape[::-1])[:, None]
    k, j, i = np.indices(shape)
    values = field_at(np.stack([i, j, k], -1) @ steps, lattice)
    affine = Affine.of(np.column_stack([steps.T, np.zeros(3)]))
    spacing = tuple(np.linalg.norm(steps, axis=1).tolist())
    return Grid(shape, values.dtype, spacing, lambda: iter((values,)), affine=affine)


def written(folder: Path, **settings: Any) -> Any:
    """The scene of a cell (z, y, x) of plain steps that is no field of both signs."""
    rng = np.random.default_rng(5)
    cell = 3.0 + rng.random((10, 12, 14)).astype(np.float32)
    np.save(folder / "cell.npy", cell)
    np.save(folder / "block.npy", np.tile(cell, (3, 3, 3)))
    return load_scene(folder / "cell.npy", **settings)


EVERY = (True, True, True)


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_a_box_of_any_lattice_holds_the_field(mirror: float) -> None:
    lattice = LATTICE * np.array([mirror, 1.0, 1.0])
    grid = crystal((48, 36, 40), lattice)
    cells = Cells(EVERY, (2, 1, 1), 3)
    box = set_side_by_side(grid, cells)
    assert box is not None
    assert box.affine is not None
    k, j, i = np.indices(box.shape)
    world = np.stack([i, j, k, np.ones_like(i)], -1) @ box.affine.array.T
    np.testing.assert_allclose(box.whole(), field_at(world, lattice), atol=0.02)  # linear between
    one = set_side_by_side(grid, Cells(EVERY))
    assert one is not None
    assert abs(one.whole()[:-1, :-1, :-1].mean() - grid.whole().mean()) < 1e-12
    extent = np.prod(np.multiply(np.array(one.shape[::-1]) - 1, one.spacing))
    assert extent == pytest.approx(abs(np.linalg.det(lattice)))


def test_a_straight_cell_is_not_interpolated() -> None:
    straight = crystal((8, 9, 10), np.diag([4.0, 3.5, 6.0]))
    box = set_side_by_side(straight, Cells((True, False, True), (2, 1, 3), 1))
    assert box is not None
    tiled = np.pad(np.tile(straight.whole(), (3, 1, 2)), ((1, 2), (0, 0), (1, 2)), mode="wrap")
    np.testing.assert_array_equal(box.whole(), tiled)


@pytest.mark.parametrize("hole", [np.nan, np.inf])
def test_a_hole_of_an_oblique_cell_grows_by_no_voxel(hole: float) -> None:
    voxels = np.ones((4, 5, 6), np.float32)
    voxels[0, 2, 2] = hole
    oblique = Affine.of([[1.0, 0.0, 0.5, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
    box = set_side_by_side(replace(Grid.of(voxels), affine=oblique), Cells(EVERY))
    assert box is not None
    expected = np.pad(voxels[0], (0, 1), mode="wrap")
    np.testing.assert_array_equal(box.whole()[0], expected, "layer 0 is not moved")


def test_a_cell_oblique_to_an_axis_that_ends_is_no_box() -> None:
    assert set_side_by_side(crystal((8, 9, 10)), Cells((False, False, True))) is None


def test_a_cell_is_the_middle_of_a_block_that_is_cut(tmp_path: Path) -> None:
    scene = written(tmp_path, periodic=list(EVERY), isovalue=3.5)
    block = load_scene(tmp_path / "block.npy", isovalue=3.5)
    cut = cut_away(block.volume, "x<14;x>28;y<12;y>24;z<10;z>20")
    middle = cut.voxels[9:22, 11:26, 13:30]
    # Inside and one voxel around, surfaces, faces and normals are the same to the bit.
    assert scene.volume.offset == block.volume.offset
    np.testing.assert_array_equal(scene.volume.voxels, middle)
    assert scene.volume.orientation.origin == (-1.0, -1.0, -1.0)


def test_area_and_volume_are_those_of_one_cell(tmp_path: Path) -> None:
    scene = written(tmp_path, periodic=list(EVERY), isovalue=3.5)
    several = load_scene(
        tmp_path / "cell.npy", periodic=list(EVERY), repeat=[2, 3, 1], isovalue=3.5
    )
    assert several.volume.size == (31, 39, 13)
    sizes = []
    for each in (scene, several):
        cell = each.volume.cell
        assert cell is not None
        level = each.volume.normalise_isovalue(3.5)
        voxels = cell.of(each.volume.voxels)
        sizes.append(surface_size(voxels, level, np.eye(3), cell.periodic))
        whole = each.volume.voxels[1:-1, 1:-1, 1:-1]
        count = np.prod(each.source.document.get("repeat", [1, 1, 1]))
        assert surface_size(whole, level, np.eye(3)).area == pytest.approx(
            count * sizes[0].area, rel=1e-6
        )
    assert sizes[0] == sizes[1]
    assert not sizes[0].is_open


def test_a_field_of_both_signs_has_no_faces(tmp_path: Path) -> None:
    x = np.linspace(-1.0, 1.0, 24, endpoint=False)
    r = np.sqrt(x[:, None, None] ** 2 + x[:, None] ** 2 + x**2)
    np.save(tmp_path / "p.npy", (x * np.exp(-10.0 * r)).astype(np.float32))
    scene = load_scene(tmp_path / "p.npy", periodic=list(EVERY))
    assert scene.surfaces.pinned
    assert scene.volume.size == (25, 25, 25)
    np.testing.assert_array_equal(scene.volume.voxels[0], scene.volume.voxels[-1])


def test_smoothing_goes_on_across_faces(tmp_path: Path) -> None:
    scene = written(tmp_path, periodic=list(EVERY), smooth=1)
    block = load_scene(tmp_path / "block.npy", smooth=1)
    middle = block.volume.offset + block.volume.scale * block.volume.voxels[10:21, 12:25, 14:29]
    volume = scene.volume
    assert volume.cell is not None
    found = volume.offset + volume.scale * volume.cell.of(volume.voxels)
    np.testing.assert_allclose(found, middle, rtol=1e-5)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"repeat": [2, 1, 1]}, "does not repeat along x"),
        ({"periodic": [1, 0, 0]}, "3 times true or false"),
        ({"periodic": list(EVERY), "repeat": [0, 1, 1]}, "whole numbers from 1 to 16"),
    ],
)
def test_periods_without_meaning_are_refused(
    tmp_path: Path, settings: dict[str, Any], words: str
) -> None:
    with pytest.raises(SceneError, match=words):
        written(tmp_path, **settings)


def test_a_target_says_how_often_it_repeats(tmp_path: Path) -> None:
    written(tmp_path)
    target = f"{tmp_path / 'cell.npy'}#periodic=true,true,false&repeat=2,1,1"
    assert load_scene(target).volume.size == (31, 15, 10)


def test_what_is_cut_away_around_a_cell_is_not_inspected(tmp_path: Path) -> None:
    found = stiffness_schema(written(tmp_path, periodic=list(EVERY), isovalue=3.5))
    assert found.mark is None
    assert found.surfaces[found.own].box == {}
    alone = stiffness_schema(load_scene(tmp_path / "cell.npy", isovalue=3.5))
    assert len(alone.surfaces[alone.own].box) == 6


def test_colours_of_a_crystal_go_on_with_its_cells(tmp_path: Path) -> None:
    grid = crystal((12, 10, 14))
    values = grid.whole() + 5.0
    header = {
        "space dimension": 3,
        "space directions": np.array(grid.affine.matrix).T if grid.affine else None,
        "space origin": np.zeros(3),
        "isogi periodic": "1 1 1",
    }
    for name, field in (("shape", values), ("colour", -values)):
        nrrd.write(str(tmp_path / f"{name}.nrrd"), field, header, index_order="C")
    tables = [{"file": "colour.nrrd", "use": "colour"}]
    (tmp_path / "scene.toml").write_text('volume = "shape.nrrd"\nrepeat = [1, 2, 1]\n')
    scene = load_scene(tmp_path / "scene.toml", volumes=tables)
    assert scene.volume.cell is not None
    settings = Settings(scene.source)
    beside = open_beside(settings, "colour.nrrd")
    own = scene.volume.offset + scene.volume.scale * scene.volume.voxels[1:-1, 1:-1, 1:-1]
    np.testing.assert_allclose(beside.whole()[1:-1, 1:-1, 1:-1], -own, atol=1e-5)
    assert beside.shape == scene.volume.shape
    colours = scene.surfaces.colours
    assert colours is not None
    assert colours.step == (1.0, 1.0, 1.0)
    codes = colours.places[1:-1, 1:-1, 1:-1]
    low, high = colours.scale.span
    expected = 1.0 + 254.0 * np.clip((-own - low) / (high - low), 0.0, 1.0)
    np.testing.assert_allclose(codes, expected, atol=1.0)
