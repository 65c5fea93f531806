"""Pictures of several surfaces, beside paths among them; and what is baked anew while one of them slides.

    python -m benchmarks.accuracy surfaces [--size 40] [--paths 512] [--only TEXT …]

The CT head under uffizi: its skin at three shares of clear rays, over bone that slides. Pictures are baked to 2 % and
checked by an engine with two workers, and held against path-traced pictures. What was stored, and the paths that were
baked, are those of one isovalue after the others.
"""

import math
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

import click
import numpy as np

from benchmarks.accuracy.benches import wanted
from benchmarks.common.measurement import Measurement, markdown
from benchmarks.common.scenes import LIGHTS, VOLUMES, shared_data
from benchmarks.common.suite import part
from isogi_core.files.scene_file import SceneSource
from isogi_core.frame.frame import Frame
from isogi_core.model.sky import LUMINANCE
from isogi_core.plan.assembly import build_scene
from isogi_core.plan.scene import Scene
from server.cli.bench import view_of
from server.cli.render import awaited
from server.render.engine import RenderEngine
from server.report.command import STAND

SKIN, CLEAR, BONE = 64, (0.3, 0.6, 0.9), (110, 122, 134, 145, 157, 168, 180)
"""The isovalue of the skin and the shares of rays that pass it; isovalues of the bone that slides."""

PATIENCE = 300.0
"""Seconds that a picture may take."""

HEAD = ("view", "true", "99th percentile", "told", "bone stored, kB", "other sides stored, kB", "paths, 10³", "s")


@dataclass(frozen=True)
class Found:
    """A view: true errors ``rmse`` and ``p99``, and the ``told`` one; whether it became ``final``; bytes that its bake
    added to the layer of the surface that slides, ``own``, and to all others; ``paths``, and seconds.
    """

    name: str
    rmse: float
    p99: float
    told: float
    final: bool
    own: int
    others: int
    paths: int
    seconds: float

    @property
    def row(self) -> tuple[str, ...]:
        """A line of the table, in percent, kilobytes and seconds."""
        errors = (f"{100 * each:.2f}" for each in (self.rmse, self.p99))
        told = f"{100 * self.told:.2f}{'' if self.final else ' (not final)'}"
        sizes = (f"{each / 1e3:.0f}" for each in (self.own, self.others, self.paths))
        return (self.name, *errors, told, *sizes, f"{self.seconds:.0f}")


@part(size=40)
@click.option("--paths", default=512, type=click.IntRange(8), help="Paths a pixel of references.", show_default=True)
@click.option("--only", multiple=True, help="Part of a view's name; repeatable.")
def surfaces(size: int, paths: int, only: tuple[str, ...]) -> Measurement:
    """How far pictures of several surfaces are from the truth, and what sliding one of them bakes."""
    found: list[Found] = []
    for clear in CLEAR:
        names = {bone: f"skin of clear {clear:g}, bone at {bone}" for bone in BONE}
        some = [bone for bone in BONE if wanted(names[bone], only)]
        for bone, each in zip(some, slid(head(clear), some, size, paths), strict=True):
            found.append(replace(each, name=names[bone]))
            click.echo(" | ".join(found[-1].row), err=True)
    figures = {
        "true error, worst": max(each.rmse for each in found),
        "true error, median": median(each.rmse for each in found),
        "99th percentile, worst": max(each.p99 for each in found),
        "told / true, median": median(each.told / max(each.rmse, 1e-6) for each in found),
        "final": sum(each.final for each in found) / len(found),
    }
    table = markdown(HEAD, [each.row for each in found])
    return Measurement(f"Several surfaces, {size} × {size}", figures, table)


def head(clear: float) -> Scene:
    """The CT head's bone in its skin, of which the share ``clear`` of rays passes; ClickException without the data."""
    data = shared_data()
    if data is None:
        raise click.ClickException("There are no shared volumes: set ISOGI_SHARED_DATA to a folder that has them.")
    skin = {"isovalue": SKIN, "clear": clear, "albedo": 0.6}
    own = {"volume": VOLUMES["CT head"], "isovalue": BONE[0], "lights": [dict(LIGHTS["uffizi"])], "surfaces": [skin]}
    return build_scene(SceneSource("head", own, data))


def slid(scene: Scene, isovalues: Sequence[int], size: int, paths: int) -> Iterator[Found]:
    """Show a scene at one isovalue after the other, in a store that is empty at first."""
    if not isovalues:
        return
    with tempfile.TemporaryDirectory() as folder:
        engine = RenderEngine([scene], folder, workers=2)
        try:
            engine.start()
            for isovalue in isovalues:
                yield shown(engine, scene, isovalue, size, paths)
        finally:
            engine.close()


def shown(engine: RenderEngine, scene: Scene, isovalue: int, size: int, paths: int) -> Found:
    """Bake the picture of an isovalue, and hold it against the truth."""
    view = replace(view_of(scene, size, camera=scene.camera(**STAND, fov=30.0)), isovalue=float(isovalue))
    folder, begun = engine.store.url.folder, time.monotonic()
    before, taken = stored(folder, scene), engine.paths
    frame = awaited(engine, scene.id, view, scene.target_error, PATIENCE)
    seconds, after = time.monotonic() - begun, stored(folder, scene)
    traced = replace(view, shading="path_traced", samples=paths)
    rmse, p99 = beside(frame, engine.survey(scene.id, traced, scene.target_error))
    grown = after[0] - before[0], after[1] - before[1]
    return Found("", rmse, p99, frame.total.likely, frame.final, *grown, engine.paths - taken, seconds)


def stored(folder: Path, scene: Scene) -> tuple[int, int]:
    """Bytes of the light in a store: of the layers of the scene itself, and of all others."""
    sizes, layers = [0, 0], {scene.layer_digest(layer) for layer in scene.plan.layers}
    for path in folder.glob("*/c/**/*"):
        if path.is_file():
            sizes[path.relative_to(folder).parts[0] not in layers] += path.stat().st_size
    return sizes[0], sizes[1]


def beside(frame: Frame, traced: Frame) -> tuple[float, float]:
    """RMSE and 99th percentile of the error of a frame's luminance, over the mean of a path-traced one.

    The noise that this one tells of itself is taken from the RMSE.
    """
    on = traced.state > 0
    light, true = (each.radiance[on].astype(np.float64) @ LUMINANCE for each in (frame, traced))
    wrong = np.abs(light - true)
    square = float((wrong**2).mean() / true.mean() ** 2) - traced.noise**2
    return math.sqrt(max(square, 0.0)), float(np.quantile(wrong, 0.99) / true.mean())
