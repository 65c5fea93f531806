"""Where the plan projects texels, what that gains, and what it costs.

    python -m benchmarks.accuracy projected [VOLUME …] [--size 64] [--paths 512]

Each volume is seen at the isovalue where its views start, under constant light, with texels on
their own isosurfaces and with projected ones, both baked to the scene's target error; errors are
against paths from each pixel, less their noise. By default all shared volumes, and the demos.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import click

from benchmarks.accuracy.benches import bench_of
from benchmarks.common.measurement import Measurement, markdown
from benchmarks.common.scenes import CONSTANT, shared_data
from benchmarks.common.suite import part
from isogi_core.plan.assembly import load_scene
from isogi_core.plan.scene import Scene
from isogi_report.bench import ViewBake
from isogi_report.metrics import score

DEMOS = ("demo:casting", "demo:orbital")

ABOUT = """\
Each volume is seen at the isovalue where its views start, under constant light, {size} × {size} \
pixels, baked to {target:.0%}. *Expected* is what interpolation errs by as the survey of stiffness \
expects; texels are projected where that is more than {allowed:.2%}. Errors are relative RMSE \
(99th percentile) against {paths} paths from each pixel, less their noise; bakes are seconds of \
the processor."""

HEAD = (
    *("volume", "isovalue", "expected, %", "projected by the plan"),
    *(
        "own isosurfaces, %",
        "projected, %",
        "bake, s",
        "bake projected, s",
        "texels read projected, %",
    ),
)


@dataclass(frozen=True)
class Found:
    """What was found of a scene: by whether texels are projected, RMSE, 99th percentile and seconds
    of the bake.
    """

    scene: Scene
    rmse: tuple[float, float]
    p99: tuple[float, float]
    seconds: tuple[float, float]
    share: float

    @property
    def chosen(self) -> bool:
        """Whether the plan projects texels where views start."""
        return self.scene.projection.projects(self.scene.start)

    @property
    def row(self) -> tuple[str, ...]:
        """The scene's row of the table."""
        errors = (
            f"{100 * rmse:.2f} ({100 * p99:.1f})"
            for rmse, p99 in zip(self.rmse, self.p99, strict=True)
        )
        expected = f"{100 * self.scene.projection.error(self.scene.start):.2f}"
        seconds = (f"{each:.1f}" for each in self.seconds)
        choice = "yes" if self.chosen else "no"
        return (
            *(self.scene.volume.name, f"{self.scene.isovalue:.4g}", expected, choice),
            *(*errors, *seconds, f"{100 * self.share:.0f}"),
        )


@part(size=64)
@click.argument("volumes", nargs=-1)
@click.option(
    "--paths",
    type=click.IntRange(8),
    default=512,
    show_default=True,
    help="Paths a pixel of references.",
)
def projected(volumes: Sequence[str], size: int, paths: int) -> Measurement:
    """Where the plan projects texels, what that gains, and what it costs."""
    found = []
    for volume in volumes or every_volume():
        click.echo(volume, err=True)
        found.append(measure(load_scene(volume, lights=[CONSTANT]), size, paths))
    plan = found[0].scene.projection
    target = found[0].scene.target_error
    about = ABOUT.format(size=size, target=target, allowed=plan.allowed, paths=paths)
    text = f"{about}\n\n{markdown(HEAD, [each.row for each in found])}"
    return Measurement("Where texels are projected", figures_of(found), text)


def every_volume() -> tuple[str, ...]:
    """The shared volumes that are at hand, and the demos."""
    data = shared_data()
    if data:
        return (*(str(path) for path in sorted(data.glob("*.nhdr"))), *DEMOS)
    return DEMOS


def measure(scene: Scene, size: int, paths: int) -> Found:
    """Bake a scene's first view both ways, and compare."""
    rmse = []
    p99 = []
    seconds = []
    share = 0.0
    with tempfile.TemporaryDirectory() as folder:
        best = bench_of(scene, size, Path(folder)).reference(paths)
        for projects in (False, True):
            bench = bench_of(scene.with_settings(projected=projects), size, Path(folder))
            bake: ViewBake = bench.planned
            frame = bake.frame()
            errors = score(frame.radiance, best, 1.0)
            rmse.append(errors.rmse)
            p99.append(errors.p99)
            seconds.append(bake.seconds)
            if frame.quality.projection:
                share = frame.quality.projection.shares["projected"]
            else:
                share = 0.0
    return Found(scene, (rmse[0], rmse[1]), (p99[0], p99[1]), (seconds[0], seconds[1]), share)


def figures_of(found: Sequence[Found]) -> dict[str, float]:
    """Figures of each scene, and how many the plan projects."""
    figures: dict[str, float] = {
        "volumes": len(found),
        "projected by the plan": sum(each.chosen for each in found),
    }
    for each in found:
        name = each.scene.volume.name
        figures |= {
            f"{name}: expected, %": 100.0 * each.scene.projection.error(each.scene.start),
            f"{name}: own isosurfaces, RMSE, %": 100.0 * each.rmse[0],
            f"{name}: projected, RMSE, %": 100.0 * each.rmse[1],
            f"{name}: bake projected / bake": each.seconds[1] / max(each.seconds[0], 1e-9),
        }
    return figures
