"""All studies of a report, of a picture of a few pixels."""

import math
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from isogi_core.errors import Cancelled, ViewError
from isogi_core.report import convergence, interpolation, models, normals
from isogi_core.report.bench import Bench
from isogi_core.report.sections import UNITS, Section
from isogi_core.report.studies import STUDIES, Study


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


@pytest.mark.parametrize("study", STUDIES, ids=lambda study: study.key)
def test_each_study_answers(study: Study, under_sky: Bench) -> None:
    section = study.run(under_sky)
    assert (section.key, section.title) == (study.key, study.title)
    check(section)


def test_curves_fall_with_time(under_sky: Bench) -> None:
    (plot,) = convergence.study(under_sky).plots
    assert len(plot.curves) == 4
    for curve in plot.curves:
        assert curve.x[0] < curve.x[1]
        assert curve.y[1] < 1.2 * curve.y[0]


def test_a_finer_lattice_interpolates_better(under_sky: Bench) -> None:
    from isogi_core.report.lattices import COLUMNS, study

    column = [column.name for column in COLUMNS].index("interpolation")
    errors = [row[column] for row in study(under_sky).tables[0].rows]
    assert errors[0] > errors[2]


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
