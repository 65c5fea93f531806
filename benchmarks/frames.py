"""Frame times of all shadings side by side, cache warm, and what turning only the light costs.

    python -m benchmarks.frames [TARGET] [--size 512] [--repeats 15] [--json]

Every camera is new to the renderer, so that each frame casts its primary rays; shadings are
interleaved, and ratios are of medians (S1, table 2 has SH at 1.45 × Lambert and 0.75 × with shadow).
"""

import math
import tempfile
from dataclasses import replace

import click

from benchmarks.common import benchmark_scene, options, show
from isogi_core.frame.film import develop
from isogi_core.frame.renderer import Renderer
from isogi_core.model.view import View, quaternion_from_angles
from server.measure import Candidate, bake_view, make_renderer, medians, seconds, view_of

SHADINGS = ("gi", "lambert", "lambert_shadow", "lambert_fog", "phong", "phong_shadow")
SAMPLES = 16


@click.command()
@click.argument("target", required=False)
@options(repeats=15)
def main(target: str | None, size: int, repeats: int, as_json: bool) -> None:
    """Time frames."""
    scene = benchmark_scene(target)
    with tempfile.TemporaryDirectory() as store:
        renderer = make_renderer(scene, store)
        view = view_of(scene, size)
        frame = bake_view(renderer, view, SAMPLES)
        texels = sum(len(demand.offsets) for demand in frame.demands)
        figures = summarise(medians(candidates(renderer, view), repeats))
        figures["lattice / texels of this view"] = math.prod(renderer.recipe.shape) / texels
    show(f"{scene.name} at {scene.isovalue:g}, {size} × {size}, {renderer.tiles.threads} threads", figures, as_json)


def candidates(renderer: Renderer, view: View) -> dict[str, Candidate]:
    """A frame by each shading, "relight", the light turned and nothing else, and "develop", the tone curve."""
    exposure = renderer.recipe.scene.default_exposure

    def frame(shading: str) -> Candidate:
        def render(_: int) -> float:
            renderer.forget_views()
            return seconds(lambda: renderer.render(replace(view, shading=shading)))

        return render

    def turned(turn: int) -> View:
        return replace(view, light=quaternion_from_angles(7.0 * turn + 3.0, 5.0, 2.0))

    def relight(turn: int) -> float:
        renderer.render(view)
        return seconds(lambda: renderer.render(turned(turn)))

    def tone(turn: int) -> float:
        lit = renderer.render(turned(turn))
        return seconds(lambda: develop(lit, exposure))

    return {**{shading: frame(shading) for shading in SHADINGS}, "relight": relight, "develop": tone}


def summarise(median: dict[str, float]) -> dict[str, float]:
    """Medians in milliseconds, and the ratios that are asked for."""
    return {
        **{f"{name}_ms": 1000.0 * taken for name, taken in median.items()},
        "gi / lambert": median["gi"] / median["lambert"],
        "gi / lambert_shadow": median["gi"] / median["lambert_shadow"],
        "relight / gi": median["relight"] / median["gi"],
    }


if __name__ == "__main__":
    main()
