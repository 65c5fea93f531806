"""A report: what was measured of a view, and what its files are called."""

from dataclasses import dataclass

import numpy as np

from isogi_core.model.view import View
from isogi_core.plan.scene import Scene
from isogi_core.report.sections import Section
from server.report.journal import Entry

PAGE, DATA = "index.html", "report.json"


@dataclass(frozen=True, eq=False)
class Report:
    """The sections of a view, in the order of the page, and ``notes`` on what is missing.

    Pictures show radiance times ``exposure`` ``on`` (h, w) the surface, and the film's background beside it.
    """

    scene: Scene
    view: View
    exposure: float
    on: np.ndarray
    entries: tuple[Entry, ...]
    notes: tuple[str, ...] = ()


def picture_name(section: Section, i: int, suffix: str = "png") -> str:
    """Where picture ``i`` of a section is, from the report's folder."""
    return f"pictures/{section.key}-{i + 1}.{suffix}"


def plot_name(section: Section, i: int) -> str:
    """Where plot ``i`` of a section is, from the report's folder."""
    return f"plots/{section.key}-{i + 1}.svg"
