"""Series in time on the command line: which steps of one are meant, and what goes wrong at one of them."""

import re
from collections.abc import Iterator
from contextlib import contextmanager

from isogi_core.errors import ViewError
from isogi_core.plan.scene import Scene
from server.errors import ParameterError
from server.values import shown

STEPS_PATTERN = re.compile(r"(\d{1,7})(?::(\d{1,7})(?::0*([1-9]\d{0,6}))?)?", re.ASCII)
"""What steps of a series look like: 3, 0:9 or 0:9:3."""


def steps_in(text: str, scene: Scene) -> list[int]:
    """The steps of the scene's series that a ``text`` names: all, one, first:last or first:last:step.

    Raises ParameterError where it names none, or the scene's volume is no series that has them.
    """
    count = scene.volume.moment[1]
    if count < 2:
        raise ParameterError(f"The volume '{scene.volume.name}' is no series in time: leave times out.", "times")
    found = STEPS_PATTERN.fullmatch(text)
    if text != "all" and found is None:
        raise ParameterError(f"times must be all, a step, or first:last:step, not {shown(text)}.", "times")
    first, last, step = ("0", str(count - 1), "1") if found is None else found.groups()
    steps = range(int(first), int(last or first) + 1, int(step or 1))
    if not steps or steps[-1] >= count:
        raise ParameterError(f"times = {shown(text)}: the series has the steps 0 to {count - 1}.", "times")
    return list(steps)


@contextmanager
def at_step(time: int) -> Iterator[None]:
    """Say at which step of a series a view cannot be had: value ranges are each step's."""
    try:
        yield
    except ViewError as error:
        name = error.parameter if isinstance(error, ParameterError) else ""
        raise ParameterError(f"Step {time} of the series: {error}", name) from None
