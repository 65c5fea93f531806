"""An isovalue slid through a room: frames at rest over one store, beside a fresh bake of each, and
beside paths.

    python -m benchmarks.accuracy sliding [SCENE] [--size 48] [--frames 7] [--paths 512] [--only
    nucleon]

The walls and the surface that slides light each other (S3, section 4.2: walls are lit "in
lock-step"). An engine shows isovalue after isovalue over one store, and each picture is baked to
the scene's target and checked before the next; so it may read texels that were baked for the
isovalues before, and light of walls that is mixed between them. Beside it are the picture of an
engine over an empty store, and a path-traced one. A SCENE slides through its ``isovalues``; without
one shared data are needed.

RMSE is of the luminance of all that is seen, walls and their lamp among it, and of the isosurface
alone, over the mean of the path-traced picture and less its noise. A jump is the root mean square
of what pixels change by from one frame to the next that show the same wall in both, or the
isosurface in both. The truth's jump is less the noise of that change, most of which cancels, as
both pictures are of the same random numbers: it is told from those with half of the paths. How
unlike the frames' change is to the truth's is told with all noise in it.
"""

import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise

import click
import numpy as np

from benchmarks.accuracy.benches import wanted
from benchmarks.accuracy.room import PATIENCE, VIEWS
from benchmarks.common.measurement import Measurement, markdown
from benchmarks.common.scenes import VOLUMES, shared_data
from benchmarks.common.suite import part
from isogi_core.bake.noise import Goal
from isogi_core.files.scene_file import SceneSource
from isogi_core.frame.frame import Frame
from isogi_core.model.view import View
from isogi_core.plan.assembly import build_scene, load_scene
from isogi_core.plan.scene import Scene
from isogi_report.metrics import luminance_of, mean_of, spread_of
from isogi_report.speed import view_of
from isogi_server.cli.render import awaited
from isogi_server.render.engine import RenderEngine

SLIDES: Mapping[str, tuple[str, float, float]] = {
    "nucleon": ("nucleon_41x41x41_uint8.nhdr", 110.0, 170.0),
    "MNI brain": (VOLUMES["MNI brain"], 60.0, 120.0),
}
"""Files of volumes, and the isovalues that they are slid between, by what a person calls them."""

SURFACE = 1
"""What pixels are marked with that show the isosurface."""

RMSE = 0.03
JUMP = 0.01
"""What is asked: the RMSE of each frame, and what its jump may be above the truth's."""

HEAD = (
    *(
        "volume",
        "isovalue",
        "RMSE, %",
        "of the isosurface, %",
        "told, %",
        "fresh bake's RMSE, %",
        "apart from it, %",
    ),
    *("jump, %", "the truth's, %", "above it, %", "unlike it, %", "path-traced picture's noise, %"),
)


@dataclass(frozen=True, eq=False)
class Shot:
    """What is seen of an ``isovalue``: the ``frame`` over a store with others' light, the ``fresh``
    one, over an empty store, and the ``truth``, path-traced, of whose paths ``half`` has the first
    half.
    """

    isovalue: float
    frame: Frame
    fresh: Frame
    truth: Frame
    half: Frame


@dataclass(frozen=True)
class Errors:
    """What one frame errs by, relative to the mean luminance of its truth, whose ``noise`` is told.

    ``rmse`` and ``fresh_rmse`` are of the frame and of a fresh bake's, ``surface`` of the frame's
    isosurface alone, and ``told`` is the frame's own; ``apart`` is the root mean square difference
    between frame and fresh bake.
    """

    rmse: float
    surface: float
    told: float
    fresh_rmse: float
    apart: float
    noise: float


@dataclass(frozen=True)
class Jump:
    """From one frame to the next: what it changes by itself, what the ``truth`` does, and how much
    these differ.
    """

    frames: float
    truth: float
    unlike: float

    @property
    def above(self) -> float:
        """By how much the frames' jump is larger than the truth's, if it is."""
        return max(self.frames - self.truth, 0.0)


@part(size=48)
@click.argument("target", required=False)
@click.option(
    "--frames",
    type=click.IntRange(2),
    default=7,
    show_default=True,
    help="Isovalues, evenly spaced.",
)
@click.option(
    "--paths",
    type=click.IntRange(16),
    default=512,
    show_default=True,
    help="Paths a pixel of the truth.",
)
@click.option("--only", multiple=True, help="Part of a volume's name; repeatable.")
def sliding(
    target: str | None, frames: int, paths: int, size: int, only: tuple[str, ...]
) -> Measurement:
    """An isovalue slid by 60 in a room: frames beside fresh bakes and beside paths, and how far
    they jump.
    """
    figures = dict[str, float]()
    rows = list[tuple[str, ...]]()
    for scene in scenes(target, only):
        shots = list(shoot(scene, slide(scene, size, frames), paths))
        errors = [errors_of(each) for each in shots]
        jumps = [jump(*both) for both in pairwise(shots)]
        figures |= {
            f"{scene.name}: {key}": value for key, value in figures_of(shots, errors, jumps).items()
        }
        rows += [(scene.name, *each) for each in map(cells, shots, errors, [None, *jumps])]
    return Measurement(
        f"Isovalues slid through a room, {size} × {size}", figures, markdown(HEAD, rows)
    )


def scenes(target: str | None, only: Sequence[str]) -> Iterator[Scene]:
    """The scene ``target``, or those of SLIDES in a Cornell room with these words in their names.

    ClickException where the shared data are not at hand.
    """
    if target is not None:
        yield load_scene(target)
        return
    data = shared_data()
    if data is None:
        raise click.ClickException(
            "There are no shared volumes: set ISOGI_SHARED_DATA to a folder that has them."
        )
    for name, (file, low, high) in SLIDES.items():
        if wanted(name, only):
            own = {
                "volume": str(data / file),
                "room": "cornell",
                "isovalue": low,
                "isovalues": [low, high],
            }
            yield build_scene(SceneSource(name, own, data))


def slide(scene: Scene, size: int, frames: int) -> list[View]:
    """So many views of a scene in its room, evenly spaced through its isovalues."""
    azimuth, elevation, distance = VIEWS["room"]
    view = view_of(scene, size, camera=scene.camera(azimuth, elevation, distance, 30.0))
    return [replace(view, isovalue=float(value)) for value in np.linspace(*scene.isovalues, frames)]


def shoot(scene: Scene, views: Iterable[View], paths: int) -> Iterator[Shot]:
    """Show ``views`` one after the other over one store, each beside a fresh bake and ``paths``
    from its pixels.
    """
    with opened(scene) as engine:
        goal = Goal.checked(scene.target_error)
        for view in views:
            begun = time.monotonic()
            frame = awaited(engine, scene.id, view, goal, PATIENCE)
            traced = [
                replace(view, shading="path_traced", samples=count) for count in (paths, paths // 2)
            ]
            truth, half = (engine.survey(scene.id, each, goal) for each in traced)
            with opened(scene) as anew:
                fresh = awaited(anew, scene.id, view, goal, PATIENCE)
            click.echo(
                f"{scene.name} at {view.isovalue:g}: {time.monotonic() - begun:.0f} s", err=True
            )
            yield Shot(view.isovalue, frame, fresh, truth, half)


@contextmanager
def opened(scene: Scene) -> Iterator[RenderEngine]:
    """An engine that has begun, with two workers, over a store that is empty."""
    with (
        tempfile.TemporaryDirectory() as store,
        closing(RenderEngine([scene], store, workers=2)) as engine,
    ):
        engine.start()
        yield engine


def errors_of(shot: Shot) -> Errors:
    """What a frame and the fresh one err by."""
    on = kinds(shot.truth) > 0
    own = kinds(shot.truth) == SURFACE
    frame, fresh, truth = (
        luminance_of(each.radiance) for each in (shot.frame, shot.fresh, shot.truth)
    )
    noise = noise_of(shot.truth)
    mean = mean_of(truth[on])
    return Errors(
        rmse=spread_of((frame - truth)[on], noise[on], mean).rmse,
        surface=spread_of((frame - truth)[own], noise[own], mean_of(truth[own])).rmse,
        told=shot.frame.total.likely,
        fresh_rmse=spread_of((fresh - truth)[on], noise[on], mean).rmse,
        apart=spread_of((frame - fresh)[on], 0.0, mean).rmse,
        noise=spread_of(np.sqrt(noise[on]), 0.0, mean).rmse,
    )


def jump(before: Shot, after: Shot) -> Jump:
    """From one shot to the next, in pixels that show the same wall in both, or the isosurface.

    The noise of the truth's change is that by which the change of one half of its paths differs
    from it.
    """
    same = (kinds(before.truth) == kinds(after.truth)) & (kinds(after.truth) > 0)
    frames, truth, half = (
        (luminance_of(new.radiance) - luminance_of(old.radiance))[same]
        for old, new in (
            (before.frame, after.frame),
            (before.truth, after.truth),
            (before.half, after.half),
        )
    )
    mean = mean_of(
        np.concatenate([luminance_of(each.truth.radiance)[same] for each in (before, after)])
    )
    return Jump(
        frames=spread_of(frames, 0.0, mean).rmse,
        truth=spread_of(truth, (half - truth) ** 2, mean).rmse,
        unlike=spread_of(frames - truth, 0.0, mean).rmse,
    )


def kinds(frame: Frame) -> np.ndarray:
    """What the pixels of a frame show: SURFACE, or SURFACE + 1 + a wall's number; 0 for nothing;
    (h, w) int.
    """
    found = np.zeros(frame.state.shape, np.int64)
    walls = frame.gbuffer.walls
    found.flat[frame.gbuffer.pixels] = SURFACE
    found.flat[walls.pixels] = SURFACE + 1 + walls.numbers
    return found


def noise_of(truth: Frame) -> np.ndarray:
    """The variance of the luminance of a path-traced frame's pixels, as it tells; (h, w)
    float64.
    """
    return np.asarray((truth.error * luminance_of(truth.radiance)) ** 2)


def figures_of(
    shots: Sequence[Shot], errors: Sequence[Errors], jumps: Sequence[Jump]
) -> dict[str, float]:
    """What a slide comes to: the worst of its frames and of its jumps."""
    worst = max(each.rmse for each in errors)
    above = max(each.above for each in jumps)
    return {
        "frames": len(shots),
        "final": sum(shot.frame.final for shot in shots),
        "RMSE, largest, %": 100.0 * worst,
        "RMSE of the isosurface, largest, %": 100.0 * max(each.surface for each in errors),
        "told, largest, %": 100.0 * max(each.told for each in errors),
        "fresh bake's RMSE, largest, %": 100.0 * max(each.fresh_rmse for each in errors),
        "apart from a fresh bake, largest, %": 100.0 * max(each.apart for each in errors),
        "the truth's jump, largest, %": 100.0 * max(each.truth for each in jumps),
        "jump above the truth's, largest, %": 100.0 * above,
        "change unlike the truth's, largest, %": 100.0 * max(each.unlike for each in jumps),
        "path-traced picture's noise, largest, %": 100.0 * max(each.noise for each in errors),
        f"within {RMSE:.0%}, jumps within the truth's + {JUMP:.0%}": worst <= RMSE
        and above <= JUMP,
    }


def cells(shot: Shot, errors: Errors, made: Jump | None) -> tuple[str, ...]:
    """A line of the table, in percent; the first frame has ``made`` no jump."""
    told = f"{100.0 * errors.told:.2f}{'' if shot.frame.final else ' (not final)'}"
    shares = (errors.rmse, errors.surface), (errors.fresh_rmse, errors.apart)
    first, second = ([f"{100.0 * each:.2f}" for each in some] for some in shares)
    if made:
        moved = [made.frames, made.truth, made.above, made.unlike]
    else:
        moved = []
    last = [f"{100.0 * each:.2f}" for each in moved] or ["–"] * 4
    return (f"{shot.isovalue:g}", *first, told, *second, *last, f"{100.0 * errors.noise:.2f}")
