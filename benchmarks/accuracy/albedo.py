"""What an albedo that is a slider costs, and how near its frames come to a fresh bake of each
albedo.

    python -m benchmarks.accuracy albedo [TARGET] [--light probe|constant] [--size 96] [--samples
    1024] [--repeats 9]

The scene at albedo 0.3, of which views may ask for up to 0.9, is baked once; then its frames at
other albedos are held against scenes of those. "apart" is the relative RMSE of luminance beside a
bake by that scene's own plan, noise of both among it; "mixed" beside one of the same paths, which
is what mixing errs by. Bakes are in seconds of the processor.
"""

import math
import tempfile
import time
from contextlib import ExitStack
from dataclasses import replace

import click
import numpy as np

from benchmarks.common.measurement import Measurement
from benchmarks.common.scenes import benchmark_scene
from benchmarks.common.suite import part
from benchmarks.common.timing import milliseconds
from isogi_core.frame.frame import Frame
from isogi_core.frame.renderer import Renderer
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene
from isogi_report.speed import Candidate, bake_view, make_renderer, medians, seconds, view_of

START = 0.3
RANGE = (0.0, 0.9)
"""The albedo at which the scene is baked, and those that views may ask for."""

SHOWN = {
    "0.1": (0.1,) * 3,
    "0.3": (0.3,) * 3,
    "0.6": (0.6,) * 3,
    "0.9": (0.9,) * 3,
    "0.9,0.5,0.1": (0.9, 0.5, 0.1),
}
"""Albedos of the frames that are compared."""


@part(size=96, repeats=9)
@click.argument("target", required=False)
@click.option(
    "--light", type=click.Choice(["probe", "constant"]), default="probe", help="Of the engine."
)
@click.option(
    "--samples",
    type=click.IntRange(16),
    default=1024,
    show_default=True,
    help="Paths of each texel.",
)
def albedo(target: str | None, light: str, samples: int, size: int, repeats: int) -> Measurement:
    """What an albedo that is a slider costs, and how near its frames come to fresh bakes."""
    live = benchmark_scene(target, light, albedo=START, albedos=RANGE, bounces=None)
    figures: dict[str, float] = {}
    with ExitStack() as stack:

        def baked(scene: Scene, name: str) -> tuple[Renderer, View]:
            renderer = make_renderer(scene, stack.enter_context(tempfile.TemporaryDirectory()))
            view = view_of(scene, size)
            begun = time.process_time()
            bake_view(renderer, view, samples)
            if name:
                figures[f"{name} bake, s"] = time.process_time() - begun
                figures[f"{name} bytes a texel"] = scene.plan.bytes_per_texel
            return renderer, view

        renderer, view = baked(live, "live")
        candidates: dict[str, Candidate] = {"live, albedo moved": moved(renderer, view)}
        for name, shown in SHOWN.items():
            fresh = benchmark_scene(target, light, albedo=list(shown), bounces=None)
            own = baked(fresh, name)
            ours = renderer.render(replace(view, albedo=shown))
            figures[f"{name} apart, %"] = apart(ours, own[0].render(own[1]))
            alike, same = baked(of_same_paths(fresh, live), "")
            figures[f"{name} mixed, %"] = apart(ours, alike.render(same))
            candidates[f"{name} fresh"] = at_rest(*own)
        figures |= milliseconds(medians(candidates, repeats))
    figures["told, %"] = 100.0 * dict(live.plan.errors).get("albedo", 0.0)
    title = (
        f"{live.name} at {live.isovalue:g}, {size} × {size}, {samples} paths a texel, kept "
        f"for {live.plan.nodes}"
    )
    return Measurement(title, figures, variant="constant" if light == "constant" else "")


def of_same_paths(fresh: Scene, live: Scene) -> Scene:
    """A scene of one albedo whose texels take the paths of one of several, and keep as many
    harmonics.
    """
    direct, indirect = live.plan.layers
    own = replace(indirect, nodes=(), channels=1 if len({*fresh.surfaces.albedo}) == 1 else 3)
    return replace(fresh, plan=replace(live.plan, layers=(direct, own)))


def apart(frame: Frame, other: Frame) -> float:
    """Relative RMSE of the luminance of a frame's surface pixels beside another, percent."""
    on = frame.state > 0
    ours, theirs = (
        each.radiance[on].astype(np.float64) @ LUMINANCE_WEIGHTS for each in (frame, other)
    )
    return 100.0 * math.sqrt(((ours - theirs) ** 2).mean()) / float(theirs.mean())


def moved(renderer: Renderer, view: View) -> Candidate:
    """A frame whose albedo alone is another than before."""
    return lambda turn: seconds(
        lambda: renderer.render(replace(view, albedo=(0.2 + 0.6 * ((0.37 * turn) % 1.0),) * 3))
    )


def at_rest(renderer: Renderer, view: View) -> Candidate:
    """A frame that is as the one before."""
    return lambda turn: seconds(lambda: renderer.render(view))
