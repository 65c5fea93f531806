"""Benches of shared volumes, or of one scene that is named: what parts of this suite measure on."""

import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from benchmarks.common.scenes import Subject, scene_of
from isogi_core.model.view import View
from isogi_core.plan.assembly import load_scene
from isogi_core.plan.scene import Scene
from isogi_report.bench import Bench
from isogi_report.command import DEFAULT_VIEWPOINT
from isogi_report.speed import view_of

Settings = Callable[[str], Mapping[str, Any]]
"""What scenes say besides, by the name of their light."""


def bench_of(scene: Scene, size: int, folder: Path) -> Bench:
    """The bench of a scene as reports see it, in a picture of ``size`` × ``size`` pixels."""
    return Bench(scene, report_view(scene, size), folder)


def report_view(scene: Scene, size: int, further: float = 0.0) -> View:
    """The view of a scene as reports see it, or from a camera ``further`` degrees of azimuth on, in
    a picture of ``size`` × ``size`` pixels.
    """
    azimuth = DEFAULT_VIEWPOINT["azimuth"] + further
    camera = scene.camera(**{**DEFAULT_VIEWPOINT, "azimuth": azimuth}, fov=30.0)
    return view_of(scene, size, camera=camera)


def benches(
    target: str | None,
    subjects: Sequence[Subject],
    settings: Settings,
    output: Path | None,
    size: int,
    only: Sequence[str],
) -> Iterator[tuple[str, Bench]]:
    """The bench of ``target``, or those of the subjects whose names have any part of ``only``, with
    their names.

    References are kept in ``output``. Says how long each was of use.
    """
    with tempfile.TemporaryDirectory() as passing:
        folder = output or Path(passing)
        if target is not None:
            yield (
                target,
                bench_of(load_scene(target, **settings("")), size, folder / Path(target).stem),
            )
            return
        for subject in (each for each in subjects if wanted(each.name, only)):
            begun = time.monotonic()
            scene = scene_of(subject, **settings(subject.light))
            yield subject.name, bench_of(scene, size, folder / subject.folder)
            click.echo(f"{subject.name}: {time.monotonic() - begun:.0f} s", err=True)


def wanted(name: str, only: Sequence[str]) -> bool:
    """Whether a name has any part of ``only``, or all are wanted."""
    return not only or any(part in name for part in only)
