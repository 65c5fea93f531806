"""Frame times of all shadings side by side, cache warm, and what turning only the light costs.

    python -m benchmarks.frames [TARGET] [--size 512] [--repeats 15] [--json]

Every camera is new to the renderer, so that each frame casts its primary rays; shadings are
interleaved, and ratios are of medians (S1, table 2 has SH at 1.45 × Lambert and 0.75 × with shadow).
"""

import json
import math
import statistics
import tempfile
import time
from dataclasses import replace

import click

from benchmarks.common import bake_view, benchmark_scene, make_renderer, show, view_of
from isogi_core.frame.film import develop
from isogi_core.frame.renderer import Renderer
from isogi_core.model.view import View, quaternion_from_angles

SHADINGS = ("gi", "lambert", "lambert_shadow", "lambert_fog", "phong", "phong_shadow")
SAMPLES = 16


@click.command()
@click.argument("target", required=False)
@click.option("--size", default=512, show_default=True, help="Pixels along each side.")
@click.option("--repeats", default=15, show_default=True, help="Frames of each shading.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def main(target: str | None, size: int, repeats: int, as_json: bool) -> None:
    """Time frames."""
    scene = benchmark_scene(target)
    with tempfile.TemporaryDirectory() as store:
        renderer = make_renderer(scene, store)
        view = view_of(scene, size)
        frame = bake_view(renderer, view, SAMPLES, 1e-9)
        texels = sum(len(demand.offsets) for demand in frame.demands)
        figures = summarise(measure(renderer, view, repeats))
        figures["lattice / texels of this view"] = math.prod(renderer.recipe.shape) / texels
    if as_json:
        click.echo(json.dumps(figures))
    else:
        show(f"{scene.name} at {scene.isovalue:g}, {size} × {size}, {renderer.tiles.threads} threads", figures)


def measure(renderer: Renderer, view: View, repeats: int) -> dict[str, list[float]]:
    """Seconds of each frame, by shading, and of "relight": the light turned and nothing else."""
    exposure = renderer.recipe.scene.default_exposure
    times: dict[str, list[float]] = {name: [] for name in (*SHADINGS, "relight", "develop")}
    for turn in range(repeats + 1):
        for shading in SHADINGS:
            renderer.forget_views()
            times[shading].append(seconds(renderer, replace(view, shading=shading)))
        renderer.render(view)
        turned = replace(view, light=quaternion_from_angles(7.0 * turn + 3.0, 5.0, 2.0))
        times["relight"].append(seconds(renderer, turned))
        begun = time.perf_counter()
        develop(renderer.render(turned), exposure)
        times["develop"].append(time.perf_counter() - begun)
    return {name: taken[1:] for name, taken in times.items()}


def seconds(renderer: Renderer, view: View) -> float:
    """Time one frame."""
    begun = time.perf_counter()
    renderer.render(view)
    return time.perf_counter() - begun


def summarise(times: dict[str, list[float]]) -> dict[str, float]:
    """Medians in milliseconds, and the ratios that are asked for."""
    median = {name: 1000.0 * statistics.median(taken) for name, taken in times.items()}
    return {
        **{f"{name}_ms": value for name, value in median.items()},
        "gi / lambert": median["gi"] / median["lambert"],
        "gi / lambert_shadow": median["gi"] / median["lambert_shadow"],
        "relight / gi": median["relight"] / median["gi"],
    }


if __name__ == "__main__":
    main()
