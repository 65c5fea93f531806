"""What pictures tell of their whole error while their light converges, beside the truth.

    python -m benchmarks.accuracy converging [--size 48] [--paths 512] [--seed 1 …] [--only TEXT …] [--json]

All texels of a view have the same number of samples. Its picture tells its noise, and besides what the plan expects, or
what early controls find, which are drawn once, after the first samples. References are path-traced from each pixel.
"""

import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import median

import click

from benchmarks.accuracy.benches import bench_of, wanted
from benchmarks.accuracy.totals import quiet_reference, scenes
from benchmarks.common.measurement import Measurement, markdown
from benchmarks.common.scenes import documented_scene, shared_data
from benchmarks.common.suite import part
from isogi_core.frame.renderer import Renderer
from isogi_core.plan.scene import Scene
from isogi_core.report.bake import ViewBake
from isogi_core.report.metrics import score

SAMPLES = (16, 64, 256)
"""Samples of each texel."""

SCATTERING = "microscopy"
"""A scene of the documents that scatters."""

VIEWS = ("under grace", SCATTERING)
"""What is measured where nothing else is asked for: parts of the names of ``totals``, and that scene."""

HEAD = (
    "view",
    "samples",
    "noise",
    "told by the plan",
    "told by early controls",
    "true",
    "told / true, before",
    "after",
)


@dataclass(frozen=True)
class Found:
    """Relative errors of a picture: its ``noise``, told as ``planned`` and as ``measured``, and the ``true`` one."""

    noise: float
    planned: float
    measured: float
    true: float

    def row(self, name: str, samples: int) -> tuple[str, ...]:
        """Its row under HEAD, in percent."""
        percents = [f"{100 * error:.2f}" for error in (self.noise, self.planned, self.measured, self.true)]
        return (name, f"{samples}", *percents, f"{self.planned / self.true:.2f}", f"{self.measured / self.true:.2f}")


@part(size=48)
@click.option("--paths", type=click.IntRange(8), default=512, show_default=True, help="Paths a pixel of references.")
@click.option("--seed", multiple=True, type=int, default=(1,), show_default=True, help="Of volumes; repeatable.")
@click.option("--only", multiple=True, default=VIEWS, help="Part of a scene's name; repeatable.")
def converging(size: int, paths: int, seed: tuple[int, ...], only: tuple[str, ...]) -> Measurement:
    """What pictures tell of their whole error while their light converges."""
    rows, found = [], list[Found]()
    with tempfile.TemporaryDirectory() as folder:
        for name, make in every(Path(folder), seed, only):
            for samples, each in measure(make(), size, paths, Path(folder) / name.replace(" ", "-")):
                found.append(each)
                rows.append(each.row(name, samples))
                click.echo(" | ".join(rows[-1]), err=True)
    if not found:
        raise click.UsageError("No view has that in its name.")
    figures = {"pictures": float(len(found))}
    for how, ratios in (
        ("the plan", sorted(each.planned / each.true for each in found)),
        ("early controls", sorted(each.measured / each.true for each in found)),
    ):
        figures[f"told by {how} / true, median"] = median(ratios)
        figures[f"told by {how} / true, least"] = ratios[0]
        figures[f"told by {how} / true within 0.67 and 1.5"] = sum(0.67 <= each <= 1.5 for each in ratios) / len(ratios)
    return Measurement("Errors of light that converges, told and true", figures, markdown(HEAD, rows))


def every(folder: Path, seeds: Sequence[int], only: Sequence[str]) -> Iterator[tuple[str, Callable[[], Scene]]]:
    """The scenes of ``totals``, and one that scatters, by name, and what makes them."""
    yield from scenes(folder, seeds, only)
    data = shared_data()
    if data is not None and wanted(SCATTERING, only):
        yield SCATTERING, partial(documented_scene, SCATTERING, data)


def measure(scene: Scene, size: int, paths: int, folder: Path) -> Iterator[tuple[int, Found]]:
    """What is told and true of a view after each of SAMPLES."""
    bench = bench_of(scene, size, folder)
    bake, best = ViewBake(bench.renderer(scene), bench.view), quiet_reference(bench, paths)
    filters = Renderer(bake.renderer.caches, bench.tiles)
    for samples in SAMPLES:
        bake.grow(samples, scene.target_error)
        bake.frame()
        if (frame := filters.render(bench.view)).unmeasured:
            filters.refine(bench.view)
            frame = filters.render(bench.view)
        if frame.provisional:
            true = score(frame.radiance, best, 1.0).rmse
            yield samples, Found(frame.noise, frame.lasting_total.likely, frame.total.likely, true)
