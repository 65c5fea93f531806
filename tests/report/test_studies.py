"""All studies of a report, of a picture of a few pixels."""

import math
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from isogi_core.bake.light import Light
from isogi_core.errors import Cancelled, StoreError, ViewError
from isogi_core.frame.frame import Frame
from isogi_core.kernels.planes import PROVISIONAL
from isogi_core.report import bench as benches
from isogi_core.report import convergence, interpolation, models, normals, vicinity
from isogi_core.report.bake import ViewBake
from isogi_core.report.bench import Bench
from isogi_core.report.converged import TIMES, converged
from isogi_core.report.sections import UNITS, Section
from isogi_core.report.studies import STUDIES, Study, study_of
from tests.toil import PACE, measure_toil


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(convergence, "RUNGS", (16, 64))
    monkeypatch.setattr(convergence, "SIZE", 12)
    monkeypatch.setattr(interpolation, "SAMPLES", 64)
    monkeypatch.setattr(normals, "PATHS", 64)
    monkeypatch.setattr(models, "SIZE", 16)
    monkeypatch.setattr(models, "ROUNDS", 1)
    yield


def check(section: Section) -> None:
    """Tables are whole and in known units, and no number in them is NaN; pictures are of one view."""
    for table in section.tables:
        assert table.rows
        assert all(column.unit in UNITS for column in table.columns)
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


def test_curves_fall_with_time(under_sky: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each point of baked light has cost all samples up to its own, each of traced paths its own alone."""
    measure_toil(monkeypatch)
    (plot,) = convergence.study(under_sky).plots
    assert [curve.x for curve in plot.curves[3:]] == [(16 * 12 * 12 / PACE, 64 * 12 * 12 / PACE)]
    for curve in plot.curves:
        assert 0 < curve.x[0] == curve.x[1] / 4
        assert curve.y[1] < 1.2 * curve.y[0]


def test_what_gives_way_to_time_is_told(make_bench: Callable[..., Bench]) -> None:
    bench = make_bench()
    assert not bench.hurried
    late = replace(bench, deadline=time.monotonic() + 1e-3, hurry=threading.Event(), _made={})
    section = study_of(convergence, 1.0).run(late)
    assert late.hurried
    assert "ends at 16 samples" in section.about
    assert not bench.hurried
    study_of(vicinity, 1.0).run(replace(bench, hurry=late.hurry))
    assert not late.hurried


def test_light_that_does_not_fit_is_not_shown(
    make_bench: Callable[..., Bench], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(benches, "MEMORY", 1 << 14)
    bench = make_bench()
    with pytest.raises(StoreError, match="does not fit"):
        bench.planned.frame()


def test_each_texel_converges_by_its_own_samples(under_sky: Bench) -> None:
    planned = under_sky.planned.samples
    assert converged(under_sky).samples >= min(TIMES * planned, 256)


def test_a_finer_lattice_interpolates_better(under_sky: Bench) -> None:
    from isogi_core.report.lattices import COLUMNS, study

    names, rows = [column.name for column in COLUMNS], study(under_sky).tables[0].rows
    half, adapting, whole, _, _ = rows
    error, texels = names.index("interpolation"), names.index("texels of the view")
    assert half[error] > whole[error]
    assert half[texels] <= adapting[texels]
    assert [row[names.index("read")] for row in rows] == ["all of it", *["adaptive", "all of it"] * 2]


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
