"""Kernels of a scene that is admitted late: how far their compilation is."""

import threading
from collections.abc import Iterable
from typing import Any

import pytest

from isogi_core.kernels._compilation import KernelProgress
from server.render import workforce
from server.render.workforce import SceneKernels
from tests.loaded import load_scene

LONG = 20.0
FAR = KernelProgress(1, 3, 4.0)


class Slow:
    """In place of a Compilation: nothing is compiled but what ``go`` lets go, of the one scene that is admitted."""

    go = threading.Event()
    waiting = threading.Event()

    def __init__(self, *stages: Iterable[Any]) -> None:
        self.begun = False

    def begin(self, _stopped: threading.Event, _niceness: int = 0) -> None:
        self.begun = True

    def wait(self, _kernels: Iterable[Any]) -> None:
        self.waiting.set()
        assert self.go.wait(LONG)

    def progress(self, kernels: Iterable[Any]) -> KernelProgress | None:
        assert list(kernels)
        return FAR if self.begun and not self.go.is_set() else None


def test_what_an_admitted_scene_lacks_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workforce, "Compilation", Slow)
    monkeypatch.setattr(workforce, "load", lambda *_: None)
    scene = load_scene("demo:orbital")
    known = SceneKernels(lambda: [scene], threading.Event())
    assert known.progress is None
    work = threading.Thread(target=known.admit, args=[scene])
    work.start()
    assert Slow.waiting.wait(LONG)
    assert known.progress == FAR
    assert known.compiling == "Compiling, once on this machine: 1 of 3, about 4 s left."
    Slow.go.set()
    work.join(LONG)
    assert known.progress is None and known.compiling == ""
