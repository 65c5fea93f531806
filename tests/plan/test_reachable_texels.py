"""Texels that isovalues can show, against loops over cells, real frames and the bake's own
normals.
"""

import tracemalloc

import numpy as np
import pytest

from isogi_core.bake.refine import locate
from isogi_core.frame.gbuffer import trace
from isogi_core.frame.tiles import Tiles
from isogi_core.frame.view_texels import find_texels
from isogi_core.model.view import View
from isogi_core.model.volume import make_volume
from isogi_core.plan import reachable_texels as module
from isogi_core.plan.reachable_texels import (
    Sample,
    count_texels,
    surface_cells,
    surface_texels,
    void_texels,
)
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import PreparedScene
from tests.frame.conftest import scene_of
from tests.kernels.fields import bare_field
from tests.loaded import load_scene
from tests.plan.shown import shown_texels

CHUNK = 16


def steps(seed: int, shape: tuple[int, int, int] = (7, 8, 9)) -> np.ndarray:
    """A field of few values, so that plateaus and corners at an isovalue itself are common."""
    return (np.random.default_rng(seed).integers(0, 5, shape) / 4.0).astype(np.float32)


def may_show_a_surface(corners: np.ndarray, lowest: float, highest: float) -> bool:
    """Whether some isovalue of the range, tried at every value and between any two, parts the
    corners or is at one.
    """
    levels = np.unique(np.append(corners, [lowest, highest]))
    levels = np.append(levels, (levels[1:] + levels[:-1]) / 2)
    levels = levels[(levels >= lowest) & (levels <= highest)]
    flat = corners.min() == corners.max()
    return not flat and any(
        (corners >= level).any() and (corners <= level).any() for level in levels
    )


@pytest.mark.parametrize("span", [(0.5, 0.5), (0.3, 0.3), (0.0, 1.0), (0.1, 0.4), (0.25, 0.5)])
def test_surface_cells_are_cut_or_touched_by_some_isovalue(span: tuple[float, float]) -> None:
    voxels = steps(1)
    found = surface_cells(voxels, *span)
    for z, y, x in np.ndindex(found.shape):
        assert found[z, y, x] == may_show_a_surface(
            voxels[z : z + 2, y : y + 2, x : x + 2].ravel(), *span
        )


def test_cells_with_a_hole_hold_no_surface() -> None:
    voxels = steps(2)
    voxels[3, 4, 5] = np.nan
    found = surface_cells(voxels, 0.5, 0.5)
    assert not found[2:4, 3:5, 4:6].any() and found.any()


@pytest.mark.parametrize("shape", [(7, 8, 9), (4, 4, 5), (13, 15, 17), (2, 2, 2), (5, 11, 9)])
@pytest.mark.parametrize("size", [1, 4, 99])
def test_shown_texels_are_corners_of_cells_over_a_surface(
    shape: tuple[int, int, int], size: int
) -> None:
    cells = np.random.default_rng(3).random((6, 7, 8)) < 0.03
    expected = np.zeros(shape, np.bool_)
    step = [n / (t - 1) for n, t in zip(cells.shape, shape, strict=True)]
    for lattice_cell in np.ndindex(*(t - 1 for t in shape)):
        over = tuple(
            slice(int(np.floor(i * s)), int(np.ceil((i + 1) * s)))
            for i, s in zip(lattice_cell, step, strict=True)
        )
        if cells[over].any():
            expected[tuple(slice(i, i + 2) for i in lattice_cell)] = True
    np.testing.assert_array_equal(shown_texels(cells, shape, size), expected)


@pytest.mark.parametrize("lattice", [1.0, 0.5, 2.0])
def test_void_texels_are_those_that_the_bake_finds(lattice: float) -> None:
    """Blocks of equal voxels, between whose texels others may lie."""
    volume = make_volume(np.kron(steps(6, (7, 7, 9)), np.ones((5, 5, 5), np.float32)))
    prepared = PreparedScene(scene_of(volume, 0.5, lattice=lattice))
    places = np.arange(np.prod(prepared.shape))[:: 3 if lattice > 1.0 else 1]
    _, void = locate(
        np.stack(np.unravel_index(places, prepared.shape), axis=-1).astype(np.int32), prepared
    )
    assert 0.01 < void.mean() < 0.9
    assert np.array_equal(void_texels(prepared.field, prepared.shape, places), void)


@pytest.fixture(scope="module")
def orbital() -> Scene:
    return load_scene("demo:orbital")


@pytest.mark.parametrize("lattice", [1.0, 0.5, 1.5])
def test_views_read_no_texel_that_counts_as_unseen(orbital: Scene, lattice: float) -> None:
    scene = load_scene("demo:orbital", lattice=lattice, isovalues=[orbital.isovalue] * 2)
    prepared = PreparedScene(scene)
    tiles = Tiles(1)
    level = scene.volume.normalise_isovalue(scene.isovalue)
    shown = shown_texels(surface_cells(scene.volume.voxels, level, level), prepared.shape)
    for azimuth in (0.0, 120.0, 240.0):
        view = View(scene.isovalue, scene.camera(azimuth, 30.0, 3.0, 30.0), width=48, height=48)
        texels = find_texels(trace(view, prepared.surface(view.isovalue), tiles), prepared, tiles)
        assert texels.chunks
        for index, offsets in zip(texels.chunks, texels.offsets, strict=True):
            inside = (
                np.stack(np.unravel_index(offsets, (CHUNK,) * 3)) + np.array(index)[:, None] * CHUNK
            )
            assert shown[tuple(inside)].all()


def test_counts(orbital: Scene) -> None:
    level = orbital.volume.normalise_isovalue(orbital.isovalue)
    shape = orbital.lattice_shape
    count = count_texels(bare_field(orbital.volume.voxels), shape, level, level, CHUNK)
    shown = shown_texels(surface_cells(orbital.volume.voxels, level, level), shape)
    chunks = {tuple(place) for place in np.argwhere(shown) // CHUNK}
    assert (count.total, count.shown, count.shown_chunks) == (
        np.prod(shape),
        shown.sum(),
        len(chunks),
    )
    assert count.chunks == np.prod([-(-n // CHUNK) for n in shape])


def test_void_texels_are_estimated_from_a_sample(monkeypatch: pytest.MonkeyPatch) -> None:
    """A lattice of half a texel a voxel over a field of large steps: a share of the shown texels is
    void.
    """
    voxels = np.kron(steps(5, (24, 24, 24)), np.ones((6, 6, 6), np.float32))
    shape = (60, 60, 60)
    located: list[int] = []
    monkeypatch.setattr(
        module,
        "void_texels",
        lambda field, shape, few: located.append(len(few)) or void_texels(field, shape, few),
    )
    count = count_texels(bare_field(voxels), shape, 0.0, 1.0, CHUNK)
    places = np.flatnonzero(shown_texels(surface_cells(voxels, 0.0, 1.0), shape))
    assert count.shown == len(places)
    assert 10_000 < sum(located) < len(places) / 2
    exact = int(void_texels(bare_field(voxels), shape, places).sum())
    assert exact > 0 and count.void == pytest.approx(exact, rel=0.1)


@pytest.mark.parametrize("most", [1, 3, 40, 5000])
def test_a_sample_is_evenly_taken(most: int) -> None:
    places = np.flatnonzero(np.random.default_rng(9).random(1700) < 0.4)
    sample = Sample(most)
    for part in np.split(places, [3, 3, 200, 450]):
        sample.add(part)
    step = 2 ** int(np.ceil(np.log2(max(len(places) / most, 1))))
    assert sample.passed == len(places)
    np.testing.assert_array_equal(sample.places, places[::step])


def test_counting_takes_little_memory_where_all_texels_are_shown() -> None:
    """Marks take a byte a texel, of a layer of chunks and a few copies of it; those of all would be
    more.
    """
    voxels = np.random.default_rng(4).random((160, 160, 160), np.float32)
    field = bare_field(voxels)
    count_texels(field, (2, 2, 2), 0.0, 1.0, CHUNK)  # has its kernel compiled
    tracemalloc.start()
    count = count_texels(field, voxels.shape, 0.0, 1.0, CHUNK)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert count.shown == count.total and most < count.total


def test_a_constant_volume_shows_nothing() -> None:
    count = count_texels(bare_field(np.zeros((5, 5, 5))), (5, 5, 5), 0.0, 1.0, CHUNK)
    assert (count.total, count.shown, count.void, count.shown_chunks) == (125, 0, 0, 0)


# --- chunk by chunk
# --------------------------------------------------------------------------------------------------


RANGES = [[(0.5, 0.5)], [(0.2, 0.3), (0.9, 0.95)], [(7.0, 8.0)]]


@pytest.mark.parametrize(
    "shape", [(20, 17, 33), (10, 9, 17), (39, 33, 65), (2, 2, 2), (16, 16, 16)]
)
@pytest.mark.parametrize("ranges", RANGES)
def test_chunks_together_hold_what_the_lattice_shows(
    shape: tuple[int, int, int], ranges: list[tuple[float, float]]
) -> None:
    voxels = np.random.default_rng(0).random((20, 17, 33)).astype(np.float32).cumsum(axis=0) / 10
    expected = np.logical_or.reduce(
        [shown_texels(surface_cells(voxels, *each), shape) for each in ranges]
    )
    found = np.zeros(shape, np.bool_)
    for index, offsets in surface_texels(voxels, shape, 8, ranges):
        assert len(offsets) > 0 and (np.diff(offsets) > 0).all()
        z, y, x = np.stack(np.unravel_index(offsets, (8, 8, 8))) + 8 * np.array(index)[:, None]
        found[z, y, x] = True
    np.testing.assert_array_equal(found, expected)
