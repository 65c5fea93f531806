"""The studies of a report, of a picture of a few pixels: light baked in memory, the split of an
error, its course.
"""

import math
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.bake_spec import BakeSpec
from isogi_core.bake.noise import Goal
from isogi_core.bake.refine import locate, refine
from isogi_core.bake.texel_light import Light
from isogi_core.errors import Cancelled, StoreError, ViewError
from isogi_core.frame.frame import Frame
from isogi_core.frame.projected_texels import find_distances
from isogi_core.frame.renderer import Renderer
from isogi_core.kernels.shading.framebuffer import PROVISIONAL
from isogi_core.model.view import View
from isogi_report import bench as benches
from isogi_report import studies
from isogi_report.bench import Bench, ViewBake
from isogi_report.exact import (
    converged,
    cuts_harmonics,
    lit_by_paths,
    own_light,
    reference_difference,
    short_paths,
)
from isogi_report.journal import Entry
from isogi_report.measuring import STUDIES, Study, run
from isogi_report.metrics import mean_of, spread_of
from isogi_report.sections import Curve, Section
from isogi_report.speed import bake_view, make_renderer
from isogi_report.studies import (
    Split,
    break_even_row,
    break_even_table,
    seconds_at,
    split_error,
    study_split,
    true_surface,
)
from tests.report.conftest import CONSTANT, MakeBench


def test_frames_have_the_bits_of_those_from_a_store(under_sky: Bench, tmp_path: Path) -> None:
    bake = ViewBake(under_sky.renderer(under_sky.scene), under_sky.view)
    bake.grow(16)
    bake.frame()
    frame = Renderer(bake.renderer.caches, under_sky.tiles).render(
        under_sky.view, Goal.checked(1e-9)
    )
    stored = bake_view(make_renderer(under_sky.scene, str(tmp_path)), under_sky.view, 16)
    assert stored.surface > 20
    assert np.array_equal(frame.radiance, stored.radiance) and np.array_equal(
        frame.error, stored.error
    )
    assert bake.samples == 16.0
    assert bake.seconds > 0.0


def test_texels_far_from_the_surface_are_projected(make_bench: MakeBench) -> None:
    bench = make_bench(projected=True, lattice=0.5, target_error=0.05)
    renderer = bench.renderer(bench.scene)
    bake = ViewBake(renderer, bench.view)
    bake.grow(256)
    frame = bake.frame()
    texels = len(bake.shown.places)
    assert frame.quality.projection
    distances = find_distances(bake.shown, renderer.prepared, renderer.tiles)
    distant = np.flatnonzero(distances.beyond(0.05))
    # A tenth of a voxel does not err by 5 %, and two voxels do.
    assert distances.voxels[distant].min() > 0.3
    assert np.delete(distances.voxels, distant).max() < 1.5
    np.testing.assert_array_equal(bake.texels[texels:], bake.texels[:texels][distant])
    projected = frame.quality.projection.reading.projected_rows >= 0
    assert 0 < projected.sum() <= len(distant) and not np.delete(projected, distant).any()
    level = frame.gbuffer.isovalue
    own = bake.light.rows(np.arange(texels, len(bake.texels)))
    void = locate(bake.texels[texels:], renderer.prepared, level)[1]
    np.testing.assert_array_equal(own.void, void)
    assert not projected[distant[void]].any()


def test_growing_goes_on_where_it_was(under_sky: Bench) -> None:
    renderer = under_sky.renderer(under_sky.scene)
    twice, once = (ViewBake(renderer, under_sky.view) for _ in range(2))
    twice.grow(16)
    twice.grow(32)
    once.grow(32)
    assert np.array_equal(twice.frame().radiance, once.frame().radiance)


TRACED = Curve("paths", (0.01, 0.04, 0.16, 0.64), (0.08, 0.04, 0.02, 0.01))
"""Seconds are 6.4e-5 over the square of the error."""


@pytest.mark.parametrize("error", [0.5, 0.08, 0.05, 0.02, 0.013, 0.01, 0.001])
def test_seconds_follow_the_law_between_points_and_beyond(error: float) -> None:
    assert seconds_at(TRACED, error) == pytest.approx(6.4e-5 / error**2)


def test_a_curve_that_does_not_get_there_has_no_seconds() -> None:
    assert seconds_at(Curve("level", (1.0, 2.0), (0.1, 0.1)), 0.05) is None
    assert seconds_at(Curve("short", (1.0,), (0.1,)), 0.05) is None
    assert seconds_at(TRACED, 0.0) is None


def test_a_bake_counts_at_its_cheapest_good_point() -> None:
    baked = Curve("baked", (1.0, 3.0, 9.0), (0.1, 0.041, 0.04))
    name, error, seconds, picture, pictures = break_even_row(baked, TRACED)
    assert (name, error, seconds) == ("baked", 0.041, 3.0)
    assert picture == pytest.approx(6.4e-5 / 0.041**2)
    assert pictures == 79
    table = break_even_table([baked], TRACED, "4 × 4 pixels")
    assert len(table.rows[0]) == len(table.columns)


PACE = 1 << 20
"""Samples of texels and of pixels that take a second; a power of two, so that sums of them are
exact.
"""


class Toil:
    """Stands for the ``time`` of a module that measures its work."""

    def __init__(self) -> None:
        self._seconds = 0.0
        self._lock = threading.Lock()

    monotonic = staticmethod(time.monotonic)

    def process_time(self) -> float:
        """Seconds of the processor up to now."""
        return self._seconds

    def spend(self, samples: int) -> None:
        """Go on by so many samples."""
        with self._lock:
            self._seconds += samples / PACE


def measure_toil(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have bakes in memory and traced pictures take as long as their samples tell, on any
    machine.
    """
    toil = Toil()
    render = Renderer.render

    def refined(light: Light, texels: np.ndarray, look: BakeSpec, until: int, goal: Goal) -> None:
        before = taken(light)
        refine(light, texels, look, until, goal)
        toil.spend(taken(light) - before)

    def rendered(renderer: Renderer, view: View, *args: Any, **more: Any) -> Frame:
        if view.shading == "path_traced":
            toil.spend(view.samples * view.width * view.height)
        return render(renderer, view, *args, **more)

    monkeypatch.setattr(benches, "time", toil)
    monkeypatch.setattr(benches, "refine", refined)
    monkeypatch.setattr(studies, "time", toil)
    monkeypatch.setattr(Renderer, "render", rendered)


def taken(light: Light) -> int:
    """The samples of all texels that can hold light."""
    return int(np.maximum(light.samples, 0).sum())


@pytest.mark.slow
def test_curves_fall_with_time(under_sky: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each point of baked light has cost all samples up to its own, each of traced paths its own
    alone.
    """
    measure_toil(monkeypatch)
    (plot,) = studies.study_convergence(under_sky).plots
    assert [curve.x for curve in plot.curves[3:]] == [(16 * 12 * 12 / PACE, 64 * 12 * 12 / PACE)]
    for curve in plot.curves:
        assert 0 < curve.x[0] == curve.x[1] / 4
        assert curve.y[1] < 1.2 * curve.y[0]


@pytest.fixture(scope="module")
def calm(make_bench: MakeBench) -> Bench:
    """The orbital under constant light, in single floats."""
    return make_bench(lights=[CONSTANT], precision="single")


def names(split: Split) -> list[str]:
    return [part.name for part in split.parts]


def test_parts_lead_from_the_frame_to_the_reference(under_sky: Bench) -> None:
    split = split_error(under_sky)
    biases = sum(split.spread(part).bias for part in split.parts)
    assert biases == pytest.approx(split.spread(split.whole).bias, abs=1e-6)
    assert 0.5 < split.together / split.spread(split.whole).rmse < 2.0


def test_each_cause_is_there_where_it_acts(under_sky: Bench) -> None:
    split = split_error(under_sky)
    assert names(split) == [
        "Monte Carlo noise",
        "quantization",
        "interpolation",
        "harmonics cut off",
        "bounces cut off",
    ]
    sizes = dict(zip(names(split), (split.spread(part) for part in split.parts), strict=True))
    assert 0.0 < sizes["quantization"].rmse < 0.02
    assert sizes["harmonics cut off"].rmse > 0.02
    assert sizes["bounces cut off"].bias <= 0.0


@pytest.mark.slow
def test_the_noise_part_is_what_the_frame_tells(make_bench: MakeBench) -> None:
    """At 2 %: where 64 samples are far more than enough, less is left than is told."""
    bench = make_bench(target_error=0.02)
    split = split_error(bench)
    told = bench.planned.frame().noise
    assert 0.67 < split.spread(split.parts[0]).rmse / told < 1.5


def test_what_is_cut_off_beside_a_lobe_is_little(make_bench: MakeBench) -> None:
    """The same view by harmonics alone, and with the sun as a lobe of the same orders."""
    orders = {"order": 3, "indirect_order": 3, "bounces": 1}
    cut = {}
    for lobes in (0, 1):
        bench = make_bench(lobes=lobes, **orders)
        own = own_light(bench)
        lights = lit_by_paths(short_paths(bench))
        cut[lobes] = spread_of(
            own.light - lights.light, own.noise + lights.noise, mean_of(lights.light)
        ).rmse
    assert cut[1] < 0.5 * cut[0] and cut[0] > 0.05


@pytest.mark.slow
def test_what_two_references_share_is_not_noise(make_bench: MakeBench) -> None:
    """Of other normals' pictures with 64 paths, against the same with many more."""
    bench = make_bench()
    few, many = (
        (bench.reference(n), bench.reference(n, true_surface(bench.scene))) for n in (64, 4096)
    )
    change = reference_difference(*few)
    exact = reference_difference(*many)
    met = ((change.light - exact.light) ** 2).mean()
    assert 0.5 < change.noise.mean() / met < 2.0
    assert change.noise.mean() < sum(lit_by_paths(each).noise.mean() for each in few)


def test_normals_and_offset_are_told_apart(under_sky: Bench) -> None:
    split = split_error(under_sky)
    wrong = split.beyond.wrong - split.whole.wrong
    assert np.allclose(split.surface.wrong, wrong, atol=1e-5)
    assert split.spread(split.surface).rmse > 0.005
    assert np.mean(split.surface.noise) < 0.1 * np.mean(split.surface.wrong**2)


def test_constant_light_has_no_truncation_and_no_rounding(calm: Bench) -> None:
    section = study_split(calm)
    assert names(split_error(calm)) == ["Monte Carlo noise", "interpolation", "bounces cut off"]
    assert not cuts_harmonics(calm.scene)
    assert own_light(calm).light is not None
    assert (own_light(calm).light == lit_by_paths(short_paths(calm)).light).all()
    assert "single floats" in section.about
    assert "no harmonics" in section.about
    assert len(section.pictures) == 5


def test_transfer_at_points_agrees_with_paths_under_soft_light(make_bench: MakeBench) -> None:
    """Of two lights in one: order 6 holds a constant whole, and paths meet it as it is."""
    bench = make_bench(lights=[CONSTANT], representation="transfer", order=2)
    split = split_error(bench)
    exact = own_light(bench).light.mean() / lit_by_paths(short_paths(bench)).light.mean()
    assert exact == pytest.approx(1.0, abs=0.01)
    assert "harmonics cut off" not in names(split)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(studies, "CURVE_SAMPLES", (16, 64))
    monkeypatch.setattr(studies, "CURVE_PIXELS", 12)


def check(section: Section) -> None:
    """Tables are whole, and no number in them is NaN; pictures are of one view."""
    for table in section.tables:
        assert table.rows
        for row in table.rows:
            assert len(row) == len(table.columns)
            assert all(math.isfinite(cell) for cell in row if isinstance(cell, int | float))
    assert len({picture.pixels.shape[:2] for picture in section.pictures}) <= 1


@pytest.fixture
def frames(monkeypatch: pytest.MonkeyPatch) -> list[Frame]:
    """The frames of baked light that a study makes."""
    made: list[Frame] = []
    plain = ViewBake.frame

    def frame(bake: ViewBake, light: Light | None = None) -> Frame:
        made.append(plain(bake, light))
        return made[-1]

    monkeypatch.setattr(ViewBake, "frame", frame)
    return made


@pytest.mark.parametrize("study", STUDIES, ids=lambda study: study.key)
def test_each_study_answers(study: Study, under_sky: Bench, frames: list[Frame]) -> None:
    section = study.run(under_sky)
    assert (section.key, section.title) == (study.key, study.title)
    check(section)
    assert not any((frame.state == PROVISIONAL).any() for frame in frames)
    assert not under_sky.hurried


def test_what_gives_way_to_time_is_told(make_bench: MakeBench) -> None:
    bench = make_bench()
    assert not bench.hurried
    late = replace(bench, deadline=time.monotonic() + 1e-3, hurry=threading.Event(), _made={})
    found = run(Study("convergence", "", studies.study_convergence, 1.0), late)
    assert late.hurried
    assert isinstance(found, Entry) and "ends at 16 samples" in found.section.about
    assert not bench.hurried
    run(Study("none", "", lambda _: Section("none", "", ""), 1.0), late)
    assert not late.hurried


def test_light_that_does_not_fit_is_not_shown(
    make_bench: MakeBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(benches, "BENCH_CACHE_BYTES", 1 << 14)
    bench = make_bench()
    with pytest.raises(StoreError, match="does not fit"):
        bench.planned.frame()


def test_each_texel_converges_by_its_own_samples(under_sky: Bench) -> None:
    planned = under_sky.planned.samples
    assert converged(under_sky).samples >= min(4 * planned, 256)


def test_references_are_kept_in_the_folder(under_sky: Bench) -> None:
    best = under_sky.best
    again = Bench(under_sky.scene, under_sky.view, under_sky.folder).reference(64)
    assert again.samples >= best.samples
    assert np.array_equal(again.mean, under_sky.reference(again.samples).mean)


def test_a_stopped_report_and_an_empty_view_say_so(make_bench: MakeBench) -> None:
    bench = make_bench()
    bench.cancelled.set()
    with pytest.raises(Cancelled):
        _ = bench.best
    empty = make_bench(isovalue=bench.scene.volume.value_range[1])
    with pytest.raises(ViewError, match="Nothing is to be seen"):
        _ = empty.planned
