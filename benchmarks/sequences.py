"""How far pictures jump as the isovalue slides and as the light turns, beside how far the truth does.

    python -m benchmarks.sequences [SCENE.toml] [--from 50] [--to 110] [--step 4] [--size 64] [--sharpen] [--json]

By default the engine block: the issue of banding and fading shadows while a slider moves (S1, figures 4 and 12).
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import click
import numpy as np

from benchmarks.common import benchmark_scene, show
from isogi_core.model.view import View
from isogi_core.report.bench import Bench
from isogi_core.report.sequences import Jump, jumps, shots, slide, turn


def figures_of(name: str, found: list[Jump]) -> dict[str, float]:
    """What a sequence comes to, in percent of the mean luminance."""
    worst = int(np.argmax([each.beyond for each in found]))
    return {
        f"{name}: steps": len(found),
        f"{name}: the truth's jump, root mean square, mean": 100.0 * float(np.mean([each.own for each in found])),
        f"{name}: beyond it, mean": 100.0 * float(np.mean([each.beyond for each in found])),
        f"{name}: beyond it, largest": 100.0 * found[worst].beyond,
        f"{name}: the truth's there": 100.0 * found[worst].own,
        f"{name}: beyond it, 99th percentile of pixels, largest": 100.0 * max(each.p99 for each in found),
    }


@click.command()
@click.argument("target", required=False)
@click.option("--light", type=click.Choice(["constant", "probe"]), default="constant", show_default=True)
@click.option("--from", "first", default=50.0, show_default=True, help="The first isovalue.")
@click.option("--to", "last", default=110.0, show_default=True, help="The last isovalue.")
@click.option("--step", default=4.0, show_default=True, help="From one isovalue to the next.")
@click.option("--degrees", default=5.0, show_default=True, help="From one light to the next.")
@click.option("--turns", default=0, show_default=True, help="Steps that the light turns.")
@click.option("--paths", default=512, show_default=True, help="Paths from each pixel of the references.")
@click.option("--size", default=64, show_default=True, help="Pixels a side.")
@click.option("--error", default=0.02, show_default=True, help="Target error of the light.")
@click.option("--sharpen", is_flag=True, help="Light texels on the isosurface of each frame.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def main(
    target: str | None,
    light: str,
    first: float,
    last: float,
    step: float,
    degrees: float,
    turns: int,
    paths: int,
    size: int,
    error: float,
    sharpen: bool,
    as_json: bool,
) -> None:
    """Slide the isovalue of TARGET, the engine block by default, and turn its light."""
    scene = benchmark_scene(target, light, target_error=error)
    scene = replace(scene, sharpen=sharpen or scene.sharpen)
    view = View(scene.isovalue, scene.camera(30.0, 20.0, 2.5, 30.0), width=size, height=size)
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(scene, view, Path(folder))
        found: dict[str, float] = {}
        if last > first:
            sliding = slide(view, np.arange(first, last + step / 2.0, step) - view.isovalue)
            found |= figures_of("isovalue", list(jumps(shots(bench, sliding, paths))))
        if turns:
            turning = turn(view, [degrees * number for number in range(turns + 1)])
            found |= figures_of("light", list(jumps(shots(bench, turning, paths))))
    show(f"jumps of {scene.name}, {size} × {size} pixels, percent", found, as_json)


if __name__ == "__main__":
    main()
