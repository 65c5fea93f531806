import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from isogi_core.bake import maps as module
from isogi_core.bake.levels import PARTS
from isogi_core.bake.maps import LAYERS, Maps, Piece, serially
from isogi_core.errors import Cancelled
from isogi_core.frame.tiles import Tiles
from isogi_core.kept import OVERHEAD
from isogi_core.kernels.bricks import Bricks, brick_ranges, make_bricks

STEP = 1.0 / PARTS
VOXELS = np.random.default_rng(1).random((70, 21, 34)).astype(np.float32)


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[tuple[float, float]]:
    """The ranges that maps are made for."""
    made = []

    def counted(voxels: np.ndarray, ranges: object, lowest: float, highest: float, run: object) -> Bricks:
        made.append((lowest, highest))
        return make_bricks(voxels, ranges, lowest, highest, run)

    monkeypatch.setattr(module, "make_bricks", counted)
    return made


def assert_same(one: Bricks, other: Bricks) -> None:
    """Two maps are equal."""
    assert np.array_equal(one.tops, other.tops)
    assert np.array_equal(one.cells, other.cells)


def test_a_map_is_that_of_the_whole_step() -> None:
    bricks = Maps(VOXELS).get(0.5 + STEP / 3, 0.5 + STEP / 2)
    expected = make_bricks(VOXELS, brick_ranges(VOXELS), 0.5, 0.5 + STEP)
    assert_same(bricks, expected)
    assert np.array_equal(bricks.margins, expected.margins)
    assert bricks.shape == expected.shape


@pytest.mark.parametrize(
    ("lowest", "highest", "steps"),
    [(0.0, 0.0, (0, 1)), (1.0, 1.0, (64, np.inf)), (0.51, 0.51, (32, 33)), (0.5, 0.51, (32, 33)),
     (0.49, 0.51, (31, 33)), (-0.01, 0.0, (-np.inf, 0)), (0.5, 0.53125, (32, 34)), (1e30, 1e36, (64, np.inf))],
)  # fmt: skip
def test_ranges_are_widened_to_levels_and_no_farther(
    made: list[tuple[float, float]], lowest: float, highest: float, steps: tuple[int, int]
) -> None:
    Maps(VOXELS).get(lowest, highest)
    assert made == [(steps[0] * STEP, steps[1] * STEP)]


def test_near_isovalues_share_a_map(made: list[tuple[float, float]]) -> None:
    maps = Maps(VOXELS)
    assert maps.get(0.501, 0.501) is maps.get(0.505, 0.505)
    assert maps.get(0.521, 0.521) is not maps.get(0.505, 0.505)
    assert len(made) == 2


def test_maps_are_kept_up_to_their_bytes(made: list[tuple[float, float]]) -> None:
    size = Maps(VOXELS).get(0.5, 0.5).nbytes
    made.clear()
    maps = Maps(VOXELS, most=2 * (size + OVERHEAD))
    for isovalue in (0.1, 0.5, 0.1, 0.9, 0.1, 0.5):
        maps.get(isovalue, isovalue)
    assert [round(lowest, 1) for lowest, _ in made] == [0.1, 0.5, 0.9, 0.5]
    least = Maps(VOXELS, most=0)
    assert least.get(0.5, 0.5) is least.get(0.5, 0.5)


def test_threads_that_want_one_map_make_it_once(made: list[tuple[float, float]]) -> None:
    maps = Maps(VOXELS)
    with ThreadPoolExecutor(8) as threads:
        first, *others = threads.map(lambda _: maps.get(0.5, 0.5), range(32))
    assert all(each is first for each in others)
    assert len(made) == 1


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_many_threads_make_the_same_map(threads: int) -> None:
    tiles = Tiles(threads)
    one, other = Maps(VOXELS).get(0.5, 0.6), Maps(VOXELS, tiles.run).get(0.5, 0.6)
    tiles.close()
    assert_same(one, other)


@pytest.mark.parametrize("when", [0, 2])
def test_a_map_that_nobody_waits_for_is_dropped_and_can_be_made_later(when: int) -> None:
    cancelled, pieces = threading.Event(), []

    def run(piece: Piece, total: int, size: int, cancelled: threading.Event | None = None) -> None:
        def counted(first: int, last: int) -> None:
            pieces.append(first)
            piece(first, last)
            if cancelled is not None and len(pieces) == when:
                cancelled.set()

        serially(counted, total, size, cancelled)

    maps = Maps(VOXELS, run)
    if not when:
        cancelled.set()
    with pytest.raises(Cancelled):
        maps.get(0.5, 0.5, cancelled)
    assert pieces == list(range(0, when * LAYERS, LAYERS))
    again = maps.get(0.5, 0.5)
    assert_same(again, Maps(VOXELS).get(0.5, 0.5))
    assert maps.get(0.5, 0.5, cancelled) is again, "what is kept need not be made"


RAMP = np.broadcast_to(np.linspace(0.0, 1.0, 70, dtype=np.float32)[:, None, None], VOXELS.shape).copy()


def ask(maps: Maps, isovalues: np.ndarray) -> int:
    """Have the maps of all groups of some isovalues; how many there are."""
    numbers, ends = maps.groups(isovalues)
    assert (ends[numbers] <= isovalues).all() and (isovalues < ends[numbers + 1]).all()
    for number in np.unique(numbers):
        maps.get(float(ends[number]), float(ends[number + 1]))
    return len(np.unique(numbers))


@pytest.mark.parametrize(("most", "least", "groups"), [(1 << 30, 33, 33), (80_000, 5, 32), (1, 1, 1)])
def test_groups_become_so_wide_that_all_of_their_maps_are_kept(
    made: list[tuple[float, float]], most: int, least: int, groups: int
) -> None:
    maps, isovalues = Maps(RAMP, most=most), np.linspace(0.0, 1.0, 500)
    assert ask(maps, isovalues) >= 33
    while made:
        made.clear()
        settled = ask(maps, isovalues)
    assert least <= settled <= groups


def test_groups_stay_narrow_where_few_are_asked_for(made: list[tuple[float, float]]) -> None:
    maps, isovalues = Maps(RAMP, most=80_000), np.linspace(0.41, 0.49, 50)
    assert [ask(maps, isovalues) for _ in range(3)] == [3, 3, 3]
    assert len(made) == 3
    assert all(high - low == 2 * STEP for low, high in made)
