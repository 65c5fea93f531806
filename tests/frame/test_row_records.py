"""Records that are kept while a camera moves alone: the same pictures, to the bit, and nothing kept for nothing."""

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from isogi_core.cache.page_pool import Held
from isogi_core.frame import row_records
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.row_records import ENTRY, RowRecords
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.irradiance_ratio import GRADE, RECORD
from isogi_core.model.view import View, quaternion_from_angles
from tests.frame.conftest import SKY, Workbench
from tests.loaded import load_scene

Make = Callable[..., Workbench]
TARGET = 0.3
TURN = quaternion_from_angles(70.0, 20.0, -10.0)


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Workbench:
    """An orbital under a sky whose albedo may change, seen from four sides, all final at TARGET."""
    scene = load_scene("demo:orbital", lights=[SKY], bounces=2, target_error=TARGET, lattice=0.5, projected=False)
    bench = Workbench(scene, tmp_path_factory.mktemp("records"))
    for view in around(bench):
        bench.bake(view)
    return bench


def around(bench: Workbench, **settings: Any) -> list[View]:
    """Views by a camera that is turned on step by step."""
    return [bench.view(azimuth, size=48, **settings) for azimuth in (40.0, 44.0, 48.0, 52.0)]


def same(bench: Workbench, renderer: Renderer, view: View, target: float = TARGET) -> bool:
    """Whether a picture is what a renderer that has kept nothing shows of the view."""
    one, other = renderer.render(view, target), Renderer(bench.caches, Tiles(1)).render(view, target)
    equal = [np.array_equal(a, b) for a, b in zip(one.framebuffer, other.framebuffer, strict=True)]
    return all(equal) and one.version == other.version


@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("threads", [1, 3])
def test_a_camera_that_moves_alone_sees_the_same(bench: Workbench, moving: bool, threads: int) -> None:
    renderer = Renderer(bench.caches, Tiles(threads))
    views = around(bench, moving=moving)
    for view in (*views, *reversed(views)):
        assert same(bench, renderer, view)
    assert renderer._texels._records.nbytes > 0


def test_another_light_takes_the_place_of_the_first(bench: Workbench) -> None:
    renderer = Renderer(bench.caches, Tiles(1))
    first, second, third, fourth = around(bench)
    for view in (first, second, replace(third, light=TURN), replace(fourth, light=TURN), replace(first, light=TURN)):
        assert same(bench, renderer, view)
    assert same(bench, renderer, first) and same(bench, renderer, second) and same(bench, renderer, third)


def test_a_moving_light_has_nothing_kept(bench: Workbench) -> None:
    renderer = Renderer(bench.caches, Tiles(1))
    view = around(bench)[0]
    for yaw in range(4):
        renderer.render(replace(view, light=quaternion_from_angles(10.0 * yaw, 0.0, 0.0)), TARGET)
    assert renderer._texels._records.nbytes == 0


def test_light_that_came_since_is_read(workbench: Make) -> None:
    scene = load_scene("demo:orbital", lights=[SKY], bounces=1, target_error=0.5, lattice=0.5, projected=False)
    bench = workbench(scene)
    first, second = around(bench)[:2]
    bench.bake(first, 0.5)
    bench.bake(second, 0.5)
    for view in (first, second, first):
        assert same(bench, bench.renderer, view, 0.5)
    taken = bench.renderer._texels._records.nbytes
    bench.bake(second, 0.05)
    assert same(bench, bench.renderer, second, 0.05) and same(bench, bench.renderer, second, 0.5)
    assert same(bench, bench.renderer, first, 0.5) and bench.renderer._texels._records.nbytes >= taken > 0


def test_rows_beyond_the_budget_are_found_each_time(bench: Workbench) -> None:
    renderer = Renderer(bench.caches, Tiles(1))
    renderer._texels._records = few = RowRecords(300 * ENTRY)
    for view in (*around(bench), *around(bench)):
        assert same(bench, renderer, view)
    assert 0 < few.nbytes <= 300 * ENTRY < len(bench.caches.of("gi").pool.scatter) * ENTRY


def test_a_thread_that_would_wait_finds_its_own(bench: Workbench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Records of one frame are not told to another that asks meanwhile; both show the same."""
    renderer, recall = Renderer(bench.caches, Tiles(1)), row_records.recall_records
    view = around(bench)[0]
    inside, go = threading.Event(), threading.Event()

    def slowly(*given: Any) -> None:
        inside.set()
        assert go.wait(30)
        recall(*given)

    renderer.render(view, TARGET)
    monkeypatch.setattr(row_records, "recall_records", slowly)
    drawing = threading.Thread(target=renderer.render, args=[view, TARGET])
    drawing.start()
    assert inside.wait(30)
    other = renderer.render(view, TARGET)
    go.set()
    drawing.join(30)
    assert np.array_equal(other.radiance, Renderer(bench.caches, Tiles(1)).render(view, TARGET).radiance)


def test_texels_without_a_row_have_a_grade_alone(bench: Workbench) -> None:
    """Those that are void or buried; and what is not kept is asked for once."""
    rows, grade = np.array([3, -2, 0, 9, -3], np.int32), np.array([3, 5, 3, 3, 4], np.uint8)
    reading: Any = type("Found", (), {"rows": rows, "grade": grade})()
    pool: Any = type("Pool", (), {"written": np.full(16, 7, np.int32)})()
    records, asked, held = RowRecords(6 * ENTRY), list[list[int]](), Held(np.empty(0, np.int32), 7)

    def fill(new: np.ndarray) -> np.ndarray:
        asked.append(new.tolist())
        found = np.repeat(rows[new].astype(np.float32)[:, None], RECORD, axis=1)
        found[:, GRADE] = grade[new]
        return found

    for expected in ([0, 2, 3], [3], [3]):
        found = records.of("light", reading, pool, held, fill, Tiles(1))
        assert found is not None and asked[-1] == expected
        assert np.array_equal(found[:, GRADE], grade) and np.array_equal(found[:, 0], [3, 0, 0, 9, 0])
    pool.written[3] = 8
    records.of("light", reading, pool, Held(held.slots, 8), fill, Tiles(1))
    assert asked[-1] == [0, 3]
    records.of("other", reading, pool, held, fill, Tiles(1))
    assert asked[-1] == [0, 2, 3]
