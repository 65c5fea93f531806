"""The kernels that pictures of scenes and bakes of their light call, compiled in order of need."""

import logging
import threading
from collections.abc import Callable, Collection
from typing import Any

from isogi_core.frame.entry_kernels import first_kernels, frame_kernels, other_kernels
from isogi_core.kernels._cache_folder import prune_folders
from isogi_core.kernels._compilation import COMPILER_NICENESS, Compilation, KernelProgress, warm
from isogi_core.kernels._jit import KERNEL_FOLDER, READ_ONLY_FOLDER, load
from isogi_core.plan.scene import Scene
from isogi_server.progress import about_left
from isogi_worker.fork_server import START_METHOD, start_fork_server
from isogi_worker.tasks import bake_kernels

log = logging.getLogger("isogi.server")


KERNELS_ELSEWHERE = (
    "The folder of compiled kernels %s cannot be written: what it lacks is compiled into %s."
)
COMPILATION_PROGRESS = "Compiling, once on this machine: {done} of {total}"


class SceneKernels:
    """The kernels that pictures of ``scenes``, and bakes of their light, call. All work ends
    early once ``stopped`` is set.
    """

    def __init__(self, scenes: Callable[[], Collection[Scene]], stopped: threading.Event) -> None:
        """Find out which kernels are needed, but compile none yet. ``scenes`` returns the
        scenes that are shown at the moment.
        """
        self._scenes = scenes
        self._stopped = stopped
        self.kinds = {kind for each in scenes() for kind in each.bakes}
        lit = *frame_kernels(scenes(), surveyed=False), *bake_kernels(self.kinds)
        self._lit = (*first_kernels(scenes()), *lit)
        self._all = Compilation(first_kernels(scenes()), self._lit)
        self._admitted: tuple[Compilation, list[Any]] | None = None

    @property
    def progress(self) -> KernelProgress | None:
        """Return the progress of compiling the kernels of pictures and their light, or else
        those of the scene admitted last; None if all are compiled.
        """
        own = self._all.progress(self._lit)
        admitted = self._admitted
        return own or (admitted[0].progress(admitted[1]) if admitted else None)

    @property
    def compiling(self) -> str:
        """Return the progress as a sentence; empty if all kernels are compiled."""
        progress = self.progress
        if progress is None:
            return ""
        far = COMPILATION_PROGRESS.format(done=progress.done, total=progress.total)
        return ", ".join(filter(None, (far, about_left(progress.seconds)))) + "."

    def first(self) -> None:
        """Compile and load the kernels of pictures without light. The other kernels are
        compiled in the background from now on.
        """
        # Start the process that compilers are forked from: it loads meanwhile.
        if self.progress is not None:
            start_fork_server()
        self._all.begin(self._stopped, COMPILER_NICENESS, START_METHOD)
        self._all.wait(first_kernels(self._scenes()))
        load(first_kernels(self._scenes()), self._stopped)

    def light(self) -> None:
        """Wait until the kernels of lit pictures and of bakes are compiled, and load the
        former. Then prune old folders of compiled kernels.
        """
        self._all.wait(self._lit)
        load(frame_kernels(self._scenes()), self._stopped)
        prune_folders(KERNEL_FOLDER)
        if READ_ONLY_FOLDER is not None:
            log.info(KERNELS_ELSEWHERE, READ_ONLY_FOLDER, KERNEL_FOLDER)

    def others(self) -> None:
        """Compile and load the kernels of pictures that need no texels, such as path-traced
        ones.
        """
        warm(other_kernels(self._scenes()), self._stopped, COMPILER_NICENESS)

    def admit(self, scene: Scene) -> None:
        """Compile and load the kernels of pictures of one more scene."""
        kernels = list(frame_kernels([scene]))
        work = Compilation(kernels)
        self._admitted = work, kernels
        work.begin(self._stopped)
        work.wait(kernels)
        load(kernels, self._stopped)
