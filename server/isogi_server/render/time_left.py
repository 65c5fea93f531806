"""The time left of a picture: the parts that it lacks, and the time for their paths."""

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce

from isogi_core.bake.noise import Goal
from isogi_core.cache.costs import Cost
from isogi_core.frame.rays.picture_plan import HEAVIER
from isogi_core.frame.refinement import PathsLeft
from isogi_core.frame.texel_reading import Stage
from isogi_core.frame.view_checks import WorkLeft
from isogi_core.model.view import View
from isogi_core.prepared.prepared_scene import Index
from isogi_worker.progress import (
    ASSUMED_WORK_RATIOS,
    UNREHEARSED_SPREAD,
    TimeLeft,
    log_normal_ratios,
)


@dataclass(frozen=True, eq=False)
class Unfinished:
    """The parts that a picture lacks until it is final, without the picture itself, which takes
    megabytes.

    - ``scene``, ``view``, ``goal``: of the request.
    - ``final``, ``refinable``: as the frame says.
    - ``seconds``: time that drawing it took, by stage.
    - ``bake``, ``chunks``: light that it needs next.
    - ``later``: stages after that.
    - ``parts``: work of its parts after that, each with the bakes that its texels read.
    """

    scene: str
    view: View
    goal: Goal
    final: bool
    refinable: bool
    seconds: Mapping[str, float]
    bake: str = ""
    chunks: tuple[Index, ...] = ()
    later: tuple[Stage, ...] = ()
    parts: tuple[tuple[WorkLeft, tuple[str, ...]], ...] = ()


WAITING_STAGES = ("queue", "bake", "check", "demand")
"""Stages of a frame that are not drawing."""


def time_of_parts(
    left: Sequence[PathsLeft],
    spent: Sequence[Cost],
    threads: int,
    drawing: Mapping[str, float],
    heavier: float = HEAVIER,
) -> TimeLeft:
    """Estimate the time for the paths that are ``left`` to each part of a picture, one part after
    the other; see ``time_of_paths``.

    A part whose paths were not timed yet takes the mean pace of those that were; one whose texels
    have taken no paths yet is judged by those of all others.
    """
    whole = reduce(Cost.plus, spent, Cost())
    paces = [paths.pace for paths in left if paths.pace is not None]
    usual = statistics.fmean(paces) if paces else None
    total = TimeLeft(0.0, 0.0, 0.0)
    for paths, cost in zip(left, spent, strict=True):
        paced = paths._replace(pace=usual if paths.pace is None else paths.pace)
        known = cost if cost.paths else whole
        total = total.plus(time_of_paths(paced, known, threads, drawing, heavier))
    return total


def time_of_paths(
    left: PathsLeft,
    spent: Cost,
    threads: int,
    drawing: Mapping[str, float],
    heavier: float = HEAVIER,
) -> TimeLeft:
    """Estimate the time for the paths that are ``left`` on this number of ``threads``, and for
    drawing the picture meanwhile.

    ``spent`` is the cost of the texels' paths so far; ``drawing`` the seconds of each stage of the
    last frame. If no path of a pixel has been timed yet, it is assumed to take the time of a
    texel's path divided by ``heavier``, and the estimate is less certain.
    """
    # Costs are seconds of one processor; a pixel's pace was measured with all threads at work.
    seconds_a_path = spent.ahead(1.0) / threads
    drawing_once = sum(seconds for stage, seconds in drawing.items() if stage not in WAITING_STAGES)
    pace = left.pace or seconds_a_path / heavier
    work = left.texels * seconds_a_path + left.pixels * pace + left.times * drawing_once
    if left.pace is None:
        return TimeLeft.of(work, ASSUMED_WORK_RATIOS)
    return TimeLeft.of(work, log_normal_ratios(UNREHEARSED_SPREAD))
