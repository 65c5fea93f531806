"""``isogi report``: measure a view, draw a page of the results,
and list studies that are missing.
"""

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
from isogi_server.errors import LibraryError, ParameterError
from isogi_server.parameters import FrameParams, read
from isogi_server.progress import open_scene
from isogi_server.settings import Settings
from isogi_server.values import span
from isogi_server.views import in_turned_light, view_of

if TYPE_CHECKING:
    from isogi_report.journal import Report
    from isogi_report.measuring import Measured, Study
    from isogi_report.sections import Section

DEFAULT_VIEWPOINT = {"azimuth": 40.0, "elevation": 30.0, "distance": 2.2}
"""Default viewpoint of a report: nearer than on pages, so that few of its pixels are empty."""

PAGE_LIBRARIES = ("matplotlib", "jinja2")
"""Libraries that draw pages; nothing else needs them."""


@dataclass(frozen=True)
class ReportRequest:
    """A request for a report: its ``folder``, the seconds that it may take,
    and the keys of the ``only`` studies to run.
    """

    folder: Path
    deadline: float | None = None
    only: tuple[str, ...] = ()


def report(
    target: str, knobs: Mapping[str, str], settings: Settings, request: ReportRequest
) -> dict[str, Any]:
    """Measure the view of ``target`` given by ``knobs``, write its page, and return a summary with
    its path.

    Before anything is measured it raises SceneError, VolumeError, LightError, ViewError,
    ReportError if the folder holds something else or is in use, and LibraryError; later StoreError
    and OSError.
    """
    begun = time.monotonic()
    require_libraries()
    scene = open_scene(target, settings)
    params = read(FrameParams, standing(knobs).items())
    if params.exposure is None:
        exposure = scene.default_exposure
    else:
        exposure = params.exposure
    scene = in_turned_light(scene, params)
    return report_of(scene, view_of(scene, params, settings), exposure, request, begun)


def standing(knobs: Mapping[str, Any]) -> dict[str, Any]:
    """Return the knobs of a view,
    with DEFAULT_VIEWPOINT for those of its orbit that are left out.
    """
    if "eye" in knobs:
        return dict(knobs)
    return {**DEFAULT_VIEWPOINT, **knobs}


def require_libraries() -> None:
    """Raise LibraryError if a library is missing that draws pages."""
    missing = [name for name in PAGE_LIBRARIES if importlib.util.find_spec(name) is None]
    if missing:
        raise LibraryError(
            f"A report is drawn with {' and '.join(missing)}: pip install 'isogi[report]'."
        )


def report_of(
    scene: Scene, view: View, exposure: float, request: ReportRequest, begun: float
) -> dict[str, Any]:
    """Measure a view and write its page; return the summary.

    The deadline of the ``request`` counts from ``begun``, a time of ``time.monotonic`` in seconds.
    Raises the errors of ``report``, ParameterError for an unknown study, and ViewError if the view
    shows nothing.
    """
    # These modules load kernels. They are imported only now, as most bad input has been refused.
    from isogi_report.bench import Bench  # noqa: PLC0415
    from isogi_report.journal import (  # noqa: PLC0415
        Report,
        open_journal,
        subject_of,
        workshop,
    )
    from isogi_report.measuring import STUDIES, measure  # noqa: PLC0415
    from isogi_report.page import write_report  # noqa: PLC0415

    # Refuse unknown studies before anything is measured.
    wanted = chosen_studies(STUDIES, request.only)
    if request.deadline is None:
        deadline = math.inf
    else:
        deadline = begun + request.deadline
    bench = Bench(scene, view, workshop(request.folder), deadline=deadline, exposure=exposure)
    # Find the surface before the journal is opened: an empty view, for which this raises ViewError,
    # must not touch the folder.
    on = bench.surface
    with open_journal(request.folder, subject_of(scene, view, exposure)) as journal:
        measured = measure(STUDIES, wanted, bench, journal)
        found = Report(
            scene, view, exposure, on, measured.done, tuple(notes(measured, request.deadline))
        )
        # Write the page before the journal is closed, so that no other report writes meanwhile.
        page = write_report(request.folder, found)
        return outcome(page, found, measured)


def chosen_studies(studies: Sequence[Study], only: Sequence[str]) -> tuple[Study, ...]:
    """Return the studies with these keys, all of them if none is given.

    Raises ParameterError for an unknown key.
    """
    known = {study.key for study in studies}
    for key in only:
        if key not in known:
            raise ParameterError(
                f"There is no study '{key}': {advice(key, (each.key for each in studies))}"
            )
    return tuple(study for study in studies if not only or study.key in only)


def notes(measured: Measured, deadline: float | None) -> Iterator[str]:
    """Yield sentences on studies that are missing or incomplete, with the reason."""
    late = titles(measured.late)
    # Studies are late because a person stopped the work, or because of the deadline, which is not
    # None then.
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
    """Return the titles of studies, for a sentence."""
    return ", ".join(study.title for study in studies)


def outcome(page: Path, drawn: Report, measured: Measured) -> dict[str, Any]:
    """Return the summary of a report as a document; seconds are of the processor, by section."""
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
    """Return the score of the scene's frame by the names of its columns,
    from the first table of the summary.
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
    """Return the summary of a report as text for a person."""
    count = len(facts["sections"])
    said = f"{facts['page']}: {count} section{'' if count == 1 else 's'}"
    if facts["found"]:
        said = f"{said}, {facts['found']} of them measured before"
    sentences = [f"{said}."]
    score = ", ".join(f"{name} {cell:.3g}" for name, cell in facts["headline"].items())
    if score:
        sentences.append(f"The frame's {score}.")
    return " ".join([*sentences, *facts["notes"]])
