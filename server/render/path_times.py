"""The time that pixels of a picture take for paths of their own."""

from isogi_core.cache.costs import Cost
from isogi_core.frame.view_checks import PathsLeft
from worker.progress import PRIOR, UNKNOWN, TimeLeft, log_normal_ratios


def time_of_paths(left: PathsLeft, spent: Cost, threads: int) -> TimeLeft:
    """The time for the paths that are ``left``, on so many ``threads``.

    Before the first of them a path takes as long as those of the texels, for which so much was ``spent``.
    """
    if left.pace is not None:
        return TimeLeft.of(left.paths * left.pace, log_normal_ratios(UNKNOWN))
    seconds = spent.seconds / max(spent.paths, 1) / threads
    return TimeLeft.of(left.paths * seconds, PRIOR)
