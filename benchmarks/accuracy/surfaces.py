"""Pictures of several surfaces, beside paths among them; and what is baked anew while one of them
slides.

    python -m benchmarks.accuracy surfaces [--size 40] [--paths 512] [--only TEXT …] [--kept FILE]

The CT head under uffizi: its skin at three shares of clear rays, over bone that slides. Pictures
are baked to 2 % and checked by an engine with two workers, and held against path-traced pictures.
What was stored, and the paths that were baked, are those of one isovalue after the others; at the
end the first one is shown again. Of the texels that had light before a move, those that took more
samples in it are told apart from new ones: where those are none, the move baked nothing anew.
"""

import math
import tempfile
import time
from collections.abc import Collection, Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

import click
import numpy as np

from benchmarks.accuracy.benches import report_view, wanted
from benchmarks.accuracy.kept import Kept
from benchmarks.common.measurement import Measurement, markdown
from benchmarks.common.scenes import LIGHTS, VOLUMES, shared_data
from benchmarks.common.suite import part
from isogi_core.bake.noise import Goal
from isogi_core.cache.chunk_record import facts_in, record_fields
from isogi_core.files.scene_file import SceneSource
from isogi_core.frame.frame import Frame
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.plan.assembly import build_scene
from isogi_core.plan.scene import Scene
from isogi_core.storage.store import unwrap_all
from isogi_server.cli.render import awaited
from isogi_server.render.engine import RenderEngine

SKIN = 64
CLEAR = (0.3, 0.6, 0.9)
BONE = (110, 122, 134, 145, 157, 168, 180)
"""The isovalue of the skin and the shares of rays that pass it; isovalues of the bone that
slides.
"""

PATIENCE = 300.0
"""Seconds that a picture may take."""

HEAD = (
    *(
        "view",
        "true",
        "99th percentile",
        "told",
        "new texels of the bone",
        "of other sides",
        "texels refined",
    ),
    *("stored, kB", "paths, 10³", "s"),
)

Samples = dict[Path, np.ndarray]
"""Codes of the samples that each texel of a chunk's record has, 0 without light, by the object's
path in a store.
"""


@dataclass(frozen=True)
class Found:
    """A view: true errors ``rmse`` and ``p99``, and the ``told`` one; whether it became ``final``.

    Texels that its bake gave their first light: of the surface that slides, ``own``, and of
    ``others``; those that had light and were ``refined``; bytes ``stored``, ``paths`` and seconds.
    """

    name: str
    rmse: float
    p99: float
    told: float
    final: bool
    own: int
    others: int
    refined: int
    stored: int
    paths: int
    seconds: float

    @property
    def row(self) -> tuple[str, ...]:
        """A line of the table, in percent, kilobytes and seconds."""
        errors = (f"{100 * each:.2f}" for each in (self.rmse, self.p99))
        told = f"{100 * self.told:.2f}{'' if self.final else ' (not final)'}"
        counts = (f"{each}" for each in (self.own, self.others, self.refined))
        sizes = (f"{each / 1e3:.0f}" for each in (self.stored, self.paths))
        return (self.name, *errors, told, *counts, *sizes, f"{self.seconds:.0f}")


@dataclass(frozen=True)
class Slide:
    """The views of a slide, by the ``name`` of its scene; ``back`` is the first one when it is
    shown again.
    """

    name: str
    views: tuple[Found, ...]
    back: Found

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> "Slide":
        """One that was written as JSON."""
        return cls(
            given["name"], tuple(Found(**each) for each in given["views"]), Found(**given["back"])
        )


@part(size=40)
@click.option(
    "--paths",
    default=512,
    type=click.IntRange(8),
    help="Paths a pixel of references.",
    show_default=True,
)
@click.option("--only", multiple=True, help="Part of a slide's name; repeatable.")
@click.option(
    "--kept", type=Path, help="A file of slides measured before, and where others are added."
)
def surfaces(size: int, paths: int, only: tuple[str, ...], kept: Path | None) -> Measurement:
    """How far pictures of several surfaces are from the truth, and what sliding one of them
    bakes.
    """
    known = Kept(kept, Slide.of)
    slides = list[Slide]()
    for clear in CLEAR:
        if wanted(name := f"skin of clear {clear:g}", only):
            slides.append(known.get(name) or known.put(slid(name, head(clear), size, paths)))
    found = [each for slide in slides for each in slide.views]
    if not found:
        raise click.UsageError("No slide has that in its name.")
    later = [each for slide in slides for each in slide.views[1:]]
    figures = {
        "views": len(found),
        "within 3 %": sum(each.rmse <= 0.03 for each in found),
        "true error, worst": max(each.rmse for each in found),
        "true error, median": median(each.rmse for each in found),
        "99th percentile, worst": max(each.p99 for each in found),
        "told / true, median": median(each.told / max(each.rmse, 1e-6) for each in found),
        "final": sum(each.final for each in found) / len(found),
        "texels refined over all baked while sliding": sum(each.refined for each in later)
        / max(sum(each.own + each.others + each.refined for each in later), 1),
        "texels baked on the way back": sum(
            each.back.own + each.back.others + each.back.refined for each in slides
        ),
    }
    rows = [each.row for slide in slides for each in (*slide.views, slide.back)]
    return Measurement(f"Several surfaces, {size} × {size}", figures, markdown(HEAD, rows))


def head(clear: float) -> Scene:
    """The CT head's bone in its skin, of which the share ``clear`` of rays passes; ClickException
    without the data.
    """
    data = shared_data()
    if data is None:
        raise click.ClickException(
            "There are no shared volumes: set ISOGI_SHARED_DATA to a folder that has them."
        )
    skin = {"isovalue": SKIN, "clear": clear, "albedo": 0.6}
    own = {
        "volume": VOLUMES["CT head"],
        "isovalue": BONE[0],
        "lights": [dict(LIGHTS["uffizi"])],
        "surfaces": [skin],
    }
    return build_scene(SceneSource("head", own, data))


def slid(name: str, scene: Scene, size: int, paths: int) -> Slide:
    """Slide the isovalue of a scene, in a store that is empty at first."""
    with (
        tempfile.TemporaryDirectory() as folder,
        closing(RenderEngine([scene], folder, workers=2)) as engine,
    ):
        engine.start()
        views = []
        for isovalue in BONE:
            found = shown(engine, scene, isovalue, size, paths)
            views.append(replace(found, name=f"{name}, bone at {isovalue}"))
            click.echo(" | ".join(views[-1].row), err=True)
        back = shown(engine, scene, BONE[0], size, paths)
        return Slide(name, tuple(views), replace(back, name=f"{name}, back at {BONE[0]}"))


def shown(engine: RenderEngine, scene: Scene, isovalue: int, size: int, paths: int) -> Found:
    """Bake the picture of an isovalue, and hold it against the truth."""
    view = replace(
        report_view(scene, size),
        isovalue=float(isovalue),
    )
    folder = engine.store.url.folder
    begun = time.monotonic()
    before = samples_in(folder)
    full = stored(folder)
    taken = engine.baker.paths
    goal = Goal.checked(scene.target_error)
    frame = awaited(engine, scene.id, view, goal, PATIENCE)
    seconds = time.monotonic() - begun
    after = samples_in(folder)
    traced = replace(view, shading="path_traced", samples=paths)
    rmse, p99 = beside(frame, engine.survey(scene.id, traced, goal))
    counts = baked({scene.layer_digest(layer) for layer in scene.plan.layers}, before, after)
    grown = stored(folder) - full
    return Found(
        "",
        rmse,
        p99,
        frame.total.likely,
        frame.final,
        *counts,
        grown,
        engine.baker.paths - taken,
        seconds,
    )


def stored(folder: Path) -> int:
    """Bytes of the light in a store."""
    return sum(path.stat().st_size for path in folder.glob("*/c/**/*") if path.is_file())


def samples_in(folder: Path) -> Samples:
    """Samples of all texels in a store."""
    found: Samples = {}
    for metadata in folder.glob("*/zarr.json"):
        facts = facts_in(metadata.read_bytes())
        for path in (each for each in metadata.parent.glob("c/**/*") if each.is_file()):
            record = unwrap_all([path.read_bytes()], facts.record_size)
            codes = record_fields(record, facts.layer, facts.chunk_texels)["rung"][0]
            found[path.relative_to(folder)] = codes.copy()
    return found


def baked(layers: Collection[str], before: Samples, after: Samples) -> tuple[int, int, int]:
    """Texels that were lit between two looks at a store: new ones of these ``layers``, those of all
    others, and those that had light before.
    """
    new = [0, 0]
    refined = 0
    for path, codes in after.items():
        former = before.get(path, np.zeros_like(codes))
        new[path.parts[0] not in layers] += int(((former == 0) & (codes != 0)).sum())
        refined += int(((former != 0) & (codes != former)).sum())
    return new[0], new[1], refined


def beside(frame: Frame, traced: Frame) -> tuple[float, float]:
    """RMSE and 99th percentile of the error of a frame's luminance, over the mean of a path-traced
    one.

    The noise that this one tells of itself is taken from the RMSE.
    """
    on = traced.state > 0
    light, true = (
        each.radiance[on].astype(np.float64) @ LUMINANCE_WEIGHTS for each in (frame, traced)
    )
    wrong = np.abs(light - true)
    square = float((wrong**2).mean() / true.mean() ** 2) - traced.noise**2
    return math.sqrt(max(square, 0.0)), float(np.quantile(wrong, 0.99) / true.mean())
