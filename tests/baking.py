"""Bakes by an engine that no picture's check decides about: each texel alone, as far as its own
noise asks.
"""

from isogi_core.bake.noise import Goal
from isogi_core.frame.frame import Frame
from isogi_core.model.view import View
from isogi_server.render.engine import RenderEngine

LONG = 120.0
"""Seconds that no bake of these tests takes."""


def bake_each_texel(engine: RenderEngine, scene: str, view: View) -> Frame:
    """The frame of a view once each of its texels is good enough for any picture of the scene's
    target error.
    """
    goal = Goal(engine.planned(scene).target_error)
    while (frame := engine.survey(scene, view, goal)).stages:
        bake, stage = engine.lacking(scene, frame)
        engine.bake(bake, stage).wait(LONG)
    return frame
