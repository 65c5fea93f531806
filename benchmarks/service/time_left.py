"""Whether the time left is right while pictures are drawn, checks and light of pixels included.

    python -m benchmarks.service time-left [SCENE.toml …] [--size 256] [--target-error 0.02]
        [--most 600] [--json]

Each scene, by default ten, is drawn by an engine with workers of this machine over an empty store,
as ``isogi render`` draws it. The time left is sampled each second as the page counts it down, and
compared with the time that the picture then took. A number stands as long as its words stay the
same; reported is the longest time that one stood, over the time that it named. The last second is
not counted, as no less is ever named. What is not final after ``--most`` seconds counts as far as
that was to be foreseen.
"""

import os
import tempfile
import time
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np

from benchmarks.common.measurement import Measurement, markdown
from benchmarks.common.suite import part
from isogi_core.bake.noise import Goal
from isogi_core.frame.frame import Frame
from isogi_core.plan.assembly import load_scene
from isogi_core.plan.scene import Scene
from isogi_report.speed import view_of
from isogi_server.cli.render import awaited
from isogi_server.render.engine import RenderEngine
from isogi_server.values import span
from isogi_worker.progress import TimeLeft

DOCS = Path(__file__).parents[2] / "docs"

SCENES = (
    *("demo:casting", "demo:orbital"),
    *(str(DOCS / f"{name}.toml") for name in ("albedo", "colours", "cornell", "glow", "lamp")),
    *(str(DOCS / f"{name}.toml") for name in ("surfaces", "scenes/medical", "scenes/microscopy")),
)
"""Scenes that are drawn where none is named: those whose volume is there."""

FACTOR = 2.0
"""A time left is right within this factor."""

HEAD = ("scene", "seconds", "samples", "within 2×", "longest that one stands, over itself")


class Estimate(NamedTuple):
    """The time left that a frame came with, so many seconds after the start; None if unknown."""

    at: float
    left: TimeLeft | None


@part(size=256)
@click.argument("targets", nargs=-1)
@click.option("--target-error", default=0.02, show_default=True, help="Of the pictures.")
@click.option("--most", default=600.0, show_default=True, help="Seconds for a picture.")
def time_left(targets: tuple[str, ...], size: int, target_error: float, most: float) -> Measurement:
    """Whether the time left is right, from the first second to the final picture."""
    figures = dict[str, float]()
    rows = list[tuple[str, ...]]()
    for target in targets or SCENES:
        try:
            scene = load_scene(found(target))
        except FileNotFoundError:
            click.echo(f"{target} is left out: its volume is not here.", err=True)
            continue
        name = Path(target).stem
        seconds, estimates = watch(scene, size, Goal.checked(target_error), most)
        shares = judged(seconds, estimates)
        figures |= {f"{name}: {key}": value for key, value in shares.items()}
        rows.append((name, *(f"{value:.2f}" for value in shares.values())))
        click.echo(" | ".join(rows[-1]), err=True)
    return Measurement(f"Time left, {size} × {size}", figures, markdown(HEAD, rows))


def found(target: str) -> str:
    """The scene file, or a copy of it that names its volume in the folder ISOGI_SHARED_DATA.

    Raises FileNotFoundError if the volume is nowhere.
    """
    if target.startswith("demo:") or "scenes" not in Path(target).parts:
        return target
    text = Path(target).read_text()
    name = next(line for line in text.splitlines() if line.startswith("volume")).split('"')[1]
    data = Path(os.environ.get("ISOGI_SHARED_DATA", "/nowhere"))
    volume = next(data.rglob(name), None)
    if volume is None:
        raise FileNotFoundError(name)
    copy = Path(tempfile.mkdtemp()) / Path(target).name
    copy.write_text(text.replace(f'"{name}"', f'"{volume.resolve()}"'))
    return str(copy)


def watch(scene: Scene, size: int, goal: Goal, most: float) -> tuple[float, list[Estimate]]:
    """Draw a picture; return the seconds that it took, and all estimates on the way."""
    estimates = list[Estimate]()
    with (
        tempfile.TemporaryDirectory() as store,
        closing(RenderEngine([scene], store, workers=os.cpu_count() or 1)) as engine,
    ):
        engine.start()
        begun = time.monotonic()

        def note(frame: Frame) -> None:
            left = engine.time_left(scene.id, frame, goal)
            estimates.append(Estimate(time.monotonic() - begun, left))

        awaited(engine, scene.id, view_of(scene, size), goal, most, note)
        return time.monotonic() - begun, estimates


def judged(seconds: float, estimates: list[Estimate]) -> dict[str, float]:
    """The share of ``seconds`` at which the time left was right, and the longest that one stood."""
    right = list[bool]()
    longest = 0.0
    words = ""
    since = named = 0.0
    for at in np.arange(1.0, seconds - 1.0, 1.0):
        known = [each for each in estimates if each.at <= at]
        if not known or known[-1].left is None:
            continue
        now = known[-1].left.after(at - known[-1].at).likely
        right.append(1.0 / FACTOR <= max(now, 1.0) / (seconds - at) <= FACTOR)
        # Follow how long the words stay the same.
        said = span(max(now, 1.0), digits=2)
        if said != words:
            words = said
            since = at
            named = max(now, 1.0)
        longest = max(longest, (at - since) / named)
    share = float(np.mean(right)) if right else 1.0
    return {"seconds": seconds, "samples": float(len(right)), "within": share, "stands": longest}
