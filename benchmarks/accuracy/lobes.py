"""What lobes cost: frames under a light that turns, and that rests, by how many of its lobes are
lit by shadow rays.

    python -m benchmarks.accuracy lobes [TARGET] [--size 512] [--repeats 15] [--json]

The same view with 0, 1, 2 … lobes of its light, whose texels have few samples; the frames take
turns, and ratios are of medians. "told" is the error that harmonics are expected to have with so
many.
"""

import tempfile
import time
from contextlib import ExitStack
from dataclasses import replace

import click

from benchmarks.common.measurement import Figures, Measurement
from benchmarks.common.scenes import benchmark_scene
from benchmarks.common.suite import part
from benchmarks.common.timing import milliseconds
from isogi_core.frame.renderer import Renderer
from isogi_core.model.scene_plan import MIN_SAMPLES
from isogi_core.model.view import View
from isogi_core.plan.planner import plan_scene
from isogi_core.plan.scene import Scene
from isogi_report.speed import (
    LOOSEST_GOAL,
    Candidate,
    bake_view,
    make_renderer,
    medians,
    relight,
    seconds,
    turned,
    view_of,
)

TURNS = 1000
"""A turn of the light that no other candidate comes to."""

COUNTS = (0, 1, 2, 4)
"""Lobes that are compared, as far as the light has them."""


@part(size=512, repeats=15)
@click.argument("target", required=False)
def lobes(target: str | None, size: int, repeats: int) -> Measurement:
    """What lobes cost in frames, and what harmonics err by beside them."""
    scene = benchmark_scene(target)
    scenes = {n: with_lobes(scene, n) for n in COUNTS if n <= len(scene.inputs.lobes)}
    with ExitStack() as stack:
        candidates: dict[str, Candidate] = {}
        for n, each in scenes.items():
            renderer = make_renderer(each, stack.enter_context(tempfile.TemporaryDirectory()))
            view = view_of(each, size)
            bake_view(renderer, view, MIN_SAMPLES)
            candidates |= {
                f"{n} turned": relight(renderer, view),
                f"{n} at rest": at_rest(renderer, view),
            }
            candidates[f"{n} turned, processor"] = processor(renderer, view)
        median = medians(candidates, repeats)
    figures = {**summarise(median), **overrides(scenes)}
    return Measurement(f"{scene.name} at {scene.isovalue:g}, {size} × {size}", figures)


def with_lobes(scene: Scene, count: int) -> Scene:
    """The scene by the plan that it has with so many lobes."""
    overrides = replace(scene.settings.overrides, lobes=count)
    return replace(
        scene.with_settings(overrides=overrides), plan=plan_scene(scene.inputs, overrides)
    )


def processor(renderer: Renderer, view: View) -> Candidate:
    """What ``relight`` takes of the processor, all threads together, under turns of its own."""

    def render(turn: int) -> float:
        begun = time.process_time()
        renderer.render(turned(view, turn + TURNS), LOOSEST_GOAL)
        return time.process_time() - begun

    return render


def at_rest(renderer: Renderer, view: View) -> Candidate:
    """A frame that is as the one before."""

    def render(turn: int) -> float:
        renderer.render(turned(view, turn), LOOSEST_GOAL)
        return seconds(lambda: renderer.render(turned(view, turn), LOOSEST_GOAL))

    return render


def summarise(median: dict[str, float]) -> Figures:
    """Medians in milliseconds, and how many times as long frames with lobes take."""
    ratios = {
        f"{name} / 0{name[1:]}": time / median[f"0{name[1:]}"] for name, time in median.items()
    }
    return {
        **milliseconds(median),
        **{name: ratio for name, ratio in ratios.items() if not name.startswith("0")},
    }


def overrides(scenes: dict[int, Scene]) -> Figures:
    """The plans' own expectation of what their harmonics err by, and what a texel keeps."""
    errors = {
        f"{n} told, %": 100.0 * dict(scene.plan.errors).get("harmonics", 0.0)
        for n, scene in scenes.items()
    }
    return {
        **errors,
        **{f"{n} bytes a texel": scene.plan.bytes_per_texel for n, scene in scenes.items()},
    }
