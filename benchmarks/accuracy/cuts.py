"""Pictures of volumes that are cut open, beside paths in the same cut field.

    python -m benchmarks.accuracy cuts [--size 48] [--paths 512] [--only TEXT …]

The engine, the CT head and the MNI brain under two probes, with three cuts each, by their scenes'
plans. Pictures are baked to 2 %, and checked as the server checks pictures at rest. Seconds are of
the processor.
"""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import click

from benchmarks.accuracy.benches import bench_of, wanted
from benchmarks.accuracy.totals import CHECKED, Found, measure, measurement_of
from benchmarks.common.measurement import Measurement
from benchmarks.common.scenes import Subject, scene_of
from benchmarks.common.suite import part
from isogi_core.plan.scene import Scene
from isogi_core.plan.variants import cut_open

SUBJECTS = tuple(
    Subject(volume, isovalue, light)
    for volume, isovalue in (("engine", 70), ("CT head", 110), ("MNI brain", 90))
    for light in ("uffizi", "grace")
)

CUTS = (((0, ">", 0.5),), ((2, ">", 0.6),), ((1, ">", 0.7), (2, ">", 0.8)))
"""Planes of each cut: an axis, the side that is taken away, and where, as a share of the box."""

HEAD = (*CHECKED, "whole, s")


@part(size=48)
@click.option(
    "--paths",
    default=512,
    type=click.IntRange(8),
    help="Paths a pixel of references.",
    show_default=True,
)
@click.option("--only", multiple=True, help="Part of a view's name; repeatable.")
def cuts(size: int, paths: int, only: tuple[str, ...]) -> Measurement:
    """How far pictures of volumes that are cut open are from the truth."""
    found: list[Found] = []
    rows: list[tuple[str, ...]] = []
    with tempfile.TemporaryDirectory() as folder:
        for subject in SUBJECTS:
            scene = scene_of(subject)
            named = [(f"{subject.name}, {cut}", cut) for cut in texts(scene)]
            if not any(wanted(name, only) for name, _ in named):
                continue
            whole = bench_of(scene, size, Path(folder) / subject.folder / "whole")
            whole.planned.frame()
            for number, (name, cut) in enumerate(named):
                if wanted(name, only):
                    opened = cut_open(scene, cut, f"{scene.id}-{number}")
                    bench = bench_of(opened, size, Path(folder) / subject.folder / str(number))
                    found += measure([name], bench, None, paths)
                    rows.append((*found[-1].row, f"{whole.planned.seconds:.1f}"))
                    click.echo(" | ".join(rows[-1]), err=True)
    return measurement_of(f"Volumes cut open, {size} × {size}", found, HEAD, rows)


def texts(scene: Scene) -> Iterator[str]:
    """The CUTS of a scene's volume, as views ask for them."""
    low, high = scene.volume.world_bounds
    for planes in CUTS:
        yield ";".join(
            f"{'xyz'[a]}{side}{low[a] + share * (high[a] - low[a]):g}" for a, side, share in planes
        )
