"""Active cells of one volume: maps widened to levels, kept within so many bytes; idle voxels, and
voxel codes.
"""

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.errors import Cancelled
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.tracing.active_cells import (
    ActiveCells,
    block_ranges,
    make_active_cells,
    measure_ranges,
)
from isogi_core.model.volume import Isovalue, make_volume
from isogi_core.prepared import active_cell_maps as module
from isogi_core.prepared.active_cell_maps import (
    ActiveCellMaps,
    IdleVoxels,
    VoxelCodes,
    find_codes,
    find_levels,
)
from isogi_core.prepared.prepared_scene import make_field, survey_of
from isogi_core.runs import Piece, Run, serially

EVEN = np.random.default_rng(1).random((20, 21, 22)).astype(np.float32)
EVEN_LEVELS = find_levels(EVEN).tolist()
"""-inf, 0, just above 0, then even steps to 1, and inf."""

STEP = EVEN_LEVELS[3]
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


def between(
    maps: ActiveCellMaps, lowest: float, highest: float, run: Run = serially
) -> ActiveCells:
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
    ("lowest", "highest"),
    [
        (0.0, 0.0),
        (EVEN_LEVELS[2], EVEN_LEVELS[2]),
        (1.0, 1.0),
        (0.51, 0.51),
        (0.5, 0.51),
        (0.49, 0.51),
        (-0.01, 0.0),
        (0.5, 0.53125),
        (1e30, 1e36),
    ],
)
def test_ranges_are_widened_to_levels_and_no_farther(
    made: list[tuple[float, float]], lowest: float, highest: float
) -> None:
    maps = ActiveCellMaps(VOXELS)
    between(maps, lowest, highest)
    below = max(level for level in maps.levels if level <= lowest)
    above = min(level for level in maps.levels if level >= highest and level > below)
    assert made == [(below, above)]


def test_near_isovalues_share_a_map(made: list[tuple[float, float]]) -> None:
    maps = ActiveCellMaps(VOXELS)
    assert maps.at(Isovalue(0.501)) is maps.at(Isovalue(0.505))
    assert maps.at(Isovalue(0.521)) is not maps.at(Isovalue(0.505))
    assert len(made) == 2


def test_maps_are_kept_up_to_their_bytes(made: list[tuple[float, float]]) -> None:
    alone = ActiveCellMaps(VOXELS)
    alone.at(HALF)
    made.clear()
    maps = ActiveCellMaps(VOXELS, most=2 * alone.nbytes)
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
    cancelled = threading.Event()
    pieces = []
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
    assert len(pieces) == when, "it ends after the piece that is being made"
    again = maps.at(HALF)
    assert_same(again, ActiveCellMaps(VOXELS).at(HALF))
    assert maps.at(HALF, run) is again, "what is kept need not be made"


RAMP = np.broadcast_to(
    np.linspace(0.0, 1.0, 70, dtype=np.float32)[:, None, None], VOXELS.shape
).copy()


def ask(maps: ActiveCellMaps, isovalues: np.ndarray) -> int:
    """Have the maps of all groups of some isovalues; how many there are."""
    numbers, spans = maps.groups(isovalues)
    assert (spans[numbers, 0] <= isovalues).all() and (isovalues < spans[numbers, 1]).all()
    for number in np.unique(numbers):
        maps.covering(spans[number])
    return len(np.unique(numbers))


@pytest.mark.parametrize(
    ("most", "least", "groups"), [(1 << 30, 33, 33), (80_000, 5, 32), (1, 1, 1)]
)
def test_groups_widen_until_all_of_their_maps_are_kept(
    made: list[tuple[float, float]], most: int, least: int, groups: int
) -> None:
    maps = ActiveCellMaps(RAMP, most=most)
    isovalues = np.linspace(0.0, 1.0, 500)
    ask(maps, isovalues)
    while made:
        made.clear()
        settled = ask(maps, isovalues)
    assert least <= settled <= groups


def test_groups_stay_narrow_where_few_are_asked_for(made: list[tuple[float, float]]) -> None:
    maps = ActiveCellMaps(RAMP, most=80_000)
    isovalues = np.linspace(0.43, 0.51, 50)
    assert [ask(maps, isovalues) for _ in range(3)] == [3, 3, 3]
    assert len(made) == 3
    assert all(high - low == 2 * STEP for low, high in made)


def test_maps_that_are_large_beside_the_budget_lie_in_files(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
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


def test_dear_maps_reach_ever_farther(
    made: list[tuple[float, float]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("ISOGI_VOLUME_CACHE", str(tmp_path))
    monkeypatch.setattr(module, "budget", lambda: 1)
    maps = ActiveCellMaps(RAMP, most=0)
    for last in np.linspace(0.1, 1.0, 40):
        maps.covering(maps.groups(np.linspace(0.05, last, 20))[1][-1])
    assert [(low, high >= last) for low, high in made[-1:]] == [(made[0][0], True)]
    assert len(made) <= 6, "of 40 that were asked for"


def test_a_large_volume_is_measured_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("ISOGI_VOLUME_MB", "1")
    monkeypatch.setenv("ISOGI_VOLUME_CACHE", str(tmp_path))
    volume = make_volume(VOXELS)
    asked = list[str]()

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
    for one, other in zip(
        make_field(volume)[1:3], make_field(replace(volume, digest="other"))[1:3], strict=True
    ):
        np.testing.assert_array_equal(one, other)


# --- levels
# --------------------------------------------------------------------------------------------------


def crowd(voxels: np.ndarray) -> float:
    """The largest share of the voxels between two levels that follow each other."""
    return float(np.histogram(voxels, find_levels(voxels)[1:-1])[0].max() / voxels.size)


EVEN_FIELDS = {
    "even values": EVEN,
    "holes": np.where(EVEN < 0.3, np.float32(np.nan), EVEN),
    "a mask": (EVEN > 0.99).astype(np.float32),
    "four fifths in one group": np.where(EVEN < 0.8, EVEN / 100, EVEN),
}


@pytest.mark.parametrize("field", EVEN_FIELDS)
def test_fields_that_are_not_crowded_have_even_levels(field: str) -> None:
    assert find_levels(EVEN_FIELDS[field]).tolist() == EVEN_LEVELS


def test_levels_are_even_steps_from_0_to_1() -> None:
    """A map a thirtieth of the range wide makes rays much slower, and one of a 256th serves a
    single value of a byte.
    """
    low, zero, near, *steps, high = EVEN_LEVELS
    assert (low, zero, steps[-1], high) == (-np.inf, 0.0, 1.0, np.inf)
    assert 0.0 < near < 1e-6
    assert 40 <= len(steps) <= 128
    assert np.diff([0.0, *steps]) == pytest.approx(1.0 / len(steps))


def test_crowded_values_are_parted_by_rank() -> None:
    squeezed = EVEN / 100
    squeezed[0, 0, 0] = 1.0
    assert np.histogram(squeezed, EVEN_LEVELS[1:-1])[0].max() > 0.95 * squeezed.size
    assert crowd(squeezed) < 0.03
    levels = find_levels(squeezed)
    assert (np.diff(levels) > 0).all() and set(EVEN_LEVELS) <= set(levels.tolist())


def test_values_beyond_the_core_are_parted_too() -> None:
    assert crowd(EVEN * np.float32(1e30) + 2) < 0.03


def test_groups_are_two_levels_wide_and_hold_their_isovalues() -> None:
    for voxels in (EVEN, np.concatenate([EVEN / 100, EVEN[:1] + 1])):
        maps = ActiveCellMaps(voxels)
        isovalues = np.concatenate(
            [voxels.ravel()[::7].astype(np.float64), [-1e36, 0.0, 1.0, 1e36]]
        )
        groups, spans = maps.groups(isovalues)
        assert (spans[groups, 0] <= isovalues).all() and (isovalues < spans[groups, 1]).all()
        assert (
            set(spans.ravel().tolist()) <= set(maps.levels.tolist())
            and len(spans) <= len(maps.levels) // 2 + 1
        )


def test_empty_space_at_zero_is_in_no_map_of_isovalues_above() -> None:
    voxels = np.zeros((40, 40, 40), np.float32)
    voxels[18:22, 18:22, 18:22] = 1.0
    maps = ActiveCellMaps(voxels)
    groups, spans = maps.groups(np.array([1e-3, 0.999]))
    wide = maps.covering(np.array([spans[groups[0], 0], spans[groups[1], 1]]))
    assert np.count_nonzero((wide.tops >> 28) == 0) <= 27 < wide.tops.size


# --- idle voxels
# --------------------------------------------------------------------------------------------------


LOW = 0.45
HIGH = 0.5


def volume(holes: bool) -> np.ndarray:
    """Waves with an inside and an outside that are several voxels thick; (z, y, x) float32."""
    z, y, x = np.mgrid[:14, :17, :40]
    field = 0.5 + 0.4 * np.sin(0.16 * x) * np.cos(0.1 * y) + 0.02 * np.sin(3.0 * (x + y + z))
    values = field.astype(np.float32)
    if holes:
        values[4:6, 3:6, 8:12] = np.nan
    return values


def cells_of(values: np.ndarray) -> np.ndarray:
    """The eight corners of each cell; (8, z, y, x)."""
    nz, ny, nx = values.shape
    corners = [(k >> 2, k >> 1 & 1, k & 1) for k in range(8)]
    return np.stack([values[c : nz - 1 + c, b : ny - 1 + b, a : nx - 1 + a] for c, b, a in corners])


@pytest.mark.parametrize("holes", [False, True], ids=["whole", "holes"])
@pytest.mark.parametrize("layers", [3, 14])
def test_what_isosurfaces_of_the_range_read_stays(holes: bool, layers: int) -> None:
    values = volume(holes)
    idle = IdleVoxels(values, LOW, HIGH)
    slabs = [idle.flattened(a, min(a + layers, len(values))) for a in range(0, len(values), layers)]
    flat = np.concatenate(slabs)
    corners = cells_of(values)
    with np.errstate(invalid="ignore"):
        active = (corners.min(axis=0) <= HIGH) & (corners.max(axis=0) >= LOW)
    assert 0.05 < active.mean() < 0.6
    for z, y, x in np.argwhere(active).tolist():
        about = tuple(slice(max(i - 1, 0), i + 3) for i in (z, y, x))
        np.testing.assert_array_equal(flat[about], values[about])


@pytest.mark.parametrize("isovalue", [LOW, 0.48, HIGH])
def test_sides_and_holes_stay_where_voxels_are_idle(isovalue: float) -> None:
    values = volume(holes=True)
    flat = IdleVoxels(values, LOW, HIGH).flattened(0, len(values))
    np.testing.assert_array_equal(np.isnan(flat), np.isnan(values))
    np.testing.assert_array_equal(flat > isovalue, values > isovalue)
    changed = (flat != values) & ~np.isnan(values)
    assert changed.mean() > 0.2 and len(np.unique(flat[changed])) == 2


def test_a_volume_on_one_side_of_the_range_is_one_number() -> None:
    values = np.linspace(0.0, 0.3, 60, dtype=np.float32).reshape(3, 4, 5)
    assert np.unique(IdleVoxels(values, LOW, HIGH).flattened(0, 3)).tolist() == [np.float32(0.3)]


# --- voxel codes
# --------------------------------------------------------------------------------------------------


RNG = np.random.default_rng(3)


def numbers(low: int, high: int, kind: Any) -> np.ndarray:
    return RNG.integers(low, high, (6, 7, 9), endpoint=True).astype(kind)


@pytest.mark.parametrize("solid", ["above", "below"])
@pytest.mark.parametrize(
    ("array", "kind"),
    [
        (numbers(0, 255, np.uint8), "uint8"),
        (numbers(40, 90, np.uint8), "uint8"),
        (numbers(-128, 127, np.int8), "uint8"),
        (numbers(-1024, 3071, np.int16), "uint16"),
        (numbers(7_000_000, 7_000_200, np.int32), "uint8"),
        (numbers(0, 1 << 20, np.int32), "float32"),
        (RNG.normal(size=(6, 7, 9)).astype(np.float32), "float32"),
        (numbers(0, 255, np.uint8).astype(np.float32), "float32"),
    ],
)
def test_codes_are_voxels_exactly(array: np.ndarray, kind: str, solid: str) -> None:
    volume = make_volume(array, solid=solid)
    codes = find_codes(volume)
    found = codes.code(volume.voxels)
    assert (codes.kind, found.dtype) == (kind, np.dtype(kind))
    assert np.array_equal(
        (codes.base + codes.gain * found.astype(np.float64)).astype(np.float32), volume.voxels
    )
    assert codes.gain > 0.0 and np.log2(codes.gain) % 1.0 == 0.0
    assert codes.nbytes == found.nbytes


def test_codes_keep_the_side_of_an_isovalue() -> None:
    """Also of isovalues that are voxels themselves, and where what is below is solid."""
    array = numbers(3, 250, np.uint8)
    for solid in ("above", "below"):
        volume = make_volume(array, solid=solid)
        codes = find_codes(volume)
        for isovalue in (3.0, 70.0, 70.5, 250.0):
            level = float(volume.normalise_isovalue(isovalue))
            inside = codes.code(volume.voxels) > (level - codes.base) / codes.gain
            assert np.array_equal(inside, volume.voxels > level)


def test_holes_are_a_number_below_all_others() -> None:
    array = RNG.normal(size=(6, 7, 9)).astype(np.float32)
    array[2, 3, 4] = np.nan
    volume = make_volume(array)
    codes = find_codes(volume)
    found = codes.code(volume.voxels)
    assert codes.hole is not None and found[2, 3, 4] == np.float32(codes.hole)
    assert np.isfinite(found).all() and (found < -1e30).sum() == 1


def test_holes_among_whole_numbers_stay_apart() -> None:
    array = numbers(0, 250, np.uint8)
    array[1, 2, 3] = 7
    volume = make_volume(array, missing=[7.0])
    codes = find_codes(volume)
    assert codes.kind == "float32"
    assert (codes.code(volume.voxels) < -1e30).sum() == volume.holes > 0


def test_slabs_are_all_layers_once() -> None:
    for shape in ((128, 256, 256), (7, 3000, 3000), (1000, 4, 4)):
        codes = VoxelCodes("uint8", 1.0, 0.0, None, shape)
        assert [z for a, b in codes.slabs for z in range(a, b)] == list(range(shape[0]))
        assert all(
            (b - a) * shape[1] * shape[2] <= max(6 << 20, shape[1] * shape[2])
            for a, b in codes.slabs
        )
    large = VoxelCodes("uint8", 1.0, 0.0, None, (128, 256, 256))
    assert len(large.slabs) <= 8, "each is an answer to a request"
