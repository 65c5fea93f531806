"""Pictures of surfaces with colours by data, beside paths that carry the same colours.

    python -m benchmarks.accuracy colours [--size 64] [--paths 512] [--only TEXT …]

The MNI brain by its gradient, through two maps, and by a second volume, another brain that fills a
part of its box; and the engine by its gradient. Pictures are baked to 2 %, and checked as the
server checks pictures at rest. Seconds are of the processor.
"""

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from benchmarks.accuracy.benches import bench_of, wanted
from benchmarks.accuracy.totals import CHECKED, Found, measure, measurement_of
from benchmarks.common.measurement import Measurement
from benchmarks.common.scenes import LIGHTS, VOLUMES, Subject, shared_data
from benchmarks.common.suite import part
from isogi_core.files.scene_file import SceneSource
from isogi_core.plan.assembly import build_scene
from isogi_core.plan.scene import Scene

GRADIENT: Mapping[str, Any] = {"of": "gradient"}
SECOND: Mapping[str, Any] = {"file": "brain_t1_124x160x140_uint8.nhdr", "map": "magma"}

CASES: tuple[tuple[Subject, str, Mapping[str, Any]], ...] = (
    (Subject("MNI brain", 90, "uffizi"), "its gradient in viridis", GRADIENT),
    (
        Subject("MNI brain", 90, "grace"),
        "its gradient in coolwarm",
        {**GRADIENT, "map": "coolwarm"},
    ),
    (Subject("MNI brain", 90, "uffizi"), "another brain in magma", SECOND),
    (Subject("engine", 70, "grace"), "its gradient in cividis", {**GRADIENT, "map": "cividis"}),
)
"""What is shown, and what its colours are of."""

HEAD = (*CHECKED, "bounces")


@part(size=64)
@click.option(
    "--paths",
    default=512,
    type=click.IntRange(8),
    help="Paths a pixel of references.",
    show_default=True,
)
@click.option("--only", multiple=True, help="Part of a view's name; repeatable.")
def colours(size: int, paths: int, only: tuple[str, ...]) -> Measurement:
    """How far pictures of surfaces with colours by data are from the truth."""
    found: list[Found] = []
    rows: list[tuple[str, ...]] = []
    with tempfile.TemporaryDirectory() as folder:
        for subject, words, table in CASES:
            name = f"{subject.name}, {words}"
            if not wanted(name, only):
                continue
            scene = coloured(subject, table)
            bench = bench_of(scene, size, Path(folder) / str(len(found)))
            found += measure([name], bench, None, paths)
            rows.append((*found[-1].row, f"{scene.plan.bounces}"))
            click.echo(" | ".join(rows[-1]), err=True)
    return measurement_of(f"Colours by data, {size} × {size}", found, HEAD, rows)


def coloured(subject: Subject, table: Mapping[str, Any]) -> Scene:
    """The scene of a subject with the colours of a ``table``; ClickException where the data are not
    at hand.
    """
    data = shared_data()
    if data is None:
        raise click.ClickException(
            "There are no shared volumes: set ISOGI_SHARED_DATA to a folder that has them."
        )
    own = {
        "volume": VOLUMES[subject.volume],
        "isovalue": subject.isovalue,
        "lights": [dict(LIGHTS[subject.light])],
    }
    return build_scene(
        SceneSource(subject.scene, {**own, "volumes": [{"use": "colour", **table}]}, data)
    )
