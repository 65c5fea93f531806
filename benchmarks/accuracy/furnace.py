"""Volumes of all kinds in a white furnace: with albedo 1 under constant light every pixel is
exactly as bright as that.

    python -m benchmarks.accuracy furnace [--size 96] [--paths 128] [--seed 1 …] [--only TEXT …]

Pictures are baked by their scenes' plans to 2 %, and checked as the server checks pictures at rest.
What is missing is light that leaks or is lost, and paths that end too soon; nothing is random in
it. Pixels in closed bubbles, and others whose own paths do not find the light within the bounces of
the truth, are counted apart.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np

from benchmarks.accuracy.benches import bench_of, wanted
from benchmarks.accuracy.totals import volumes
from benchmarks.common.measurement import Measurement, markdown
from benchmarks.common.scenes import CONSTANT
from benchmarks.common.suite import part
from isogi_core.bake.noise import Goal
from isogi_core.frame.frame import Frame
from isogi_report.bench import Bench

WHITE = 1.0
FOUND = 0.99
"""What a pixel's own paths bring where they find the light."""

HEAD = (
    *("volume", "mean − 1, %", "darkest pixel", "brightest pixel", "told, %", "pixels' own light"),
    *("pixels that find no light", "their worst error"),
)


@dataclass(frozen=True)
class Pixels:
    """The pixels of a picture that find light: their mean, the darkest and the brightest; 1 is
    right.

    ``dark`` is the share of others, which are ``off`` by so much from the truth at most.
    """

    mean: float
    darkest: float
    brightest: float
    dark: float
    off: float

    @classmethod
    def of(cls, frame: Frame, truth: np.ndarray) -> "Pixels":
        """Those of a ``frame`` whose ``truth`` (h, w, 3) is known."""
        shown, true = (each[frame.state > 0].mean(axis=1) for each in (frame.radiance, truth))
        lit = true >= FOUND
        off = float(np.abs(shown - true)[~lit].max(initial=0.0))
        return cls(
            float(shown[lit].mean()),
            float(shown[lit].min()),
            float(shown[lit].max()),
            float(1 - lit.mean()),
            off,
        )

    @property
    def worst(self) -> float:
        """How far the worst is off."""
        return max(1.0 - self.darkest, self.brightest - 1.0)


@part(size=96)
@click.option(
    "--paths",
    type=click.IntRange(8),
    default=128,
    show_default=True,
    help="Paths a pixel of references.",
)
@click.option(
    "--seed",
    multiple=True,
    type=int,
    default=(1,),
    show_default=True,
    help="Of volumes; repeatable.",
)
@click.option("--only", multiple=True, help="Part of a volume's name; repeatable.")
def furnace(size: int, paths: int, seed: tuple[int, ...], only: tuple[str, ...]) -> Measurement:
    """Volumes of all kinds with albedo 1 under constant light, where every pixel is to be 1."""
    rows = []
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for name, make in volumes(seed):
            if not wanted(name, only):
                continue
            bench = bench_of(
                make(dict(CONSTANT), WHITE), size, Path(folder) / name.replace(" ", "-")
            )
            frame = measure(bench)
            found.append(Pixels.of(frame, bench.reference(paths).mean))
            rows.append(row_of(name, found[-1], frame))
            click.echo(" | ".join(rows[-1]), err=True)
    if not found:
        raise click.UsageError("No volume has that in its name.")
    return Measurement("A white furnace", figures(found), markdown(HEAD, rows))


def measure(bench: Bench) -> Frame:
    """The frame of a view that is baked, and checked to its end."""
    bench.planned.frame()
    renderer = bench.renderer(bench.scene)
    goal = Goal.checked(bench.scene.target_error)
    while renderer.refine(bench.view, goal):
        pass
    return renderer.render(bench.view, goal)


def row_of(name: str, pixels: Pixels, frame: Frame) -> tuple[str, ...]:
    """A line of the table."""
    return (
        name,
        f"{100 * (pixels.mean - 1.0):+.2f}",
        f"{pixels.darkest:.3f}",
        f"{pixels.brightest:.3f}",
        f"{100 * frame.total.likely:.2f}",
        f"{frame.traced_pixels / max(frame.surface, 1):.0%}",
        f"{pixels.dark:.1%}",
        f"{pixels.off:.3f}",
    )


def figures(found: Sequence[Pixels]) -> dict[str, float]:
    """How far means and worst pixels are off, and how many are within half a percent and 5 %."""
    means = np.array([abs(each.mean - 1.0) for each in found])
    worst = np.array([each.worst for each in found])
    return {
        "volumes": len(found),
        "worst mean, off by": float(means.max()),
        "worst pixel, off by": float(worst.max()),
        "means within 0.5 %": float((means <= 0.005).mean()),
        "worst pixels within 5 %": float((worst <= 0.05).mean()),
    }
