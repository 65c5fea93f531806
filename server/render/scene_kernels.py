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
from server.progress import about_left
from worker.fork_server import START_METHOD, start_fork_server
from worker.tasks import bake_kernels

log = logging.getLogger("isogi.server")


KERNELS_ELSEWHERE = (
    "The folder of compiled kernels %s cannot be written: what it lacks is compiled into %s."
)
COMPILATION_PROGRESS = "Compiling, once on this machine: {done} of {total}"


class SceneKernels:
    """What pictures of the ``scenes``, and bakes of their light, call. Work ends early once
    ``stopped`` is set.
    """

    def __init__(self, scenes: Callable[[], Collection[Scene]], stopped: threading.Event) -> None:
        """Compile nothing yet. ``scenes`` gives those that are shown at the moment."""
        self._scenes = scenes
        self._stopped = stopped
        self.kinds = {kind for each in scenes() for kind in each.bakes}
        lit = *frame_kernels(scenes(), surveyed=False), *bake_kernels(self.kinds)
        self._lit = (*first_kernels(scenes()), *lit)
        self._all = Compilation(first_kernels(scenes()), self._lit)
        self._admitted: tuple[Compilation, list[Any]] | None = None

    @property
    def progress(self) -> KernelProgress | None:
        """How far the kernels of pictures and their light are compiled, or else of the scene that
        was admitted last; None where this machine has them all.
        """
        own = self._all.progress(self._lit)
        admitted = self._admitted
        return own or (admitted[0].progress(admitted[1]) if admitted else None)

    @property
    def compiling(self) -> str:
        """``progress`` for a person; empty where this machine has them all."""
        progress = self.progress
        if progress is None:
            return ""
        far = COMPILATION_PROGRESS.format(done=progress.done, total=progress.total)
        return ", ".join(filter(None, (far, about_left(progress.seconds)))) + "."

    def first(self) -> None:
        """Have kernels of pictures without light in this process; the others begin to be
        compiled.
        """
        if self.progress is not None:
            start_fork_server()
        self._all.begin(self._stopped, COMPILER_NICENESS, START_METHOD)
        self._all.wait(first_kernels(self._scenes()))
        load(first_kernels(self._scenes()), self._stopped)

    def light(self) -> None:
        """Have kernels of pictures with light in this process, and those of bakes on this
        machine.
        """
        self._all.wait(self._lit)
        load(frame_kernels(self._scenes()), self._stopped)
        prune_folders(KERNEL_FOLDER)
        if READ_ONLY_FOLDER is not None:
            log.info(KERNELS_ELSEWHERE, READ_ONLY_FOLDER, KERNEL_FOLDER)

    def others(self) -> None:
        """Have kernels of pictures without light from texels, and of whole paths, in this
        process.
        """
        warm(other_kernels(self._scenes()), self._stopped, COMPILER_NICENESS)

    def admit(self, scene: Scene) -> None:
        """Have kernels of pictures of one more scene in this process."""
        kernels = list(frame_kernels([scene]))
        work = Compilation(kernels)
        self._admitted = work, kernels
        work.begin(self._stopped)
        work.wait(kernels)
        load(kernels, self._stopped)
