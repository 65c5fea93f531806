"""The time left counts the paths that pixels take of their own."""

from dataclasses import replace

import pytest

from isogi_core.bake.noise import Goal
from isogi_core.cache.costs import Cost
from isogi_core.frame.refinement import PathsLeft
from isogi_core.frame.view_checks import WorkLeft
from isogi_core.plan.assembly import load_scene
from isogi_core.plan.scene import Scene
from isogi_server.render.engine import RenderEngine
from isogi_server.render.time_left import time_of_parts, time_of_paths
from isogi_worker.progress import TimeLeft
from tests.server.inline import LONG, view_of

TARGET = 0.05


@pytest.fixture(scope="module")
def scene() -> Scene:
    """So few texels that light between them is wrong by far more than its noise."""
    constant = [{"type": "constant"}]
    return load_scene(
        "demo:casting",
        lights=constant,
        lattice=0.3,
        bounces=1,
        projected=False,
        target_error=TARGET,
    )


def time_of(left: PathsLeft) -> TimeLeft:
    """The time on two threads after 400 paths of texels took 2 seconds."""
    return time_of_paths(left, Cost(seconds=2.0, paths=400), 2, {})


def test_a_path_takes_a_share_of_those_of_texels_at_first() -> None:
    texels, pixels = time_of(PathsLeft(texels=1000.0)), time_of(PathsLeft(1000.0))
    assert texels.likely == pytest.approx(1000.0 * 2.0 / 400 / 2)
    assert 1.5 <= texels.likely / pixels.likely <= 6.0
    both = time_of(PathsLeft(3000.0, 1000.0))
    assert both.likely == pytest.approx(texels.likely + 3.0 * pixels.likely)
    assert both.low < both.likely < both.high


def test_first_light_does_not_make_later_paths_longer() -> None:
    """Half of 800 paths were the first of 25 texels, and took four fifths of the time."""
    left = time_of_paths(PathsLeft(texels=400.0), Cost(10.0, 800, 25, 8.0), 2, {})
    assert left.likely == pytest.approx(400.0 * 2.0 / 400 / 2)


def test_a_path_takes_as_long_as_the_pixels_last_ones() -> None:
    left, unsure = time_of(PathsLeft(1000.0, pace=0.01)), time_of(PathsLeft(1000.0))
    assert left.likely == pytest.approx(10.0)
    assert left.high / left.likely < unsure.high / unsure.likely


def test_each_drawing_of_the_picture_takes_its_time() -> None:
    drawing = {"primary": 0.25, "shade": 0.5, "bake": 9.0, "queue": 9.0}
    left = time_of_paths(PathsLeft(100.0, times=3, pace=0.01), Cost(), 2, drawing)
    assert left.likely == pytest.approx(1.0 + 3 * 0.75)


def test_parts_of_a_picture_are_priced_by_each_other() -> None:
    """A part of which no path was timed takes the pace of the other one; a part whose texels took
    no paths takes the time of the other one's.
    """
    lit, unlit = PathsLeft(1000.0, pace=0.01), PathsLeft(500.0, 200.0, times=1)
    left = time_of_parts([lit, unlit], [Cost(4.0, 100), Cost()], 2, {"shade": 0.5})
    assert left.likely == pytest.approx(1500.0 * 0.01 + 200.0 * 4.0 / 100 / 2 + 0.5)
    none = time_of_parts([], [], 2, {})
    assert none == TimeLeft(0.0, 0.0, 0.0)


def test_paths_of_irradiance_take_as_long_as_those_of_pixels() -> None:
    left = time_of_parts([PathsLeft(100.0)], [Cost(4.0, 100)], 2, {}, heavier=1.0)
    assert left.likely == pytest.approx(2.0)


def test_texels_take_their_paths_for_each_kind_of_light() -> None:
    work = WorkLeft(PathsLeft(10.0, 100.0), light=(None, None))
    assert work.paths == PathsLeft(10.0, 200.0)
    known = replace(work, known=lambda: PathsLeft(3.0, 5.0))
    assert known.paths == PathsLeft(3.0, 10.0), "a check knows better"


def test_times_of_two_works_add_up() -> None:
    assert TimeLeft(1.0, 2.0, 3.0).plus(TimeLeft(10.0, 20.0, 30.0)) == TimeLeft(11.0, 22.0, 33.0)


@pytest.mark.slow
def test_a_picture_tells_the_time_until_its_pixels_have_light(
    engine: RenderEngine, scene: Scene
) -> None:
    view = view_of(scene)
    goal = Goal.checked(0.02)
    checks = engine.renderer(scene.id).surface.checks
    while (frame := engine.survey(scene.id, view, goal)).provisional:
        engine.frame(scene.id, view, goal=goal, wait=0.05)
    told = []
    checks.decline_finer(view, goal)
    while not (frame := engine.survey(scene.id, view, goal)).final:
        assert engine.check(scene.id, view, goal)
        check = checks.held(view, goal)
        if check is not None and check.growing:
            told.append(
                (
                    checks.work_left(frame, goal).paths.pixels,
                    engine.time_left(scene.id, frame, goal),
                )
            )
    assert len(told) > 1 and told[0][0] > told[-1][0] > 0.0
    assert all(left is not None and left.likely > 0.0 for _, left in told)
    assert engine.time_left(scene.id, frame, goal) == TimeLeft(0.0, 0.0, 0.0)


def test_paths_are_foreseen_before_light_is_final(engine: RenderEngine, scene: Scene) -> None:
    view = view_of(scene)
    goal = Goal.checked(scene.target_error / 4.0)
    engine.frame(scene.id, view, goal=Goal.checked(0.5), wait=LONG)
    frame = engine.survey(scene.id, view, goal)
    work_left = engine.renderer(scene.id).surface.checks.work_left
    least = work_left(frame, goal).paths.pixels
    worse = replace(frame.quality, expected=2.0 * goal.error)
    assert work_left(replace(frame, quality=worse), goal).paths.pixels > least
