"""All studies of a report, of a picture of a few pixels."""

import math
import threading
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from isogi_core.bake.texel_light import Light
from isogi_core.errors import Cancelled, StoreError, ViewError
from isogi_core.frame.frame import Frame
from isogi_core.kernels.shading.framebuffer import PROVISIONAL
from isogi_report import bench as benches
from isogi_report import studies
from isogi_report.bench import Bench, ViewBake
from isogi_report.exact import CONVERGED_SAMPLE_FACTOR, converged
from isogi_report.journal import Entry
from isogi_report.measuring import STUDIES, Study, run
from isogi_report.sections import COLUMN_UNITS, Section


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(studies, "CURVE_SAMPLES", (16, 64))
    monkeypatch.setattr(studies, "CURVE_PIXELS", 12)


def check(section: Section) -> None:
    """Tables are whole and in known units, and no number in them is NaN; pictures are of one view."""
    for table in section.tables:
        assert table.rows
        assert all(column.unit in COLUMN_UNITS for column in table.columns)
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


def test_what_gives_way_to_time_is_told(make_bench: Callable[..., Bench]) -> None:
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
    make_bench: Callable[..., Bench], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(benches, "BENCH_CACHE_BYTES", 1 << 14)
    bench = make_bench()
    with pytest.raises(StoreError, match="does not fit"):
        bench.planned.frame()


def test_each_texel_converges_by_its_own_samples(under_sky: Bench) -> None:
    planned = under_sky.planned.samples
    assert converged(under_sky).samples >= min(CONVERGED_SAMPLE_FACTOR * planned, 256)


def test_references_are_kept_in_the_folder(under_sky: Bench) -> None:
    best = under_sky.best
    again = Bench(under_sky.scene, under_sky.view, under_sky.folder).reference(64)
    assert again.samples >= best.samples
    assert np.array_equal(again.mean, under_sky.reference(again.samples).mean)


def test_a_stopped_report_and_an_empty_view_say_so(make_bench: Callable[..., Bench]) -> None:
    bench = make_bench()
    bench.cancelled.set()
    with pytest.raises(Cancelled):
        _ = bench.best
    empty = make_bench(isovalue=bench.scene.volume.value_range[1])
    with pytest.raises(ViewError, match="Nothing is to be seen"):
        _ = empty.planned
