"""Engines over a bucket, and what they leave in it."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from hashlib import sha256
from pathlib import Path

from isogi_core.plan.assembly import load_scene
from isogi_core.storage.store import Store
from isogi_server.render.engine import RenderEngine
from tests.cluster.processes import ROOT, end, until
from tests.server.inline import LONG, view_of

Begin = Callable[..., RenderEngine]
"""What the fixture ``begin`` is."""


@contextmanager
def engine_at(scene: Path, store: str) -> Iterator[RenderEngine]:
    """An engine over a store, begun."""
    with closing(RenderEngine([load_scene(scene)], store)) as engine:
        engine.start()
        yield engine


def picture(engine: RenderEngine) -> bytes:
    """The final picture of a view."""
    scene = engine.scenes["small"]
    frame = engine.frame("small", view_of(scene), wait=LONG)
    assert not frame.provisional
    return frame.radiance.tobytes()


def chunks_at(url: str) -> dict[str, str]:
    """The chunks in a bucket by name, and the digest of each."""
    store = Store(url)
    keys = [entry.key for entry in store.entries() if "/c/" in entry.key]
    return {key: sha256(store.read(key) or b"").hexdigest() for key in keys}


def killed_when(condition: Callable[[], bool], *command: str) -> None:
    """Run a command of isogi, and kill it once a condition holds, unless it has ended by itself."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    silent = subprocess.DEVNULL
    program = [sys.executable, "-m", "isogi_server", *command]
    process = subprocess.Popen(program, env=environment, stdout=silent, stderr=silent)
    until(lambda: condition() or process.poll() is not None)
    if process.poll() is None:
        end(process)
