"""Frames of several surfaces, drawn and baked in this process, side by side."""

from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.frame.frame import Frame
from isogi_core.frame.several.composed_frame import parts_of
from isogi_core.model.view import View
from tests.frame.conftest import Workbench, refine_chunk


def drawn(bench: Workbench, view: View) -> Frame:
    """The frame of a view with the light that is there."""
    frame = bench.renderer.render(view)
    assert parts_of(frame)
    return frame


def bake(bench: Workbench, view: View, rungs: int | None = None) -> Frame:
    """Bake rung by rung all that is wanted; of so many ``rungs`` where they are given."""
    rung = FIRST_LEVEL
    frame = drawn(bench, view)
    while frame.stages and (rungs is None or rung < FIRST_LEVEL << rungs):
        for stage in frame.stages:
            caches = stage.caches or bench.caches
            if stage.shown is None:
                loader = caches.of("gi")
            else:
                loader = caches.projected(stage.shown)
            for demand in stage.demands:
                refine_chunk(loader, rung, stage.goal.error, demand)
        rung = 2 * rung
        frame = drawn(bench, view)
    return frame


def check(bench: Workbench, view: View) -> Frame:
    """Bring the picture of a view to its target, with all the light that this takes."""
    frame = bake(bench, view)
    while bench.renderer.refine(view):
        frame = bake(bench, view)
    return frame
