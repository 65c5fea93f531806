"""What scenes of one volume keep for each texel by their plans, beside what S1 keeps whatever the
scene.

    python -m benchmarks.accuracy plans [--size 128] [--target 0.05] [--scene NAME …] [--json]

The engine block at 70, or the casting where the shared data are not at hand; scenes under probes
are then left out. All texels of one view are baked to the target error twice: by the scene's plan,
and as S1 does, 25 harmonics of each channel as floats, with as many bounces. Errors are those of
the view's frame, relative RMSE of the luminance over surface pixels, against paths from each pixel,
with more bounces where there are any.

Seconds are of the processor, all threads together, in one run, so that other work on the machine
counts little; kernels are compiled before. Megabytes of a view are those of its files, in which
equal channels take little more than one. Those of the lattice are computed, before compression: all
texels of the chunks that some isovalue shows by the plan's bytes, and of all chunks by S1's. A dash
is for S1 under lamps, which harmonics do not hold, and for errors of a black picture.
"""

import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
from tqdm import tqdm

from benchmarks.accuracy.errors import relative_rmse
from benchmarks.accuracy.scenes import PLANNED, load_planned
from benchmarks.common.measurement import Measurement, markdown
from benchmarks.common.suite import part
from isogi_core.bake.noise import Goal
from isogi_core.bake.refine import refine
from isogi_core.cache.scene_caches import Loader
from isogi_core.frame.demand import Demand
from isogi_core.frame.frame import Frame
from isogi_core.model.scene_plan import Layer
from isogi_core.plan.left_out import S1_BYTES, lattice_bytes
from isogi_core.plan.reachable_texels import TexelCount
from isogi_core.plan.scene import Scene
from isogi_report.speed import make_renderer, view_of
from isogi_report.studies import as_s1

PATHS = 1024
"""Paths from each pixel of the picture that frames are compared with."""

LONGEST = 20
"""Bounces of these paths, after which 0.06 % of the light is left at albedo 0.7."""

SMALL = 8
"""Pixels a side of the views that kernels are compiled on."""

HEAD = (
    *(
        "scene",
        "plan",
        "layers",
        "bytes per texel (S1: 300)",
        "texels shown",
        "lattice, MB, plan / S1",
    ),
    *("bake of a view, s, plan / S1", "its store, MB, plan / S1", "error, plan / S1"),
)


@dataclass(frozen=True)
class Bake:
    """What a view's texels took: ``seconds`` of the processor, ``megabytes`` of files; the
    ``error`` of its frame.
    """

    seconds: float
    megabytes: float
    error: float | None


@dataclass(frozen=True)
class Row:
    """A scene, what its plan keeps, and what that takes beside S1's way, which is None under lamps.

    ``reference_noise`` is the relative standard error of the frame that errors are told against.
    """

    scene: str
    representation: str
    layers: str
    bytes_per_texel: int
    texels: TexelCount
    by_plan: Bake
    by_s1: Bake | None
    reference_noise: float


@part(size=128)
@click.option(
    "--target",
    type=click.FloatRange(1e-4, 1.0),
    default=0.05,
    show_default=True,
    help="Texels' error.",
)
@click.option(
    "--scene", "names", type=click.Choice(list(PLANNED)), multiple=True, help="Only these."
)
def plans(size: int, target: float, names: tuple[str, ...]) -> Measurement:
    """What scenes keep for each texel by their plans, beside what S1 keeps of any."""
    chosen = names or tuple(PLANNED)
    scenes = tqdm(load_planned(chosen, target), desc="scenes", unit="scene", total=len(chosen))
    rows = [measure(name, scene, size) for name, scene in scenes]
    figures = {f"{row.scene}: {name}": value for row in rows for name, value in figures_of(row)}
    return Measurement(f"Plans beside S1, {size} × {size}, to {target:g}", figures, table(rows))


def figures_of(row: Row) -> Iterator[tuple[str, Any]]:
    """A row's figures by name; nothing for what does not apply."""
    yield "representation", row.representation
    yield "bytes a texel", row.bytes_per_texel
    yield "texels shown, %", 100.0 * row.texels.shown / row.texels.total
    for way, bake in (("plan", row.by_plan), ("S1", row.by_s1)):
        if bake is not None:
            yield f"{way}: bake, s", bake.seconds
            yield f"{way}: store, MB", bake.megabytes
            yield f"{way}: error, %", None if bake.error is None else 100.0 * bake.error
    yield "reference's noise, %", 100.0 * row.reference_noise


def measure(name: str, scene: Scene, size: int) -> Row:
    """Bake the view's texels in both ways, once all that calls is compiled."""
    s1 = as_s1(scene)
    loose = replace(scene, target_error=1.0)
    for way in filter(None, (loose, as_s1(loose))):
        baked(way, SMALL, traced(loose, SMALL, 1))
    best = traced(scene, size, PATHS)
    return Row(
        scene=name,
        representation=scene.plan.representation,
        layers=" + ".join(map(describe, scene.plan.layers)),
        bytes_per_texel=scene.plan.bytes_per_texel,
        texels=scene.texels,
        by_plan=baked(scene, size, best),
        by_s1=baked(s1, size, best) if s1 else None,
        reference_noise=best.noise,
    )


def traced(scene: Scene, size: int, paths: int) -> Frame:
    """The view's frame by the path tracer, with more bounces than the scene has where it has
    any.
    """
    if scene.bounces:
        longest = max(scene.bounces, LONGEST)
    else:
        longest = 0
    longer = replace(scene, plan=replace(scene.plan, bounces=longest))
    with tempfile.TemporaryDirectory() as store:
        return make_renderer(longer, store).render(
            view_of(scene, size, shading="path_traced", samples=paths)
        )


def baked(scene: Scene, size: int, best: Frame) -> Bake:
    """Bake what the view reads to a new store, and compare its frame with the ``best``."""
    with tempfile.TemporaryDirectory() as store:
        renderer = make_renderer(scene, store)
        view = view_of(scene, size)
        goal = Goal(scene.target_error)
        demands = renderer.render(view, goal).demands
        loader = renderer.caches.of(view.shading)
        begun = time.process_time()
        renderer.tiles.run(lambda a, b: bake(loader, demands[a:b], goal), len(demands), 1)
        taken = time.process_time() - begun
        written = sum(file.stat().st_size for file in Path(store).rglob("*") if file.is_file())
        return Bake(taken, written / 1e6, frame_error(renderer.render(view), best))


def bake(loader: Loader, demands: Sequence[Demand], goal: Goal) -> None:
    """Bake what is demanded to a ``goal``, and keep it."""
    spec = loader.chunk_store.spec
    for demand in demands:
        chunk = loader.chunk_store.load(demand.index).with_texels(demand.offsets)
        texels = spec.prepared.lattice.positions(chunk.index, chunk.offsets)
        refine(chunk.light, texels, spec, goal.most_samples, goal)
        loader.chunk_store.save(chunk)
        loader.refresh(demand.index)


def frame_error(frame: Frame, best: Frame) -> float | None:
    """RMSE of the luminance over surface pixels, over its mean in the ``best``; None where all is
    black.
    """
    on = best.state > 0
    if best.radiance[on].any():
        return relative_rmse(frame.radiance, best.radiance, on)
    return None


def describe(layer: Layer) -> str:
    """Kind, order n above 1, channels and precision of a layer, and the band l from which on it is
    of bytes.
    """
    if layer.order > 1:
        order = f" n = {layer.order}"
    else:
        order = ""
    colour = " RGB" if layer.channels == 3 else ""
    if layer.coarse is None:
        coarse = ""
    else:
        coarse = f", bytes from l = {layer.coarse}"
    return f"{layer.kind}{order}{colour} ({'half' if layer.half else 'single'}{coarse})"


def table(rows: Sequence[Row]) -> str:
    """The rows in Markdown."""
    return markdown(HEAD, map(cells, rows), left=3)


def cells(row: Row) -> list[str]:
    """The text of each of a row's cells."""
    plan = row.by_plan
    s1 = row.by_s1
    texels = row.texels
    chunks = texels.shown_chunks
    side = texels.chunk
    lattice = (
        lattice_bytes(chunks, side, row.bytes_per_texel),
        lattice_bytes(texels.chunks, side, S1_BYTES),
    )
    return [
        *(
            row.scene,
            row.representation,
            row.layers,
            str(row.bytes_per_texel),
            f"{texels.shown / texels.total:.1%}",
        ),
        pair("{:,.1f}", *(size / 1e6 for size in lattice)),
        pair("{:.1f}", plan.seconds, s1.seconds if s1 else None),
        pair("{:.2f}", plan.megabytes, s1.megabytes if s1 else None),
        pair("{:.1%}", plan.error, s1.error if s1 else None),
    ]


def pair(form: str, plan: float | None, s1: float | None) -> str:
    """Two figures; a dash for one that there is not."""
    return " / ".join("–" if value is None else form.format(value) for value in (plan, s1))
