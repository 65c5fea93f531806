"""Control pixels tell a picture's whole error, and the cheapest way to its target is taken."""

import math
import threading
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.noise import Goal
from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.errors import Cancelled
from isogi_core.files.radiance import write_hdr
from isogi_core.frame.demand import first_texels
from isogi_core.frame.frame import Frame, Quality
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.control_pixels import (
    ControlPixels,
    TotalError,
    chances,
    draw_places,
    measure_total,
    trace_controls,
)
from isogi_core.frame.rays.own_light import Choice
from isogi_core.frame.rays.picture_check import PictureCheck
from isogi_core.frame.rays.picture_plan import (
    Ahead,
    PixelLightCost,
    Plan,
    Prices,
    by_finer,
    by_rungs,
    climbs_of,
    controls_to,
    noise_of_climbers,
    rungs_at_once,
    until_decided,
)
from isogi_core.frame.rays.picture_state import PictureState
from isogi_core.frame.texel_reading import Reading, grade_rows
from isogi_core.kernels.shading.framebuffer import FINAL
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.model.view import View
from isogi_core.model.volume import make_volume
from isogi_core.plan.assembly import load_scene
from isogi_core.reference import Reference, trace_reference
from tests.frame.conftest import CONSTANT, SKY, Workbench, luminance, refine_chunk, scene_of

Make = Callable[..., Workbench]
TARGET = 0.05

WAITED_FOR = Prices().of_present
"""Prices of a picture that somebody waits for."""

PATHS_ALONE = Prices(0.25, 0.0, carries=False).of_present.of_texels
"""Prices at which paths of texels cost less than those of pixels, and tasks nothing."""


def checked(bench: Workbench, view: View, target: float | None = None) -> Frame:
    """The frame of a view once its light is baked and its picture checked to the end."""
    bench.bake(view, target)
    bench.project(view, target)
    return bench.settled(view, target)


@pytest.fixture(scope="module")
def coarse(tmp_path_factory: pytest.TempPathFactory) -> Workbench:
    """The casting with so few texels that light between them is wrong by far more than its
    noise.
    """
    scene = load_scene(
        "demo:casting", lights=[CONSTANT], lattice=0.3, projected=False, target_error=TARGET
    )
    return Workbench(scene, tmp_path_factory.mktemp("coarse"))


# --- the estimate
# -----------------------------------------------------------------------------------------------


def drawn(
    rng: np.random.Generator, wrong: np.ndarray, uncertainty: np.ndarray, count: int
) -> np.ndarray:
    """Weighted squares of controls whose halves have noise of their own, of a picture that is
    ``wrong`` (m,).
    """
    chance = chances(uncertainty)
    places = rng.choice(len(wrong), count, p=chance)
    halves = rng.normal(0.0, 0.3, (count, 2))
    controls = ControlPixels(places, 1.0 / (len(wrong) * chance[places]), halves)
    return np.asarray(controls.weights * controls.squares(wrong[places]))


def test_squares_are_right_on_the_average() -> None:
    """Some pixels err much: neither where controls are drawn nor the noise of their paths changes
    the mean.
    """
    rng = np.random.default_rng(3)
    wrong = np.where(rng.random(4000) < 0.05, 1.0, 0.1) * rng.normal(size=4000)
    for uncertainty in (np.zeros(4000), np.abs(wrong), rng.random(4000)):
        squares = drawn(rng, wrong, uncertainty, 200_000)
        apart = (squares.mean() - (wrong**2).mean()) / (squares.std() / math.sqrt(len(squares)))
        assert abs(apart) < 4.0


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    rng = np.random.default_rng(4)
    wrong = np.where(rng.random(4000) < 0.1, 1.0, 0.2) * rng.normal(size=4000)
    true = math.sqrt((wrong**2).mean())
    totals = [measure_total(drawn(rng, wrong, np.abs(wrong) + 0.2, 256), 2.0) for _ in range(400)]
    assert 0.9 < np.mean([each.low <= true / 2.0 <= each.high for each in totals]) < 0.99
    assert np.median([each.likely for each in totals]) == pytest.approx(true / 2.0, rel=0.05)


def test_controls_are_drawn_where_it_is_uncertain(coarse: Workbench) -> None:
    gbuffer = coarse.renderer.gbuffer(coarse.view(size=48))
    points = len(gbuffer.points)
    uncertainty = np.where(np.arange(points) < points // 10, 1.0, 0.0)
    places = draw_places(gbuffer, uncertainty, (0, 0), 400)
    assert np.mean(places < points // 10) == pytest.approx(0.55, abs=0.03)
    assert np.array_equal(places, draw_places(gbuffer, uncertainty, (0, 0), 400))
    assert not np.array_equal(places, draw_places(gbuffer, uncertainty, (0, 256), 400))
    even = draw_places(gbuffer, np.zeros(points), (1, 0), points // 4)
    assert np.histogram(even, 4)[0] == pytest.approx(points / 16, rel=0.2)


def true_error(frame: Frame, true: Reference) -> float:
    """Relative RMSE of a frame's luminance, by a reference of the same view."""
    light = true.mean[true.on].astype(float) @ LUMINANCE_WEIGHTS
    return float(np.sqrt(((luminance(frame) - light) ** 2).mean()) / light.mean())


def true_tail(frame: Frame, true: Reference) -> float:
    """The relative error that 99 % of a frame's pixels stay below, by a reference of the same
    view.
    """
    light = true.mean[true.on].astype(float) @ LUMINANCE_WEIGHTS
    return float(np.percentile(np.abs(luminance(frame) - light), 99.0) / light.mean())


# --- the picture
# ------------------------------------------------------------------------------------------------


def test_a_picture_reaches_its_target_by_light_of_its_pixels(coarse: Workbench) -> None:
    view = coarse.view(size=48)
    lit = coarse.bake(view)
    assert not lit.provisional and not lit.final and lit.checkable and lit.total.predicted
    true = trace_reference(coarse.renderer, view, 512)
    assert true_error(lit, true) > 1.5 * TARGET > 1.5 * lit.noise
    assert coarse.renderer.refine(view)
    told = coarse.renderer.render(view)
    assert not told.final and told.total.controls == 256 and told.version == lit.version
    assert told.total.low < true_error(lit, true) < told.total.high
    assert told.tail is not None and lit.tail is None
    assert told.tail.low < true_tail(lit, true) < told.tail.high
    assert told.tail.likely == pytest.approx(true_tail(lit, true), rel=0.4)
    frame = checked(coarse, view)
    assert frame.final and frame.total.high <= TARGET
    assert true_error(frame, true) < TARGET
    assert not coarse.renderer.refine(view)


def test_pixels_with_light_of_their_own_make_regions(coarse: Workbench) -> None:
    """Their light is another than that of texels, so that each border is a step: there are few."""
    frame = checked(coarse, coarse.view(size=48))
    assert frame.quality.known
    places = frame.quality.known.own.places
    own = np.zeros(frame.state.shape, bool)
    own.ravel()[frame.gbuffer.pixels[places]] = True
    on = frame.state > 0
    down = (own[1:] != own[:-1]) & on[1:] & on[:-1]
    across = (own[:, 1:] != own[:, :-1]) & on[:, 1:] & on[:, :-1]
    assert len(places) > 300
    assert down.sum() + across.sum() < 0.5 * len(places)


def test_a_picture_with_outliers_is_not_final(
    coarse: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever its total error: some of its pixels are far from the truth."""
    frame = checked(coarse, coarse.view(azimuth=20.0, size=32))
    assert frame.final and frame.tail is not None
    monkeypatch.setattr(Frame, "tail", replace(frame.tail, likely=10.0 * TARGET))
    assert not replace(frame).final and replace(frame).checkable
    # Of normally distributed errors 99 % stay below 2.6 times their root mean square.
    monkeypatch.setattr(Frame, "tail", replace(frame.tail, likely=2.6 * TARGET))
    assert replace(frame).final


def climbed(bench: Workbench, view: View, target: float) -> list[Frame]:
    """The frames of a view whose texels take as many samples as its check asks for, step by step to
    the end.

    A rung costs its paths alone: of small pictures the tasks would cost more.
    """
    frames = [baked_so_far(bench, view, target)]
    while bench.renderer.refine(view, Goal.checked(target), prices=PATHS_ALONE):
        frames.append(baked_so_far(bench, view, target))
    return frames


def baked_so_far(bench: Workbench, view: View, target: float) -> Frame:
    """The frame of a view once its texels have as many samples as are enough for now."""
    while (frame := bench.renderer.render(view, Goal.checked(target))).demands:
        loader = bench.caches.of(view.shading)
        until = max(frame.quality.samples, 1)
        for demand in frame.demands:
            refine_chunk(loader, until, target, demand)
    return frame


def controls_of(frame: Frame) -> ControlPixels:
    """The controls that a checked frame was measured by."""
    assert frame.quality.known
    return frame.quality.known.controls


def lamps(folder: Path) -> dict[str, Any]:
    """A dark sky with ten small lamps: light from it is noisy, and smooth on a surface."""
    rng = np.random.default_rng(7)
    image = np.full((32, 64, 3), 0.02, np.float32)
    image[rng.integers(0, 32, 10), rng.integers(0, 64, 10)] = 200.0
    write_hdr(folder / "lamps.hdr", image)
    return {"type": "probe", "file": str(folder / "lamps.hdr")}


@pytest.mark.slow
def test_texels_climb_no_further_than_their_picture_asks(workbench: Make, tmp_path: Path) -> None:
    """Light of many lamps is noisy, and even between texels: rung by rung the picture comes nearer
    to its target.
    """
    bench = workbench(load_scene("demo:orbital", lights=[lamps(tmp_path)], bounces=1, lattice=0.5))
    view = bench.view(size=72)
    frames = climbed(bench, view, 0.03)
    rungs = [frame.quality.samples for frame in frames]
    assert rungs == sorted(rungs) and rungs[0] == FIRST_LEVEL and rungs[-1] > FIRST_LEVEL
    known = [frame.quality for frame in frames]
    assert all(
        each.lacking and each.lacking.reading.samples.max() <= each.samples for each in known
    )
    last = frames[-1]
    assert last.final and last.total.high <= 0.03 and last.counts["final"] == last.surface
    true = trace_reference(bench.renderer, view, 1024)
    assert (
        math.sqrt(max(true_error(last, true) ** 2 - true.noise**2, 0.0))
        < 1.1 * 0.03
        < true_error(frames[0], true)
    )


def reading_of(error: np.ndarray, samples: np.ndarray) -> Reading:
    """What texels of these relative errors and numbers of samples hold, for a picture at 2 %."""
    rows = np.zeros(len(error), np.int32)
    none = np.zeros(0, np.int64)
    return Reading(
        rows,
        grade_rows(rows, error, samples, Goal(0.02)),
        b"",
        samples,
        error,
        none,
        none,
        Goal(0.02, FIRST_LEVEL),
        rough=False,
    )


def test_only_noise_of_texels_that_climb_may_be_lost() -> None:
    """Of four texels one is dark, one is good enough, and two would take more samples."""
    error = np.array([0.0, 0.01, 0.3, 0.4], np.float32)
    samples = np.array([0, 64, 16, 16], np.int32)
    lacking = SimpleNamespace(reading=reading_of(error, samples))
    frame: Any = SimpleNamespace(quality=SimpleNamespace(lacking=lacking), transferred=0)
    assert frame.quality.lacking.reading.noisy.tolist() == [False, False, True, True]
    assert noise_of_climbers(frame) == pytest.approx(0.25 / 0.2501)
    without: Any = SimpleNamespace(quality=Quality(), transferred=0)
    assert noise_of_climbers(without) == 0.0


def test_the_transfer_of_points_climbs_as_texels_do() -> None:
    """Its noise falls, and that of lobes stays; each rung takes as many paths as there were."""
    gbuffer = SimpleNamespace(pixels=np.arange(100))
    frame: Any = SimpleNamespace(
        quality=Quality(),
        transferred=64,
        gbuffer=gbuffer,
        pixel_noise=np.full(100, 0.2),
        variance_of_transfer=100 * 0.1**2,
    )
    assert noise_of_climbers(frame) == pytest.approx(0.25)
    assert climbs_of(frame, 64, 0.02)[:3] == [0.0, 6400.0, 19200.0]


@pytest.mark.parametrize(("noisy", "step"), [(3, "controls"), (1000, "rung")])
def test_a_rung_is_for_noise_that_it_takes_away(
    monkeypatch: pytest.MonkeyPatch, noisy: int, step: str
) -> None:
    """A picture whose interval holds its target: more samples of a few texels cost next to nothing,
    and are no use.
    """
    taken: list[str] = []
    monkeypatch.setattr(PictureCheck, "_climb", lambda *_: bool(taken.append("rung")))
    monkeypatch.setattr(PictureCheck, "_add_controls", lambda *_: bool(taken.append("controls")))
    climbs = np.arange(1000) < noisy
    reading = reading_of(np.where(climbs, 0.05, 0.03), np.where(climbs, 16, 64))
    state = PictureState(Goal.checked(0.02), drawn=FIRST_LEVEL, paths=64)
    total = TotalError(0.019, 0.017, 0.022, 512)
    quality = SimpleNamespace(lacking=SimpleNamespace(reading=reading), known=state)
    frame: Any = SimpleNamespace(
        quality=quality, noise=0.02, measured=total, surface=9, final=False, transferred=0
    )
    unused: Any = None
    PictureCheck(unused, state).advance(frame, np.empty(0), unused, WAITED_FOR)
    assert taken == [step]


def test_controls_noisier_than_the_error_take_more_paths(
    monkeypatch: pytest.MonkeyPatch, coarse: Workbench
) -> None:
    """If a picture is at its target, and its controls are too noisy to show it, they need more
    paths, and the picture needs no better light.
    """
    bench = coarse.again()
    view = coarse.view(azimuth=140.0, size=32)
    target = 0.2
    monkeypatch.setattr("isogi_core.frame.rays.picture_check.paths_for", lambda _: 1)
    monkeypatch.setattr("isogi_core.frame.rays.picture_check.MAX_CONTROLS", 256)
    frames = climbed(bench, view, target)
    doubted = [each for each in frames if each.measured and each.measured.high > target]
    assert doubted and not doubted[-1].final
    last = frames[-1]
    assert last.final and last.quality.known is not None
    assert last.quality.known.paths > 1 and last.traced_pixels == 0


def test_deeper_controls_are_those_of_as_many_paths(coarse: Workbench) -> None:
    view = coarse.view(azimuth=140.0, size=16)
    gbuffer = coarse.renderer.gbuffer(view)
    light = RotatedLight(coarse.renderer.caches.spec("gi"), view)
    places = np.arange(0, len(gbuffer.points), 7)
    once = trace_controls(light, gbuffer, places, (0, 64), 0, coarse.renderer.tiles)
    begun = trace_controls(light, gbuffer, places, (0, 32), 0, coarse.renderer.tiles)
    more = trace_controls(light, gbuffer, places, (32, 32), 0, coarse.renderer.tiles)
    controls = ControlPixels(places, np.ones(len(places)), begun).deepened(more)
    np.testing.assert_allclose(controls.halves, once, rtol=1e-9)


def test_no_pixel_is_final_while_its_picture_may_become_better(coarse: Workbench) -> None:
    bench = coarse.again()
    view = coarse.view(azimuth=200.0, size=32)
    frames = climbed(bench, view, TARGET)
    assert not frames[0].provisional and frames[0].improving
    for frame in frames[:-1]:
        assert frame.final or (
            frame.counts["final"] == 0 and not (frame.reported_state == FINAL).any()
        )
    assert frames[-1].final and frames[-1].coverage["final"] == 1.0


def test_controls_of_a_rung_tell_of_the_next_one_first(workbench: Make) -> None:
    bench = workbench(load_scene("demo:orbital", lights=[SKY], bounces=1))
    view = bench.view(size=32)
    target = 0.015
    frame = baked_so_far(bench, view, target)
    while frame.quality.samples == FIRST_LEVEL:
        assert bench.renderer.refine(view, Goal.checked(target), prices=PATHS_ALONE)
        frame = bench.renderer.render(view, Goal.checked(target))
    assert frame.outdated and frame.measured is not None and frame.demands and not frame.final
    above = baked_so_far(bench, view, target)
    assert (
        controls_of(above) is controls_of(frame)
        and above.measured != frame.measured
        and not above.final
    )
    assert bench.renderer.refine(view, Goal.checked(target))
    renewed = bench.renderer.render(view, Goal.checked(target))
    assert not renewed.outdated and controls_of(renewed) is not controls_of(frame)
    assert renewed.version == above.version


def test_pictures_end_the_same_wherever_their_texels_began(workbench: Make) -> None:
    """A server that is started again finds texels on a rung, and between two; another finds
    none.
    """
    bench = workbench(load_scene("demo:orbital", lights=[SKY], bounces=1))
    target = 0.02
    view = bench.view(size=32)
    last = climbed(bench, view, target)[-1]
    again = bench.again()
    same = climbed(again, view, target)[-1]
    assert (same.version, same.total) == (last.version, last.total)
    assert same.radiance.tobytes() == last.radiance.tobytes()


def test_a_frame_that_others_have_overtaken_takes_no_step(coarse: Workbench) -> None:
    """Two threads draw the same picture, and one waits while the other takes a step."""
    bench = coarse.again()
    view = coarse.view(azimuth=75.0, size=32)
    bench.bake(view)
    bench.project(view)
    renderer = bench.renderer
    seen = []
    while (frame := renderer.render(view)).refinable and len(seen) < 6:
        seen.append(frame.total.controls)
        for _ in range(2):
            assert renderer.surface.refine_frame(frame, Goal(TARGET), renderer.tiles, WAITED_FOR)
    assert seen[0] == 0
    assert 128 <= seen[1] <= 512, "the second step waits for a frame that shows the first"
    one, other = checked(bench, view), checked(coarse.again(), view)
    assert (one.version, one.total) == (other.version, other.total)


def test_a_picture_that_is_good_enough_keeps_its_light(orbital: Workbench) -> None:
    view = orbital.view()
    lit = orbital.renderer.render(view)
    frame = checked(orbital, view, 0.5)
    assert frame.final and 0.0 < frame.total.likely < frame.total.high <= 0.5
    assert np.array_equal(frame.radiance, lit.radiance)


def test_no_controls_for_what_moves_or_is_shaded_locally(coarse: Workbench) -> None:
    view = coarse.view(azimuth=320.0, size=32)
    for other in (
        replace(view, moving=True),
        replace(view, shading="lambert"),
        replace(view, shading="vicinity"),
    ):
        coarse.bake(other)
        frame = coarse.renderer.render(other)
        assert frame.target is None and frame.final and not coarse.renderer.refine(other)


def test_each_pixel_tells_its_whole_error(coarse: Workbench) -> None:
    """Controls spread what they measure over the picture: in the mean as much as there is, and most
    where most is.
    """
    bench = coarse.again()
    view = bench.view(azimuth=70.0, size=48)
    lit = bench.bake(view, TARGET / 4)  # so that noise, which is anywhere, is little of it
    assert (lit.total_error >= lit.error).all() and lit.total_error.max() <= 1.0
    bench.renderer.refine(view)
    frame = bench.renderer.render(view)
    light = (
        trace_reference(bench.renderer, view, 512).mean[frame.state > 0].astype(float)
        @ LUMINANCE_WEIGHTS
    )
    told = frame.total_error[frame.state > 0] * luminance(frame)
    wrong = luminance(frame) - light
    assert math.sqrt((told**2).mean()) / light.mean() == pytest.approx(frame.total.likely, rel=0.1)
    worst = told > np.quantile(told, 0.75)
    assert (wrong[worst] ** 2).mean() > 3.0 * (wrong[~worst] ** 2).mean()
    assert not np.array_equal(frame.total_error, frame.error)


def test_a_check_ends_when_it_is_cancelled(coarse: Workbench) -> None:
    view = coarse.view(azimuth=250.0, size=32)
    cancelled = threading.Event()
    coarse.bake(view)
    cancelled.set()
    with pytest.raises(Cancelled):
        coarse.renderer.refine(view, tiles=coarse.renderer.tiles.cancelled_by(cancelled))
    assert coarse.renderer.render(view).checkable


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wall", "projected", "light"),
    [
        *((1.0, None, CONSTANT), (1.0, False, SKY), (1.33, None, SKY), (1.33, False, CONSTANT)),
        *((2.0, None, CONSTANT), (2.0, False, SKY), (4.0, None, SKY), (4.0, False, CONSTANT)),
    ],
)
def test_a_closed_shell_is_dark_inside(
    workbench: Make, wall: float, projected: bool | None, light: Any
) -> None:
    """Texels in a thin wall lie on isosurfaces that are open: their light must not reach the inside
    of a closed one.

    Projected ones are dark as they are; others are by the check of the picture.
    """
    z, y, x = np.mgrid[:24, :24, :24] - 11.5
    apart = np.abs(np.sqrt(x**2 + y**2 + z**2) - 8.0)
    noise = np.random.default_rng(1).random(apart.shape)
    shell = np.clip(1.0 - apart / wall, 0.0, 1.0) * (1.0 - 0.3 * noise)
    volume = make_volume(shell.astype(np.float32))
    bench = workbench(scene_of(volume, isovalue=0.15, projected=projected, lights=[light]))
    view = bench.view(size=16)
    inside = replace(
        view,
        camera=replace(view.camera, eye=(11.5, 11.5, 11.5), target=(16.0, 12.0, 13.0), fov=60.0),
    )
    bench.bake(inside, 0.02)
    lit = bench.project(inside, 0.02)
    assert projected is False or luminance(lit).mean() < 0.01, "of 0.7 in the open"
    frame = checked(bench, inside, 0.02)
    assert frame.final and frame.surface == 256
    assert luminance(frame).max() == 0.0 and frame.total.likely == frame.total.high == 0.0


# --- plans
# --------------------------------------------------------------------------------------------------


PIXELS = 4000
WANTED = 0.02
CHUNKS = 20
NONE = np.empty(0, np.int64)


def own_light(allowed: float) -> PixelLightCost:
    """Pixels of the luminance 1, whose light has a variance of 0.01 after 256 paths."""
    return PixelLightCost(np.full(PIXELS, 0.01), 256, NONE, allowed)


def cheapest(apart: float, noise: float, texels: int) -> Plan:
    """The plan for a picture that is ``apart`` from the truth besides its ``noise``, by so many
    ``texels``.
    """
    own = own_light((0.85 * WANTED) ** 2)
    squares = np.full(PIXELS, apart**2 + noise**2)
    climbs = [0.0, *(16.0 * texels * (2**n - 1) for n in (1, 2, 3))]
    plans = by_rungs(own, squares, np.full(PIXELS, noise**2), climbs, CHUNKS)
    plans += by_finer(own, squares, np.full(PIXELS, noise**2), texels, CHUNKS, FIRST_LEVEL, WANTED)
    return min(plans, key=lambda plan: plan.cost(Prices()))


def test_noise_asks_for_rungs() -> None:
    plan = cheapest(apart=0.002, noise=0.03, texels=2000)
    assert plan.rungs == 2 and not plan.finer and not len(plan.choice.places)


def test_light_between_texels_asks_for_finer_ones() -> None:
    plan = cheapest(apart=0.03, noise=0.005, texels=2000)
    assert plan.finer and plan.rungs == 1
    times_as_many = plan.texel_paths / (2000 * FIRST_LEVEL)
    assert 2.2 < times_as_many < 8.0, "texels twice as fine, of a surface in a volume"


def test_many_texels_leave_pixels_to_light_of_their_own() -> None:
    plan = cheapest(apart=0.03, noise=0.005, texels=2_000_000)
    assert not plan.rungs and len(plan.choice.places)


def test_finer_texels_begin_with_their_first_samples_again() -> None:
    """Those of a third rung have four times the noise variance of the coarse ones at first."""
    own = own_light(1.0)
    errors = np.full(9, 0.05)
    noise = np.full(9, 0.01)
    own = PixelLightCost(np.full(9, 0.01), 256, NONE, 1e-12)
    asked: list[np.ndarray] = []
    by_finer(CostSeen(own, asked), errors, noise, 10, CHUNKS, 4 * FIRST_LEVEL, WANTED)
    # On the third rung the noise is as before, and finer texels have 0.11 to 0.44 of the rest.
    rest = asked[2] - 0.01
    assert rest.min() > 0.1 * 0.04 and rest.max() < 0.45 * 0.04
    # Each rung leaves an equal share of the noise, 0.35 to 0.7.
    shares = [(after - rest) / (before - rest) for before, after in pairwise(asked)]
    assert 0.35 < shares[0][0] < 0.7
    assert np.ravel(shares) == pytest.approx(shares[0][0])


class CostSeen(PixelLightCost):
    """Notes the errors that it is asked about."""

    def __init__(self, own: PixelLightCost, asked: list[np.ndarray]) -> None:
        super().__init__(own.variance, own.paths, own.own, own.allowed)
        object.__setattr__(self, "asked", asked)

    def choose(self, errors: np.ndarray):  # type: ignore[no-untyped-def]
        self.asked.append(errors)  # type: ignore[attr-defined]
        return super().choose(errors)


def by_pixels(paths: float) -> Plan:
    """The plan of so many paths of one pixel, in two replicas."""
    return Plan(Choice(np.zeros(1, np.int64), 1.0, paths / 2, NONE))


@pytest.mark.parametrize(
    ("work", "less", "more"),
    [
        ({"texel_paths": 1000.0}, 500.0, 1000.0),
        ({"tasks": 1.0}, 3000.0, 6000.0),
        ({"finer": True}, 3e6, 6e6),
    ],
    ids=["a thousand paths of texels", "a task", "finer texels"],
)
def test_pictures_weigh_the_time_that_somebody_waits(
    work: dict[str, Any], less: float, more: float
) -> None:
    """Paths of texels take longer than those of pixels, and serve other views; a task takes some
    milliseconds, and finer texels take seconds to be opened.
    """
    cost = replace(by_pixels(0.0), rungs=1, **work).cost(Prices())
    assert by_pixels(less).cost(Prices()) < cost < by_pixels(more).cost(Prices())


def test_a_rung_that_costs_less_than_controls_is_ahead() -> None:
    """At half a path of a pixel for each path of a texel."""
    prices = Prices(path=0.5)
    assert until_decided(100.0, [0.0, 60.0], prices, 20.0) == Ahead(20.0, 60.0, 2)
    assert until_decided(100.0, [0.0, 200.0], prices, 20.0) == Ahead(100.0, 0.0, 1)
    assert until_decided(100.0, [0.0], prices, 20.0) == Ahead(100.0, 0.0, 1)


def test_what_is_ahead_leaves_out_what_begins_now() -> None:
    own = own_light(0.05**2)
    plan = by_rungs(own, np.full(PIXELS, 0.2), np.full(PIXELS, 0.1), [0.0, 10.0, 30.0], 5)[2]
    assert plan.cost(Prices(path=0.5, task=100.0)) == 1000.0 + 15.0 + plan.choice.paths
    assert plan.ahead(5.0, 100.0) == Ahead(plan.choice.paths + 110.0, 20.0, 3)
    now = by_rungs(own, np.full(PIXELS, 0.2), np.full(PIXELS, 0.1), [0.0], 5)[0]
    assert now.ahead(5.0, 100.0) == Ahead(100.0, 0.0, 1)


def test_narrow_intervals_take_more_controls() -> None:
    """256 of them leave the error within a factor of 1.2: to be sure of half of that takes four
    times as many.
    """
    measured = TotalError(0.018, 0.015, 0.018 * 1.2, 256)
    room = math.sqrt(1.2)
    assert controls_to(measured, WANTED / room, WANTED) in (1024, 1025)
    most = controls_to(measured, WANTED, WANTED)
    assert 2000 < most < 10_000
    assert controls_to(measured, 0.019999, WANTED) == most


def test_cheap_rungs_are_climbed_at_once() -> None:
    assert rungs_at_once(3, [0.0, 10.0, 30.0, 70.0], check=40.0) == 2
    assert rungs_at_once(1, [0.0, 10.0, 30.0, 70.0], check=40.0) == 1
    assert rungs_at_once(3, [0.0, 50.0, 150.0, 350.0], check=40.0) == 1


@pytest.mark.parametrize("part", [0.5, 1.0])
def test_light_that_is_still_to_come_is_measured(workbench: Make, part: float) -> None:
    """While part of a picture has no light, or few samples, controls measure the error of all its
    pixels: the true one is in the interval, and not all light counts as error.
    """
    bench = workbench(load_scene("demo:orbital", lights=[SKY], bounces=1))
    view = bench.view(azimuth=20.0, size=32)
    loader = bench.caches.of("gi")
    demands = sorted(
        bench.renderer.render(view, Goal.checked(TARGET)).demands, key=lambda each: each.index
    )
    bits = bench.renderer.prepared.lattice.bits
    for demand in demands[: int(part * len(demands))]:
        some = demand.offsets[first_texels(demand.offsets, bits)]
        refine_chunk(loader, FIRST_LEVEL, TARGET, replace(demand, offsets=some))
    before = bench.renderer.render(view, Goal.checked(TARGET))
    assert before.unmeasured and before.total.predicted
    assert bench.renderer.refine(view, Goal.checked(TARGET))
    frame = bench.renderer.render(view, Goal.checked(TARGET))
    assert not frame.unmeasured and frame.provisional and not frame.final
    assert (frame.noise > 0.3) == (part < 1.0)
    best = trace_reference(bench.renderer, view, 1024)
    light = best.mean[frame.state > 0].astype(np.float64) @ LUMINANCE_WEIGHTS
    true = math.sqrt(((luminance(frame) - light) ** 2).mean()) / light.mean()
    assert frame.total.low <= true <= frame.total.high < 1.0
    assert not bench.renderer.refine(view, Goal.checked(TARGET))
    settled = climbed(bench, view, TARGET)[-1]
    assert settled.final and settled.quality.known is not None
    assert not settled.outdated
