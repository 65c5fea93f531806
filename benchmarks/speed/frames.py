"""Frame times of all shadings side by side, cache warm, and what turning only the light costs.

    python -m benchmarks.speed frames [TARGET] [--size 512] [--repeats 15] [--json]

Every camera is new to the renderer, so that each frame casts its primary rays; frames by "gi" are
those of a hand that turns it on by a degree. Light is final, but where it is said to converge, and
is filtered. Shadings are interleaved, and ratios are of medians (S1, table 2 has SH at 1.45 ×
Lambert and 0.75 × with shadow). Without a TARGET the same view is then measured under probes whose
lights have other numbers of lobes.
"""

import math
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace

import click

from benchmarks.common.measurement import Figures, Measurement
from benchmarks.common.scenes import benchmark_scene, shared_data
from benchmarks.common.suite import part
from benchmarks.common.timing import milliseconds
from isogi_core.bake.noise import Goal
from isogi_core.frame.film import develop
from isogi_core.frame.renderer import Renderer
from isogi_core.model.scene_plan import MIN_SAMPLES
from isogi_core.model.view import View, Window
from isogi_core.plan.scene import Scene
from isogi_report.bench import UNREACHED_GOAL
from isogi_report.speed import (
    LOOSEST_GOAL,
    Candidate,
    bake_view,
    make_renderer,
    medians,
    new_camera,
    relight,
    seconds,
    turned,
    view_of,
)

PROBES = (
    "uffizi_256x128",
    "noon_grass_1024x512",
    "sepulchral_chapel_rotunda_1024x512",
    "grace_256x128",
)
"""Shared probes whose lights have no lobe, one, two and four."""

STEP = 1.2
"""Degrees by which a camera is turned on from frame to frame."""

SHADINGS = ("gi", "lambert", "lambert_shadow", "lambert_fog", "phong", "phong_shadow")


@part(size=512, repeats=15)
@click.argument("target", required=False)
def frames(target: str | None, size: int, repeats: int) -> Measurement:
    """Frame times of all shadings side by side, light baked, and of turning only the light."""
    scene = benchmark_scene(target)
    with lit(scene, size) as (renderer, view):
        texels = sum(
            len(demand.offsets) for demand in renderer.render(view, UNREACHED_GOAL).demands
        )
        figures = summarise(medians(candidates(renderer, view), repeats))
        figures["lattice / texels of this view"] = math.prod(renderer.prepared.shape) / texels
    data = None if target else shared_data()
    for probe in PROBES if data else ():
        figures |= under_light(
            {"type": "probe", "file": f"{data}/probe_{probe}.hdr"}, size, repeats
        )
    title = f"{scene.name} at {scene.isovalue:g}, {size} × {size}, {renderer.tiles.threads} threads"
    return Measurement(title, figures)


@contextmanager
def lit(scene: Scene, size: int) -> Iterator[tuple[Renderer, View]]:
    """A renderer of a scene, and its view that is measured, with all light that this and the next
    camera's read.
    """
    with tempfile.TemporaryDirectory() as store:
        renderer = make_renderer(scene, store)
        view = view_of(scene, size)
        for each in (view, on_from(renderer, view)):
            bake_view(renderer, each, MIN_SAMPLES)
        yield renderer, view


def under_light(light: Mapping[str, str], size: int, repeats: int) -> Figures:
    """A moved camera and a turned light of the engine, over Lambert's frames, by the lobes that its
    ``light`` has.
    """
    with lit(benchmark_scene(None, lights=[light]), size) as (renderer, view):
        moving = replace(view, moving=True)
        lobes = renderer.prepared.scene.plan.lobes
        some = {
            "lambert": new_camera(renderer, replace(view, shading="lambert")),
            "gi": next_camera(renderer, view),
            "gi, moving": next_camera(renderer, moving),
            "relight": relight(renderer, view),
            "relight, moving": relight(renderer, moving),
        }
        median = medians(some, repeats)
    return {
        f"{name} / lambert, {lobes} lobes": median[name] / median["lambert"]
        for name in some
        if name != "lambert"
    }


def candidates(renderer: Renderer, view: View) -> dict[str, Candidate]:
    """A frame by each shading, of light that converges, and through a "window" whose plane has
    moved; "relight", the light turned alone, and "develop", the tone curve.
    """
    exposure = renderer.prepared.scene.default_exposure

    def tone(turn: int) -> float:
        lit = renderer.render(turned(view, turn), LOOSEST_GOAL)
        return seconds(lambda: develop(lit, exposure))

    frames = {shading: new_camera(renderer, replace(view, shading=shading)) for shading in SHADINGS}
    frames["gi"] = next_camera(renderer, view)
    frames["gi, converging"] = new_camera(renderer, view, Goal.checked(UNREACHED_GOAL.error))
    frames["window"] = new_plane(renderer, view)
    return {**frames, "relight": relight(renderer, view), "develop": tone}


def on_from(renderer: Renderer, view: View) -> View:
    """The view whose camera is turned on a little from that which is measured."""
    return replace(view, camera=renderer.prepared.scene.camera(40.0 + STEP, 30.0, 3.0, 30.0))


def next_camera(renderer: Renderer, view: View) -> Candidate:
    """A frame whose camera is turned on a little from the one before, under a light that is no
    other frame's.
    """

    def render(turn: int) -> float:
        renderer.forget_views()
        before = turned(view, turn + 0.3)
        for _ in range(2):
            renderer.render(before, LOOSEST_GOAL)
        return seconds(lambda: renderer.render(on_from(renderer, before), LOOSEST_GOAL))

    return render


def new_plane(renderer: Renderer, view: View) -> Candidate:
    """A frame through a window whose one plane has moved: half of the object is taken away, more or
    less.
    """
    volume = renderer.prepared.scene.volume

    def render(turn: int) -> float:
        renderer.forget_views()
        place = volume.centre[2] + volume.spacing[2] * (turn % 16 - 8)
        window = Window(((0.0, 0.0, -1.0, place),))
        return seconds(lambda: renderer.render(replace(view, window=window), LOOSEST_GOAL))

    return render


def summarise(median: dict[str, float]) -> dict[str, float]:
    """Medians in milliseconds, and the ratios that are asked for."""
    return {
        **milliseconds(median),
        "gi, converging / gi": median["gi, converging"] / median["gi"],
        "window / gi": median["window"] / median["gi"],
        "gi / lambert": median["gi"] / median["lambert"],
        "gi / lambert_shadow": median["gi"] / median["lambert_shadow"],
        "relight / gi": median["relight"] / median["gi"],
    }
