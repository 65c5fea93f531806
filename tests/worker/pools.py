"""Tasks for worker pools, and how tests have workers do other things."""

import os
import pickle
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

import numba
import numpy as np

from isogi_core.bake.bake_spec import spec_for
from isogi_core.bake.noise import Goal
from isogi_core.kernels._compilation import with_callees
from isogi_core.kernels._jit import Entry
from isogi_core.plan.assembly import load_scene
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_core.storage.backend import StoreUrl
from isogi_core.storage.store import Store
from isogi_worker.local_pool import LocalPool
from isogi_worker.pool import WorkerPool
from isogi_worker.tasks import BakeResult, BakeTask

SCENE = load_scene("demo:orbital", order=2, lattice=0.4, bounces=1, target_error=0.5)
SPEC = spec_for(PreparedScene(SCENE), "gi")
TEXELS = np.arange(0, 4096, 40, dtype=np.int32)
LONG = 240.0
"""Seconds within which workers have come, baked or gone, also on a slow machine."""


def kernel_cache() -> dict[str, tuple[int, int]]:
    folder = Path(numba.config.CACHE_DIR)
    return {
        path.name: (path.stat().st_size, path.stat().st_mtime_ns) for path in folder.rglob("*.nb*")
    }


def bake_all(pool: WorkerPool, tasks: list[BakeTask]) -> list[BakeResult]:
    """Results of the tasks, handed over together."""
    results: list[BakeResult] = []
    errors: list[BaseException | None] = []
    ended = threading.Semaphore(0)

    def done(result: BakeResult | None, error: BaseException | None) -> None:
        results.append(result) if result is not None else errors.append(error)
        ended.release()

    for task in tasks:
        pool.submit(task, done)
    for _ in tasks:
        assert ended.acquire(timeout=LONG)
    if errors:
        raise errors[0] or AssertionError("a task ended without a result and without an error")
    return results


def made(root: Path) -> StoreUrl:
    """The place of a store that a server has made."""
    Store(root).open()
    return StoreUrl(str(root))


def tasks_for(store: Path, digest: str = SPEC.digest) -> list[BakeTask]:
    indices = [(z, y, 0) for z in (0, 1) for y in (0, 1)]
    what = (SCENE.source, SPEC.plan, digest, made(store))
    seen = np.ones(len(TEXELS), np.float32)
    return [BakeTask(*what, index, TEXELS, seen, 64, Goal(0.5)) for index in indices]


def kernels_of_this_process() -> dict[str, bool]:
    """The entry kernels that this process has loaded, by name, and whether it had to compile
    them.
    """
    modules = [
        module
        for name, module in sys.modules.copy().items()
        if name.startswith("isogi_core.kernels.")
    ]
    entries = {
        x.name: x
        for module in modules
        for x in vars(module).copy().values()
        if isinstance(x, Entry)
    }
    return {name: bool(x.ready.stats.cache_misses) for name, x in entries.items() if x.loaded}


def named(kernels: Iterable[Any]) -> set[str]:
    """The names of entry kernels, and of those that they call."""
    return {kernel.name for kernel in with_callees(kernels)}


def run(pool: LocalPool, work: Callable[..., Any], *what: Any) -> list[Any]:
    """What each worker of a pool makes of some work; its error is raised."""
    with tempfile.TemporaryDirectory() as folder:
        workers = len(pool.pids())
        pool.prepare(partial(leave_answer, Path(folder), work, what))
        deadline = time.monotonic() + LONG
        while len(paths := [*Path(folder).glob("*.answer")]) < workers:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        answers = [pickle.loads(path.read_bytes()) for path in paths]
    for _, error in answers:
        if error is not None:
            raise error
    return [result for result, _ in answers]


def leave_answer(folder: Path, work: Callable[..., Any], what: tuple[Any, ...]) -> None:
    """In a worker: leave what some work makes, or its error, in a file of its own."""
    answer: tuple[Any, Exception | None]
    try:
        answer = work(*what), None
    except Exception as error:
        answer = None, error
    path = folder / f"{os.getpid()}.partial"
    path.write_bytes(pickle.dumps(answer))
    path.rename(path.with_suffix(".answer"))


def sleep_for_ever(*_: object) -> None:
    """Stand in for a worker that never takes jobs."""
    time.sleep(600.0)
