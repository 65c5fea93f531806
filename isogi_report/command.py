"""``isogi report``: measure a view, draw what was measured, and say what is missing."""

from __future__ import annotations

import importlib.util
import math
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from isogi_core.errors import advice
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene
from server.errors import LibraryError, ParameterError
from server.parameters import FrameParams, read
from server.progress import open_scene
from server.settings import Settings
from server.values import span
from server.views import view_of

if TYPE_CHECKING:
    from isogi_report.journal import Report
    from isogi_report.measuring import Measured, Study
    from isogi_report.sections import Section

DEFAULT_VIEWPOINT = {"azimuth": 40.0, "elevation": 30.0, "distance": 2.2}
"""Where a report looks from by default: nearer than pages do, so that few of its pixels are
empty.
"""

PAGE_LIBRARIES = ("matplotlib", "jinja2")
"""What pages are drawn with; they are not needed by anything else."""


@dataclass(frozen=True)
class ReportRequest:
    """What a person asks of a report: where it goes, seconds that it may take, keys of the only
    studies to run.
    """

    folder: Path
    deadline: float | None = None
    only: tuple[str, ...] = ()


def report(
    target: str, knobs: Mapping[str, str], settings: Settings, request: ReportRequest
) -> dict[str, Any]:
    """Measure the view of ``target`` that ``knobs`` name, write its page, and tell where that is
    and what it says.

    Raises SceneError, VolumeError, LightError, ViewError, ReportError (the folder holds something
    else, or is in use) and LibraryError before anything is measured; StoreError and OSError later.
    """
    begun = time.monotonic()
    require_libraries()
    scene = open_scene(target, settings)
    params = read(FrameParams, standing(knobs).items())
    if params.exposure is None:
        exposure = scene.default_exposure
    else:
        exposure = params.exposure
    return report_of(scene, view_of(scene, params, settings), exposure, request, begun)


def standing(knobs: Mapping[str, Any]) -> dict[str, Any]:
    """The knobs of a view, with DEFAULT_VIEWPOINT for those of its orbit that are left out."""
    if "eye" in knobs:
        return dict(knobs)
    return {**DEFAULT_VIEWPOINT, **knobs}


def require_libraries() -> None:
    """LibraryError where a library is missing that pages are drawn with."""
    missing = [name for name in PAGE_LIBRARIES if importlib.util.find_spec(name) is None]
    if missing:
        raise LibraryError(
            f"A report is drawn with {' and '.join(missing)}: pip install 'isogi[report]'."
        )


def report_of(
    scene: Scene, view: View, exposure: float, request: ReportRequest, begun: float
) -> dict[str, Any]:
    """The report of a view; ``begun``, a time of ``time.monotonic``, is when its time began.

    Raises ViewError where the view shows nothing, and what ``report`` does.
    """
    from isogi_report.bench import Bench  # noqa: PLC0415 (kernels: bad input is refused before they are compiled)
    from isogi_report.journal import (  # noqa: PLC0415
        Report,
        open_journal,
        subject_of,
        workshop,
    )
    from isogi_report.measuring import STUDIES, measure  # noqa: PLC0415
    from isogi_report.page import write_report  # noqa: PLC0415

    wanted = chosen_studies(STUDIES, request.only)
    if request.deadline is None:
        deadline = math.inf
    else:
        deadline = begun + request.deadline
    bench = Bench(scene, view, workshop(request.folder), deadline=deadline, exposure=exposure)
    on = bench.surface  # before the folder is touched
    with open_journal(request.folder, subject_of(scene, view, exposure)) as journal:
        measured = measure(STUDIES, wanted, bench, journal)
        drawn = Report(
            scene, view, exposure, on, measured.done, tuple(notes(measured, request.deadline))
        )
        return outcome(write_report(request.folder, drawn), drawn, measured)


def chosen_studies(studies: Sequence[Study], only: Sequence[str]) -> tuple[Study, ...]:
    """The studies of these keys, all of them where none is given; ParameterError on a key that
    there is not.
    """
    known = {study.key for study in studies}
    for key in only:
        if key not in known:
            raise ParameterError(
                f"There is no study '{key}': {advice(key, (each.key for each in studies))}"
            )
    return tuple(study for study in studies if not only or study.key in only)


def notes(measured: Measured, deadline: float | None) -> Iterator[str]:
    """What is missing or wanting, and why, in sentences."""
    late = titles(measured.late)
    if measured.stopped:
        yield (
            f"Stopped by hand before the end. Missing: {late}. The same command goes on from here."
        )
    elif late:
        yield (
            f"Left out, as {span(deadline or 0.0)} did not suffice: {late}. The same command "
            "goes on from here."
        )
    if measured.hurried:
        yield (
            f"Cut short for want of time: {titles(measured.hurried)}. The same command "
            "measures these again."
        )
    for study, what in measured.failed:
        yield f"Failed: {study.title} ({what})."
    if measured.unasked:
        yield f"Not asked for: {titles(measured.unasked)}."


def titles(studies: Iterable[Study]) -> str:
    """What studies are called, for a sentence."""
    return ", ".join(study.title for study in studies)


def outcome(page: Path, drawn: Report, measured: Measured) -> dict[str, Any]:
    """The command's summary of a report, as a document; seconds of the processor, by section."""
    return {
        "page": str(page),
        "data": str(page.with_name("report.json")),
        "scene": drawn.scene.name,
        "isovalue": drawn.view.isovalue,
        "headline": headline(entry.section for entry in drawn.entries),
        "sections": {entry.section.key: entry.seconds for entry in drawn.entries},
        "found": measured.found,
        "missing": [study.key for study in (*measured.late, *measured.unasked)],
        "hurried": [study.key for study in measured.hurried],
        "failed": [study.key for study, _ in measured.failed],
        "stopped": measured.stopped,
        "notes": list(drawn.notes),
    }


def headline(sections: Iterable[Section]) -> dict[str, Any]:
    """The score of the scene's frame, by its columns' names: what the summary's first table
    says.
    """
    tables = [
        table for section in sections if section.key == "summary" for table in section.tables[:1]
    ]
    cells = {
        column.name: cell
        for table in tables
        for column, cell in zip(table.columns, table.rows[0], strict=True)
    }
    return {name: float(cell) for name, cell in cells.items() if isinstance(cell, int | float)}


def sentence(facts: Mapping[str, Any]) -> str:
    """The command's summary of a report, for a person."""
    score = ", ".join(f"{name} {cell:.3g}" for name, cell in facts["headline"].items())
    if facts["found"]:
        before = f", {facts['found']} of them measured before"
    else:
        before = ""
    count = len(facts["sections"])
    said = f"{facts['page']}: {count} section{'' if count == 1 else 's'}{before}."
    return " ".join([said, *([f"The frame's {score}."] if score else []), *facts["notes"]])
