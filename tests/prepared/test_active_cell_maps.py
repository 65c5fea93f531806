"""The active-cell maps of one volume: widened to levels, made once, kept within so many bytes."""

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from isogi_core.errors import Cancelled
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.tracing.active_cells import ActiveCells, block_ranges, make_active_cells, measure_ranges
from isogi_core.lru_cache import OVERHEAD_BYTES
from isogi_core.model.volume import Isovalue, make_volume
from isogi_core.prepared import active_cell_maps as module
from isogi_core.prepared.active_cell_maps import CORE_GROUPS, MARKED_LAYERS, NEAR_ZERO_LEVEL, ActiveCellMaps
from isogi_core.prepared.prepared_scene import make_field, survey_of
from isogi_core.runs import Piece, Run, serially

STEP = 1.0 / CORE_GROUPS
HALF = Isovalue(0.5)
VOXELS = np.random.default_rng(1).random((70, 21, 34)).astype(np.float32)


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[tuple[float, float]]:
    """The ranges that maps are made for."""
    made = []

    def counted(
        voxels: np.ndarray, ranges: object, lowest: float, highest: float, run: object, take: object
    ) -> ActiveCells:
        made.append((lowest, highest))
        return make_active_cells(voxels, ranges, lowest, highest, run, take)

    monkeypatch.setattr(module, "make_active_cells", counted)
    return made


def between(maps: ActiveCellMaps, lowest: float, highest: float, run: Run = serially) -> ActiveCells:
    """The map of a range of isovalues."""
    return maps.covering(np.array([lowest, highest]), run)


def assert_same(one: ActiveCells, other: ActiveCells) -> None:
    """Two maps are equal."""
    assert np.array_equal(one.tops, other.tops)
    assert np.array_equal(one.cells, other.cells)


def test_a_map_is_that_of_the_whole_step() -> None:
    cells = between(ActiveCellMaps(VOXELS), 0.5 + STEP / 3, 0.5 + STEP / 2)
    expected = make_active_cells(VOXELS, block_ranges(VOXELS), 0.5, 0.5 + STEP)
    assert_same(cells, expected)
    assert np.array_equal(cells.margins, expected.margins)
    assert cells.shape == expected.shape


@pytest.mark.parametrize(
    ("lowest", "highest", "steps"),
    [(0.0, 0.0, (0, NEAR_ZERO_LEVEL / STEP)),
     (NEAR_ZERO_LEVEL, NEAR_ZERO_LEVEL, (NEAR_ZERO_LEVEL / STEP, 1)), (1.0, 1.0, (64, np.inf)),
     (0.51, 0.51, (32, 33)), (0.5, 0.51, (32, 33)), (0.49, 0.51, (31, 33)), (-0.01, 0.0, (-np.inf, 0)),
     (0.5, 0.53125, (32, 34)), (1e30, 1e36, (64, np.inf))],
)  # fmt: skip
def test_ranges_are_widened_to_levels_and_no_farther(
    made: list[tuple[float, float]], lowest: float, highest: float, steps: tuple[int, int]
) -> None:
    between(ActiveCellMaps(VOXELS), lowest, highest)
    assert made == [(steps[0] * STEP, steps[1] * STEP)]


def test_near_isovalues_share_a_map(made: list[tuple[float, float]]) -> None:
    maps = ActiveCellMaps(VOXELS)
    assert maps.at(Isovalue(0.501)) is maps.at(Isovalue(0.505))
    assert maps.at(Isovalue(0.521)) is not maps.at(Isovalue(0.505))
    assert len(made) == 2


def test_maps_are_kept_up_to_their_bytes(made: list[tuple[float, float]]) -> None:
    size = ActiveCellMaps(VOXELS).at(HALF).nbytes
    made.clear()
    maps = ActiveCellMaps(VOXELS, most=2 * (size + OVERHEAD_BYTES))
    for isovalue in (0.1, 0.5, 0.1, 0.9, 0.1, 0.5):
        maps.at(Isovalue(isovalue))
    assert [round(lowest, 1) for lowest, _ in made] == [0.1, 0.5, 0.9, 0.5]
    least = ActiveCellMaps(VOXELS, most=0)
    assert least.at(HALF) is least.at(HALF)


def test_threads_that_want_one_map_make_it_once(made: list[tuple[float, float]]) -> None:
    maps = ActiveCellMaps(VOXELS)
    with ThreadPoolExecutor(8) as threads:
        first, *others = threads.map(lambda _: maps.at(HALF), range(32))
    assert all(each is first for each in others)
    assert len(made) == 1


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_many_threads_make_the_same_map(threads: int) -> None:
    tiles = Tiles(threads)
    one, other = (between(ActiveCellMaps(VOXELS), 0.5, 0.6, run) for run in (serially, tiles.run))
    tiles.close()
    assert_same(one, other)


@pytest.mark.parametrize("when", [0, 2])
def test_a_cancelled_map_is_dropped_and_made_later(when: int) -> None:
    cancelled, pieces = threading.Event(), []
    tiles = Tiles(1).cancelled_by(cancelled)

    def run(piece: Piece, total: int, size: int) -> None:
        def counted(first: int, last: int) -> None:
            pieces.append(first)
            piece(first, last)
            if len(pieces) == when:
                cancelled.set()

        tiles.run(counted, total, size)

    maps = ActiveCellMaps(VOXELS)
    if not when:
        cancelled.set()
    with pytest.raises(Cancelled):
        maps.at(HALF, run)
    assert pieces == list(range(0, when * MARKED_LAYERS, MARKED_LAYERS))
    again = maps.at(HALF)
    assert_same(again, ActiveCellMaps(VOXELS).at(HALF))
    assert maps.at(HALF, run) is again, "what is kept need not be made"


RAMP = np.broadcast_to(np.linspace(0.0, 1.0, 70, dtype=np.float32)[:, None, None], VOXELS.shape).copy()


def ask(maps: ActiveCellMaps, isovalues: np.ndarray) -> int:
    """Have the maps of all groups of some isovalues; how many there are."""
    numbers, spans = maps.groups(isovalues)
    assert (spans[numbers, 0] <= isovalues).all() and (isovalues < spans[numbers, 1]).all()
    for number in np.unique(numbers):
        maps.covering(spans[number])
    return len(np.unique(numbers))


@pytest.mark.parametrize(("most", "least", "groups"), [(1 << 30, 33, 33), (80_000, 5, 32), (1, 1, 1)])
def test_groups_widen_until_all_of_their_maps_are_kept(
    made: list[tuple[float, float]], most: int, least: int, groups: int
) -> None:
    maps, isovalues = ActiveCellMaps(RAMP, most=most), np.linspace(0.0, 1.0, 500)
    ask(maps, isovalues)
    while made:
        made.clear()
        settled = ask(maps, isovalues)
    assert least <= settled <= groups


def test_groups_stay_narrow_where_few_are_asked_for(made: list[tuple[float, float]]) -> None:
    maps, isovalues = ActiveCellMaps(RAMP, most=80_000), np.linspace(0.43, 0.51, 50)
    assert [ask(maps, isovalues) for _ in range(3)] == [3, 3, 3]
    assert len(made) == 3
    assert all(high - low == 2 * STEP for low, high in made)


def test_maps_that_are_large_beside_the_budget_lie_in_files(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    voxels = np.random.default_rng(4).random((260, 257, 258), np.float32)
    inside = ActiveCellMaps(voxels).at(Isovalue(np.float64(0.97)))
    monkeypatch.setenv("ISOGI_VOLUME_MB", "1")
    monkeypatch.setenv("ISOGI_VOLUME_CACHE", str(tmp_path))
    outside = ActiveCellMaps(voxels).at(Isovalue(np.float64(0.97)))
    for name in ("tops", "cells"):
        one, other = getattr(inside, name), getattr(outside, name)
        np.testing.assert_array_equal(one, other)
        assert one.base is None and other.base is not None
    np.testing.assert_array_equal(inside.margins, outside.margins)


def test_dear_maps_reach_ever_farther(made: list[tuple[float, float]], monkeypatch: pytest.MonkeyPatch) -> None:
    maps = ActiveCellMaps(RAMP, most=0)
    monkeypatch.setattr(maps, "_dear", True)
    for last in np.linspace(0.1, 1.0, 40):
        maps.covering(maps.groups(np.linspace(0.05, last, 20))[1][-1])
    assert [(low, high >= last) for low, high in made[-1:]] == [(made[0][0], True)]
    assert len(made) <= 6, "of 40 that were asked for"


def test_a_large_volume_is_measured_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("ISOGI_VOLUME_MB", "1")
    monkeypatch.setenv("ISOGI_VOLUME_CACHE", str(tmp_path))
    volume, asked = make_volume(VOXELS), list[str]()

    def ranges(voxels: np.ndarray) -> np.ndarray:
        asked.append("ranges")
        return measure_ranges(voxels)

    monkeypatch.setattr(module, "measure_ranges", ranges)
    first, again = (ActiveCellMaps(volume.voxels, survey=survey_of(volume)) for _ in range(2))
    assert asked == ["ranges"], "the second reads it"
    for path in tmp_path.glob("*/*.npy"):
        path.write_bytes(path.read_bytes()[:-100])
    mended = ActiveCellMaps(volume.voxels, survey=survey_of(volume))
    assert asked == ["ranges"] * 2, "of the damaged file"
    for maps in (again, mended, ActiveCellMaps(volume.voxels)):
        np.testing.assert_array_equal(maps.levels, first.levels)
        assert_same(maps.at(HALF), first.at(HALF))
    for one, other in zip(make_field(volume)[1:3], make_field(replace(volume, digest="other"))[1:3], strict=True):
        np.testing.assert_array_equal(one, other)
