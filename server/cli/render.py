"""``isogi render`` and ``isogi reference``: one view as a picture, from the cache or
path-traced.
"""

import math
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from isogi_core.cache.scene_caches import Caches
from isogi_core.errors import Cancelled, ViewError
from isogi_core.frame.fitting import Stand
from isogi_core.frame.frame import TAIL, Frame
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.tiles import Tiles
from isogi_core.model.choices import PROJECTIONS
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene
from isogi_core.plan.variants import at_both_signs
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_core.reference import (
    Goal,
    Reference,
    grow_reference,
    load_reference,
    save_reference,
    with_bounces,
)
from isogi_core.storage.atomic_file import check_folder, check_writable, write_whole
from server.answers import coverage_schema, fit
from server.clocks import waiting
from server.parameters import FrameParams, ViewParams, read
from server.pictures import FORMAT_OF_SUFFIX, encode, format_for, smoothed
from server.progress import Progress, compiling, open_scene
from server.render.bakes import Patience, time_limit
from server.render.engine import RenderEngine, engine_for
from server.settings import Settings
from server.views import PLACING, isovalue_of, view_of, with_first_view
from worker.errors import WorkersError
from worker.progress import TimeLeft

FRAME_SECONDS = 2.0
"""Seconds between two frames, while light is baked."""

LOOKED_AT = 24
"""Pictures of many, at most, whose surfaces are looked at."""

PACKED_PIXEL_BYTES = 1
NPY_PIXEL_BYTES = 36
"""Bytes of a pixel that room is looked for, in a packed picture and in an npy."""

REFERENCE_BYTES = 1 << 30
"""Bytes of light that the renderer of a reference may hold."""


def render(
    target: str,
    output: Path,
    knobs: Mapping[str, str],
    settings: Settings,
    seconds: float | None = None,
) -> dict[str, Any]:
    """Write the picture of a view, named by ``knobs``, and say how good it is and what it took.

    Ends when every pixel is final, or after ``seconds`` of baking. Raises SceneError, VolumeError,
    LightError and ViewError before anything is begun, StoreError, WorkersError and OSError later.
    """
    started = time.monotonic()
    form = format_of(output)
    scene = open_scene(target, settings)
    knobs = with_first_view(scene, knobs)
    params = smoothed(read(FrameParams, [*knobs.items(), ("f", form)]), form)
    format_for(params, None)
    scene = at_both_signs(scene, isovalue_of(scene, params))
    view_of(scene, params, settings)
    pixel = NPY_PIXEL_BYTES if form == "npy" else PACKED_PIXEL_BYTES
    check_writable(output, pixel * params.width * params.height)

    with working(scene, settings) as engine:
        if not is_placed(knobs):
            [params] = seen_whole(engine.renderer(scene.id), [params], settings)
        view = view_of(scene, params, settings)
        frame = draw_refined(engine, scene.id, view, params.max_error, seconds)
        left = engine.time_left(scene.id, frame, params.max_error)
        paths = engine.baker.paths
        # Workers that are still starting when the time is over are no trouble.
        trouble = ""
        if not (frame.final or engine.store.read_only):
            trouble = engine.trouble() or engine.baker.paused()
    if params.exposure is None:
        exposure = scene.default_exposure
    else:
        exposure = params.exposure
    write_whole(output, encode(frame, form, exposure, params))
    return {
        "file": str(output),
        "format": form,
        **frame_facts(frame, left),
        "target_error": params.max_error or scene.target_error,
        "final": frame.coverage["final"],
        "paths": paths,
        "stopped": stopped_by(frame),
        "note": why_empty(scene, view) if not frame.surface else "",
        "trouble": trouble,
        "seconds": time.monotonic() - started,
    }


def why_empty(scene: Scene, view: View) -> str:
    """Why a picture of a view shows no surface, in a sentence that says what to do."""
    low, high = scene.volume.value_range
    if low == high:
        return f"No surface: all values are {low:.6g}."
    if not low < view.isovalue < high:
        return (
            f"No surface at {view.isovalue:.6g}: values go from {low:.6g} to {high:.6g}, choose "
            "an isovalue between them."
        )
    if view.window is not None or scene.source.document.get("cut"):
        return (
            f"No surface at {view.isovalue:.6g} in what the cut leaves: cut away less, or choose "
            "another isovalue."
        )
    return (
        f"No surface at {view.isovalue:.6g} in view: leave the camera out, or choose another "
        "isovalue."
    )


def stopped_by(frame: Frame) -> str:
    """What ended the rendering of a frame: its target, the samples that were asked for, or the
    time.
    """
    if frame.final:
        return "target"
    if frame.view.shading == "path_traced":
        return "samples"
    return "time"


def rendered(facts: Mapping[str, Any]) -> str:
    """What ``render`` did, for a person."""
    states = {"target": "final", "time": "provisional", "samples": "all samples taken"}
    quality = (
        f"error {facts['error']:.4f}, {facts['final']:.1%} of the surface at "
        f"{facts['target_error']:g}"
    )
    if facts["stopped"] == "time" and facts["error"] <= facts["target_error"]:
        quality = f"{unsure(facts)}, {quality}"
    if facts["note"]:
        return f"{facts['file']}: {facts['width']} × {facts['height']}. {facts['note']}"
    return (
        f"{facts['file']}: {facts['width']} × {facts['height']}, "
        f"{states[facts['stopped']]}, {quality}"
    )


def unsure(facts: Mapping[str, Any]) -> str:
    """Why a picture is provisional though its error is below the target, for a person."""
    if facts["interval"] is None:
        return "not measured yet"
    low, high = facts["interval"]
    if high > facts["target_error"]:
        return f"between {low:.4f} and {high:.4f}"
    if facts["p99"] and facts["p99"] > TAIL * facts["target_error"]:
        return f"1 % of pixels off by more than {facts['p99']:.4f}"
    return "not all of its light is there"


def frame_facts(frame: Frame, left: TimeLeft | None) -> dict[str, Any]:
    """Size, quality and version of a frame, and the time until it would be final."""
    size = {"width": frame.view.width, "height": frame.view.height}
    return {**size, **coverage_schema(frame, left).model_dump(), "version": frame.version}


@contextmanager
def working(scene: Scene, settings: Settings, hire: bool = True) -> Iterator[RenderEngine]:
    """An engine of a ``scene`` that has its kernels and, if it is to ``hire`` them, workers; closed
    at the end.
    """
    with waiting("preparing the scene"):
        engine = engine_for(scene, settings, hire)
    with closing(engine):
        with compiling(lambda: engine.kernels.progress, "starting workers"):
            engine.start(hire=hire)
        yield engine


def format_of(output: Path) -> str:
    """The format that the file's suffix names; ViewError for others and where the folder is
    missing.
    """
    if output.suffix.lower() not in FORMAT_OF_SUFFIX:
        raise ViewError(
            f"{output} names no picture format: end it in {', '.join(FORMAT_OF_SUFFIX)}."
        )
    check_folder(output)
    return FORMAT_OF_SUFFIX[output.suffix.lower()]


def is_placed(given: Iterable[str]) -> bool:
    """Whether any of the parameters that are ``given`` places the camera."""
    return not PLACING.isdisjoint(given)


def seen_whole(
    renderer: Renderer, shots: Sequence[FrameParams], settings: Settings
) -> list[FrameParams]:
    """The ``shots`` with one target and one distance for all of them, from the directions that they
    give.
    """
    scene = renderer.prepared.scene
    turned = [from_front(scene, shot) for shot in shots]
    few = np.unique(np.linspace(0, len(turned) - 1, LOOKED_AT).round().astype(int))
    stands = [stand_of(scene, turned[n], settings) for n in few]
    target, distance = fit(renderer, stands, shots[0].projection)
    return [shot.model_copy(update={"target": target, "distance": distance}) for shot in turned]


def from_front(scene: Scene, shot: FrameParams) -> FrameParams:
    """The ``shot`` from the angles that it gives, and where it gives none, from the scene's
    front.
    """
    azimuth, elevation = scene.front
    front = {"azimuth": azimuth, "elevation": elevation}
    return shot.model_copy(
        update={name: angle for name, angle in front.items() if name not in shot.model_fields_set}
    )


def stand_of(scene: Scene, shot: FrameParams, settings: Settings) -> Stand:
    """Where the camera of a picture looks from."""
    view = view_of(scene, shot.model_copy(update={"projection": PROJECTIONS[0]}), settings)
    return Stand(view, shot.azimuth, shot.elevation)


def draw_refined(
    engine: RenderEngine, scene: str, view: View, max_error: float | None, seconds: float | None
) -> Frame:
    """Bake and draw as ``awaited`` does, with the seconds left on a bar meanwhile; the bar never
    runs back.
    """
    begun = time.monotonic()
    shown = 0.0
    with Progress("lighting", "") as bar:
        bar.show(0, 100)

        def show(frame: Frame) -> None:
            nonlocal shown
            left = engine.time_left(scene, frame, max_error)
            passed = time.monotonic() - begun
            if frame.final:
                done = 1.0
            elif left and passed:
                done = passed / (passed + left.likely)
            else:
                done = 0.0
            shown = max(shown, done)
            bar.show(int(100 * shown), 100, left)

        return awaited(engine, scene, view, max_error, seconds, show)


def awaited(
    engine: RenderEngine,
    scene: str,
    view: View,
    max_error: float | None,
    seconds: float | None,
    show: Callable[[Frame], object] = lambda _: None,
) -> Frame:
    """The frame once it is final or the time is spent; those on the way are shown.

    A path-traced frame is as good as its samples: it is returned at once. Raises WorkersError where
    the workers fail, or nothing has changed for as long as a ``Patience`` lasts.
    """
    patience = Patience(clock=time.monotonic)
    if seconds is None:
        deadline = math.inf
    else:
        deadline = time.monotonic() + seconds
    # a first picture is drawn however long it takes; what makes it better ends at the deadline
    frame = None
    with time_limit(deadline) as over:
        while True:
            left = max(0.0, deadline - time.monotonic())
            try:
                frame = engine.frame(
                    scene,
                    view,
                    max_error=max_error,
                    wait=min(FRAME_SECONDS, left) if frame or math.isinf(deadline) else 0.0,
                    cancelled=over if frame else None,
                )
            except Cancelled:
                if frame is None:
                    raise
                return frame
            coming = frame.checkable or engine.lacking(scene, frame)[1].demands
            show(frame)
            if frame.final or time.monotonic() >= deadline or not coming:
                return frame
            if frame.checkable:
                continue
            if engine.trouble():
                raise WorkersError(engine.trouble())
            patience.check(frame.version, engine.workforce.preparing, engine.unready())


def reference(
    target: str,
    output: Path,
    knobs: Mapping[str, str],
    settings: Settings,
    bounces: int | None,
    goal: Mapping[str, Any],
) -> dict[str, Any]:
    """Grow the reference of a view, named by ``knobs``, in the file ``output``, and say how good it
    is.

    It is written after each round, and gone on from where it is there already. ``goal`` are a
    Goal's. Raises SceneError, VolumeError, LightError and ViewError before anything is begun,
    ReportError and OSError later.
    """
    check_file(output)
    scene = open_scene(target, settings)
    view = view_of(scene, read(ViewParams, knobs.items()), settings)

    return grow_file(with_bounces(scene, bounces), view, output, Goal(**goal))


def check_file(output: Path) -> None:
    """ViewError where the file's name is of another kind, or its folder missing."""
    if output.suffix != ".npz":
        raise ViewError(f"{output} is no name for a reference: end it in .npz.")
    check_folder(output)


def grow_file(scene: Scene, view: View, output: Path, goal: Goal) -> dict[str, Any]:
    """Grow the reference in ``output`` to its goal, with a bar; its facts."""

    if output.exists():
        former = load_reference(output, scene, view)
    else:
        former = None
    found = former
    with (
        tempfile.TemporaryDirectory(prefix="isogi-reference-") as store,
        tqdm(unit="path", unit_scale=True) as bar,
    ):
        renderer = Renderer(Caches(PreparedScene(scene), store, REFERENCE_BYTES), Tiles())
        for found in grow_reference(renderer, view, goal, former, progress=bar.update):
            save_reference(output, found, scene, view)
            show_noise(bar, found, goal)
    assert found is not None, "one round is made in any case"
    return {
        "file": str(output),
        "scene": scene.name,
        "bounces": scene.bounces,
        **reference_facts(found),
    }


def show_noise(bar: Any, found: Reference, goal: Goal) -> None:
    """Put on the bar how good a reference is, and how many paths are still to come."""
    foreseen = goal.foresee(found)
    if foreseen is None:
        bar.total = None
    else:
        bar.total = bar.n + int(found.on.sum()) * (foreseen - found.samples)
    bar.set_postfix(samples=found.samples, noise=f"{found.noise:.2%}")


def reference_facts(found: Reference) -> dict[str, Any]:
    """Size and quality of a reference, and the processor's seconds that it took."""
    height, width = found.on.shape
    size = {"width": width, "height": height, "surface": int(found.on.sum())}
    return {**size, "samples": found.samples, "noise": found.noise, "seconds": found.seconds}


def grown(facts: Mapping[str, Any]) -> str:
    """What ``reference`` did, for a person."""
    size = f"{facts['width']} × {facts['height']}, {facts['samples']} paths per pixel"
    return (
        f"{facts['file']}: {size}, noise {facts['noise']:.5f}, {facts['seconds']:.1f} "
        "seconds of the processor"
    )
