"""What lobes cost: frames under a light that turns, and that rests, by how many of its lobes are lit by shadow rays.

    python -m benchmarks.lobes [TARGET] [--size 512] [--repeats 15] [--json]

The same view with 0, 1, 2 … lobes of its light, whose texels have few samples; the frames take turns, and ratios are
of medians. "told" is the error that harmonics are expected to have with so many.
"""

import tempfile
import time
from contextlib import ExitStack
from dataclasses import replace

import click

from benchmarks.common import Figures, benchmark_scene, milliseconds, options, show
from isogi_core.bake.precision import FIRST_RUNG
from isogi_core.frame.renderer import Renderer
from isogi_core.model.scene import Scene
from isogi_core.model.view import View
from isogi_core.plan.needs import Told
from isogi_core.plan.planner import plan_scene
from isogi_core.report.turns import Candidate, medians, relight, seconds, turned
from server.measure import bake_view, make_renderer, view_of

TURNS = 1000
"""A turn of the light that no other candidate comes to."""

COUNTS = (0, 1, 2, 4)
"""Lobes that are compared, as far as the light has them."""


@click.command()
@click.argument("target", required=False)
@options(repeats=15)
def main(target: str | None, size: int, repeats: int, as_json: bool) -> None:
    """Time frames."""
    scene = benchmark_scene(target)
    scenes = {n: with_lobes(scene, n) for n in COUNTS if n <= len(scene.needs.lobes)}
    with ExitStack() as stack:
        candidates: dict[str, Candidate] = {}
        for n, each in scenes.items():
            renderer = make_renderer(each, stack.enter_context(tempfile.TemporaryDirectory()))
            view = view_of(each, size)
            bake_view(renderer, view, FIRST_RUNG)
            candidates |= {f"{n} turned": relight(renderer, view), f"{n} at rest": at_rest(renderer, view)}
            candidates[f"{n} turned, processor"] = processor(renderer, view)
        median = medians(candidates, repeats)
    figures = {**summarise(median), **told(scenes)}
    show(f"{scene.name} at {scene.isovalue:g}, {size} × {size}, {renderer.tiles.threads} threads", figures, as_json)


def with_lobes(scene: Scene, count: int) -> Scene:
    """The scene by the plan that it has with so many lobes."""
    told = replace(scene.told or Told(), lobes=count)
    return replace(scene, told=told, plan=plan_scene(scene.needs, told))


def processor(renderer: Renderer, view: View) -> Candidate:
    """What ``relight`` takes of the processor, all threads together, under turns of its own."""

    def render(turn: int) -> float:
        begun = time.process_time()
        renderer.render(turned(view, turn + TURNS))
        return time.process_time() - begun

    return render


def at_rest(renderer: Renderer, view: View) -> Candidate:
    """A frame that is as the one before."""

    def render(turn: int) -> float:
        renderer.render(turned(view, turn))
        return seconds(lambda: renderer.render(turned(view, turn)))

    return render


def summarise(median: dict[str, float]) -> Figures:
    """Medians in milliseconds, and how many times as long frames with lobes take."""
    ratios = {f"{name} / 0{name[1:]}": time / median[f"0{name[1:]}"] for name, time in median.items()}
    return {**milliseconds(median), **{name: ratio for name, ratio in ratios.items() if not name.startswith("0")}}


def told(scenes: dict[int, Scene]) -> Figures:
    """The plans' own expectation of what their harmonics err by, and what a texel keeps."""
    errors = {f"{n} told, %": 100.0 * dict(scene.plan.errors).get("harmonics", 0.0) for n, scene in scenes.items()}
    return {**errors, **{f"{n} bytes a texel": scene.plan.bytes_per_texel for n, scene in scenes.items()}}


if __name__ == "__main__":
    main()
