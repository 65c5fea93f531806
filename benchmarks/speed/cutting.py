"""A cut beside the first bake of its view: until no part is provisional, and until the picture is
final.

    python -m benchmarks.speed cutting [--size 96] [--workers 2]

The engine, or the casting where there are no shared volumes. Each cut takes a tenth of the volume
away, in a store that has the light of the whole alone; cuts come one after the other. Kept texels
have the whole's light, to the bit.
"""

import asyncio
import tempfile
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass

import click

from benchmarks.accuracy.benches import report_view
from benchmarks.common.measurement import Measurement, markdown
from benchmarks.common.scenes import benchmark_scene
from benchmarks.common.suite import part
from isogi_core.bake.noise import Goal
from isogi_core.kernels.shading.framebuffer import PROVISIONAL
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene
from isogi_server.render.engine import RenderEngine
from isogi_server.render.scene_variant import Change
from isogi_server.render.variants import Variants

SHARE = 0.1
PATIENCE = 200.0
STEP = 0.1
"""What a cut takes away, seconds that a picture may take, and those between two looks at it."""

HEAD = (
    *("cut", "texels kept", "paths baked", "no part provisional, s", "final, s"),
    *("no part provisional / first bake", "final / first bake"),
)


@dataclass(frozen=True)
class Bake:
    """Seconds until no part of a picture is provisional (``shown``), and until it is ``final``;
    texels ``kept`` of those that it reads, and ``paths`` baked.
    """

    shown: float
    final: float
    kept: float
    paths: int


@part(size=96)
@click.option("--workers", default=2, show_default=True, help="Worker processes.")
def cutting(size: int, workers: int) -> Measurement:
    """How long cuts take, beside the first bake of the view, and how many texels keep their
    light.
    """
    scene = benchmark_scene(None)
    view = report_view(scene, size)
    goal = Goal.checked(scene.target_error)
    with (
        tempfile.TemporaryDirectory() as folder,
        closing(RenderEngine([scene], folder, workers=workers)) as engine,
    ):
        engine.start()
        while engine.workers.preparing or not engine.baker.tally().workers:
            time.sleep(STEP)
        variants = Variants(engine, str)
        first = baked(engine, scene.id, view, goal, time.monotonic())
        found = {"none": first}
        for cut in cuts_of(scene):
            begun = time.monotonic()
            opened = asyncio.run(variants.of(scene, Change(cut=cut)))
            found[cut] = baked(engine, opened.id, view, goal, begun)
            click.echo(f"{cut}: {found[cut]}", err=True)
    cuts = [each for name, each in found.items() if name != "none"]
    figures = {
        "texels kept, least": min(each.kept for each in cuts),
        "no part provisional over the first bake, most": max(each.shown for each in cuts)
        / first.final,
        "final over the first bake, most": max(each.final for each in cuts) / first.final,
    }
    return Measurement(
        f"{scene.name}, {size} × {size}, {workers} workers", figures, table_of(found, first)
    )


def table_of(found: dict[str, Bake], first: Bake) -> str:
    """Bakes by their cuts, beside the ``first`` one of the view."""
    rows = []
    for name, each in found.items():
        seconds = f"{each.shown:.1f}", f"{each.final:.1f}"
        ratios = (f"{value / first.final:.2f}" for value in (each.shown, each.final))
        rows.append((name, f"{each.kept:.0%}", f"{each.paths:,}", *seconds, *ratios))
    return markdown(HEAD, rows)


def cuts_of(scene: Scene) -> Iterator[str]:
    """Cuts through SHARE of the volume, from either side of each axis, as views ask for them."""
    for axis, low, high in zip("xyz", *scene.volume.world_bounds, strict=True):
        away = SHARE * (high - low)
        yield f"{axis}>{high - away:g}"
        yield f"{axis}<{low + away:g}"


def baked(engine: RenderEngine, scene: str, view: View, goal: Goal, begun: float) -> Bake:
    """Watch the picture of a view from when it was ``begun`` until it is final."""
    before = engine.baker.tally()
    shown = None
    while True:
        frame = engine.frame(scene, view, goal=goal, wait=STEP)
        passed = time.monotonic() - begun
        if shown is None and not (frame.state == PROVISIONAL).any():
            shown = passed
        coming = frame.checkable or engine.lacking(scene, frame)[1].demands
        if frame.final or not coming or passed > PATIENCE:
            break
    after = engine.baker.tally()
    renderer = engine.renderer(scene)
    texels = len(renderer.surface.texels(view, renderer.gbuffer(view)).places)
    return Bake(
        shown or passed,
        passed,
        (after.kept - before.kept) / max(texels, 1),
        after.paths - before.paths,
    )
