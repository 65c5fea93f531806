"""All cases: importing this tells them, and puts them in the order of the page."""

from benchmarks.stability import (  # noqa: F401
    box_volumes,
    boxes,
    cells,
    faces,
    fields,
    furnace,
    invariance,
    leaks,
    lights,
    queries,
    ramps,
    range_volumes,
    ranges,
    rays,
    refusals,
    sameness,
    samples,
    service,
    settings,
    stiff_volumes,
    telling,
    turns,
    views,
    walls,
)
from benchmarks.stability.case import CASES
from benchmarks.stability.specimen import SPECIMENS

__all__ = ["CASES", "SPECIMENS"]

GROUPS = (
    leaks.GROUP,
    views.GROUP,
    stiff_volumes.GROUP,
    ramps.GROUP,
    walls.GROUP,
    furnace.GROUP,
    range_volumes.GROUP,
    box_volumes.GROUP,
    invariance.GROUP,
    lights.GROUP,
    turns.GROUP,
    settings.GROUP,
    samples.GROUP,
    refusals.GROUP,
    sameness.GROUP,
    service.GROUP,
    telling.GROUP,
)
"""Of cases, from rays to what a user is told: each has one table of the page."""

CASES.sort(key=lambda case: GROUPS.index(case.group))
