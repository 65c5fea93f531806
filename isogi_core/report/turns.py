"""Wall time of frames, told by candidates that take turns, so that other work on the machine counts for all alike."""

import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import replace

from isogi_core.frame.renderer import Renderer
from isogi_core.model.view import View, quaternion_from_angles

Candidate = Callable[[int], float]
"""Does its work in the given round and tells the seconds that it took."""


def seconds(work: Callable[[], object]) -> float:
    """Time some work."""
    begun = time.perf_counter()
    work()
    return time.perf_counter() - begun


def timed(work: Callable[[], object]) -> Candidate:
    """A candidate that does the same in every round."""
    return lambda _: seconds(work)


def take_turns(candidates: Mapping[str, Candidate], repeats: int) -> dict[str, list[float]]:
    """Seconds of each candidate in ``repeats`` rounds; all of them work in each round, and round 0 is not counted."""
    times: dict[str, list[float]] = {name: [] for name in candidates}
    for turn in range(repeats + 1):
        for name, candidate in candidates.items():
            times[name].append(candidate(turn))
    return {name: taken[1:] for name, taken in times.items()}


def medians(candidates: Mapping[str, Candidate], repeats: int) -> dict[str, float]:
    """Median seconds of candidates that take turns."""
    return {name: statistics.median(taken) for name, taken in take_turns(candidates, repeats).items()}


def new_camera(renderer: Renderer, view: View) -> Candidate:
    """A frame of ``view`` from a camera that is new to the renderer."""

    def render(_: int) -> float:
        renderer.forget_views()
        return seconds(lambda: renderer.render(view))

    return render


def turned(view: View, turn: int) -> View:
    """The view under a light that is turned otherwise in each round."""
    return replace(view, light=quaternion_from_angles(7.0 * turn + 3.0, 5.0, 2.0))


def relight(renderer: Renderer, view: View) -> Candidate:
    """A frame that differs from the last one by its light's rotation alone."""

    def render(turn: int) -> float:
        renderer.render(view)
        return seconds(lambda: renderer.render(turned(view, turn)))

    return render
