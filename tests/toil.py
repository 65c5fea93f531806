"""A processor's clock that goes on with the samples that are taken, not with time."""

import threading
import time
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.bake_spec import BakeSpec
from isogi_core.bake.refine import refine
from isogi_core.bake.texel_light import Light
from isogi_core.frame.frame import Frame
from isogi_core.frame.renderer import Renderer
from isogi_core.model.view import View
from isogi_report import bench, studies

PACE = 1 << 20
"""Samples of texels and of pixels that take a second; a power of two, so that sums of them are exact."""


class Toil:
    """Stands for the ``time`` of a module that measures its work."""

    def __init__(self) -> None:
        self._seconds, self._lock = 0.0, threading.Lock()

    monotonic = staticmethod(time.monotonic)

    def process_time(self) -> float:
        """Seconds of the processor up to now."""
        return self._seconds

    def spend(self, samples: int) -> None:
        """Go on by so many samples."""
        with self._lock:
            self._seconds += samples / PACE


def measure_toil(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have bakes in memory and traced pictures take as long as their samples tell, on any machine."""
    toil, render = Toil(), Renderer.render

    def refined(light: Light, texels: np.ndarray, look: BakeSpec, until: int, target: float) -> None:
        before = taken(light)
        refine(light, texels, look, until, target)
        toil.spend(taken(light) - before)

    def rendered(renderer: Renderer, view: View, *args: Any, **more: Any) -> Frame:
        if view.shading == "path_traced":
            toil.spend(view.samples * view.width * view.height)
        return render(renderer, view, *args, **more)

    monkeypatch.setattr(bench, "time", toil)
    monkeypatch.setattr(bench, "refine", refined)
    monkeypatch.setattr(studies, "time", toil)
    monkeypatch.setattr(Renderer, "render", rendered)


def taken(light: Light) -> int:
    """The samples of all texels that can hold light."""
    return int(np.maximum(light.samples, 0).sum())
