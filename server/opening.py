"""Opening scenes: how much memory and disk their volumes may take, and a bar while a large one is made ready."""

import os
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from isogi_core.model.scene import Scene, build_scene
from isogi_core.model.source import find_source
from server.durations import span
from server.progress import progress_bar
from server.settings import Settings


def open_scene(target: str | Path | None, settings: Settings | None = None, **overrides: Any) -> Scene:
    """The scene at ``target``, as ``load_scene`` has it, its volume kept as the ``settings`` say.

    Raises SceneError, VolumeError or LightError.
    """
    if settings is not None:
        tell_core(settings)
    with ExitStack() as stack:
        return build_scene(find_source(target, overrides), Bar(stack))


def tell_core(settings: Settings) -> None:
    """Have this process, and those that it starts, keep volumes as the settings say: by way of the environment."""
    os.environ["ISOGI_VOLUME_MB"] = str(settings.volume_mb)
    os.environ["ISOGI_VOLUME_CACHE_MB"] = str(settings.volume_cache_mb)
    if settings.volume_cache is not None:
        os.environ["ISOGI_VOLUME_CACHE"] = settings.volume_cache


class Bar:
    """A progress bar that is there once there is any progress."""

    def __init__(self, stack: ExitStack) -> None:
        """Be closed with the ``stack``."""
        self._stack, self._begun = stack, time.monotonic()
        self._bar: Any = None

    def __call__(self, done: int, total: int) -> None:
        """Show how much is done, and the time left at the mean pace so far."""
        if self._bar is None:
            self._bar = self._stack.enter_context(progress_bar("reading the volume", "step"))
        left = (time.monotonic() - self._begun) * (total - done) / done
        self._bar.total = total
        self._bar.set_postfix_str(f"about {span(left, digits=2)} left", refresh=False)
        self._bar.update(done - self._bar.n)
