"""Pictures that paths of their pixels light, in place of texels that are not baked yet."""

from dataclasses import replace

import numpy as np
import pytest

from isogi_core.bake.noise import Goal
from isogi_core.frame import frame as frames
from isogi_core.frame.frame import Frame
from isogi_core.frame.rays.own_light import (
    Growth,
    PixelLight,
    all_points,
    paths_alone,
)
from isogi_core.frame.rays.picture_plan import Prices
from isogi_core.frame.renderer import Renderer
from isogi_core.model.view import View
from tests.frame.conftest import SKY, Workbench, true_error
from tests.loaded import load_scene

TARGET = 0.03
SIZE = 96
GOAL = Goal.checked(TARGET)


@pytest.fixture
def bench(tmp_path: pytest.TempPathFactory) -> Workbench:
    """A surface without light, of many more texels than its pictures have pixels."""
    scene = load_scene("demo:orbital", lights=[SKY], bounces=2, lattice=2, target_error=TARGET)
    return Workbench(scene, tmp_path)


@pytest.fixture(autouse=True)
def dear(monkeypatch: pytest.MonkeyPatch) -> None:
    """Texels of small volumes count, although a person hardly waits for them."""
    monkeypatch.setattr(frames, "QUICK_TEXELS", 0)


def lit(bench: Workbench, view: View) -> Frame:
    """The picture of a view when its check has ended; nothing is baked."""
    while bench.renderer.refine(view, GOAL, prices=Prices()):
        pass
    return bench.renderer.render(view, GOAL)


def test_paths_light_a_picture_whose_texels_cost_more(bench: Workbench) -> None:
    """It is final without texels, and its error is as told."""
    view = bench.view(size=SIZE)
    first = bench.renderer.render(view, GOAL)
    assert first.undecided and first.checkable and first.provisional
    frame = lit(bench, view)
    assert frame.final and frame.goes_without_texels and not frame.stages
    assert frame.quality.known is not None and frame.quality.known.covers
    assert frame.total.high <= TARGET
    assert true_error(bench, frame) < 1.2 * TARGET
    assert not bench.layers, "nothing was baked"


def test_each_step_is_shown(bench: Workbench) -> None:
    """All pixels have light after the first of them, and are not final before the last."""
    view = bench.view(size=SIZE)
    goal = Goal.checked(TARGET / 2.0)
    assert bench.renderer.refine(view, goal), "decides"
    errors = []
    while bench.renderer.refine(view, goal):
        frame = bench.renderer.render(view, goal)
        assert not frame.provisional
        errors.append(frame.noise)
        if not frame.final:
            assert frame.counts["final"] == 0
    assert len(errors) > 3 and errors[0] > 1.5 * errors[-1]


def test_the_same_light_comes_again(bench: Workbench) -> None:
    """A server that was started anew shows the same picture."""
    view = bench.view(size=SIZE)
    once = lit(bench, view)
    again = lit(bench.again(), view)
    assert once.version == again.version
    assert (once.radiance == again.radiance).all()


def test_texels_come_first_where_they_are_to_be_baked(bench: Workbench) -> None:
    """A prewarm fills the store; a picture for others reads texels."""
    view = bench.view(size=SIZE)
    for prices in (Prices().of_texels, Prices(0.25, 0.0).of_present.of_texels):
        bench.renderer.forget_views()
        assert bench.renderer.refine(view, GOAL, prices=prices)
        frame = bench.renderer.render(view, GOAL)
        assert not frame.goes_without_texels and not frame.undecided and frame.stages


def test_texels_come_first_if_they_are_quick(
    bench: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They light later views at once, and nobody feels the time that they take."""
    monkeypatch.undo()
    frame = bench.renderer.render(bench.view(size=16), GOAL)
    assert not frame.undecided and not frame.checkable and frame.stages


def test_texels_come_first_if_pixels_take_more_paths(bench: Workbench) -> None:
    """A strict target takes many paths of each pixel; texels take a few, and serve all pixels."""
    view = bench.view(size=4 * SIZE)
    strict = Goal.checked(0.002)
    assert bench.renderer.refine(view, strict)
    assert bench.renderer.render(view, strict).stages


def test_tasks_of_texels_have_a_price(bench: Workbench) -> None:
    """Where tasks are dear, paths light a picture whose texels would come first otherwise."""
    view = bench.view(size=4 * SIZE)
    strict = Goal.checked(0.002)
    assert bench.renderer.refine(view, strict, prices=Prices(task=1e12))
    assert bench.renderer.render(view, strict).goes_without_texels


def test_a_picture_with_all_its_texels_has_nothing_to_decide(bench: Workbench) -> None:
    """It is measured, as ever."""
    frame = bench.bake(bench.view(size=32))
    assert not frame.undecided and not frame.goes_without_texels


def test_a_view_beside_another_begins_with_its_light(bench: Workbench) -> None:
    """It traces fewer paths than alone."""
    lit(bench, bench.view(azimuth=40.0, size=SIZE))
    view = bench.view(azimuth=41.0, size=SIZE)
    bench.renderer.refine(view, GOAL)
    begun = bench.renderer.render(view, GOAL)
    assert begun.goes_without_texels and begun.quality.known is not None
    assert len(begun.quality.known.carried) > 0.2 * len(begun.gbuffer.pixels)
    assert begun.provisional, "other pixels have no light yet"
    after = lit(bench, view)
    alone = Renderer(bench.again().caches, bench.renderer.tiles)
    while alone.refine(view, GOAL):
        pass
    assert after.final and true_error(bench, after) < 1.2 * TARGET
    assert paths_of(after) < paths_of(alone.render(view, GOAL))


def paths_of(frame: Frame) -> int:
    """Paths that pixels of a picture took for themselves."""
    known = frame.quality.known
    assert known is not None
    own = np.isin(known.own.places, known.carried, invert=True)
    return int(known.own.estimate.counts[own].sum())


def test_dropped_light_is_traced_anew(bench: Workbench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pixels that lost the light of other views get some of their own, and keep the old one until
    then.
    """
    lit(bench, bench.view(azimuth=40.0, size=SIZE))
    # Paths end before the picture is at its target, and carried light is dropped at once.
    monkeypatch.setattr("isogi_core.frame.rays.own_light.AIM_OF_PATHS", 1.5)
    monkeypatch.setattr("isogi_core.frame.rays.picture_check.CARRIED_ATTEMPTS_BY_PATHS", 0)
    view = bench.view(azimuth=41.0, size=SIZE)
    stricter = Goal.checked(0.02)
    carried = []
    lacking = []
    while bench.renderer.refine(view, stricter):
        frame = bench.renderer.render(view, stricter)
        assert frame.quality.known is not None
        carried.append(len(frame.quality.known.carried))
        lacking.append(frame.provisional)
    assert carried[0] > 0.2 * len(frame.gbuffer.pixels) and carried[-1] == 0
    dropped = carried.index(0)
    assert lacking[0] and not any(lacking[dropped - 1 :]), "none is dark while it waits"
    assert frame.final and frame.quality.known is not None and frame.quality.known.covers


@pytest.mark.parametrize("settings", [{"shading": "vicinity"}, {"moving": True}])
def test_other_pictures_read_texels(bench: Workbench, settings: dict[str, object]) -> None:
    """Those without control pixels, and those that move."""
    view = bench.view(size=32, **settings)
    frame = bench.renderer.render(view, GOAL)
    assert not frame.undecided and frame.stages


def test_steps_grow_from_few_paths() -> None:
    """The first is short; points that joined late catch up in several steps."""
    choice = all_points(2, 0.05, 0.02, 1.0, 0.5)
    growth = Growth(choice, PixelLight.none(), shown=True)
    assert growth.next.tolist() == [8, 8]
    known = replace(
        PixelLight.none(), places=np.arange(2), light=np.ones((2, 3)), variance=np.ones(2)
    )
    for counts, expected in (
        ([8, 60], [32, 60]),
        ([32, 60], [60, 60]),
        ([8, 8], [32, 32]),
    ):
        estimate = replace(
            PixelLight.none().estimate, sums=np.zeros((2, 2, 3)), counts=np.array(counts)
        )
        light = replace(known, estimate=estimate)
        growth = Growth(choice, light, shown=True, earlier=np.array([1]))
        assert growth.next.tolist() == expected


def test_noise_is_compared_with_the_light_that_is_shown() -> None:
    """Its mean is known better than that of the few controls by which the light was chosen."""
    choice = all_points(2, 0.05, 0.02, 1.0, 0.5)
    light = replace(PixelLight.none(), places=np.arange(2), light=np.full((2, 3), 3.0))
    assert choice.allowed(light) == pytest.approx(9.0 * choice.variance)


def test_all_points_are_foreseen_at_the_paths_of_their_choice() -> None:
    """The two predictions agree. The filter adds a bias of up to 0.7 of the noise, so the noise is
    to be below 0.82 of the target.
    """
    choice = all_points(1000, 0.05, 0.02, 2.0, 0.7)
    assert choice.paths == pytest.approx(paths_alone(1000, 0.7, 0.02))
    assert 0.5 * 0.02 < np.sqrt(choice.variance / 1000) / 2.0 < 0.82 * 0.02
    assert (choice.errors == 0.1).all()
