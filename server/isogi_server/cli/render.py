"""``isogi render`` and ``isogi reference``: one view as a picture, with cached light or
path-traced.
"""

import math
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from isogi_core.bake.noise import Goal
from isogi_core.cache.scene_caches import Caches
from isogi_core.errors import Cancelled, ViewError
from isogi_core.files.scene_file import Target
from isogi_core.files.spelling import shortest
from isogi_core.frame.fitting import Stand
from isogi_core.frame.frame import TAIL, Frame
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.tiles import Tiles
from isogi_core.model.choices import PROJECTIONS
from isogi_core.model.view import NO_TURN, View
from isogi_core.plan.scene import Scene
from isogi_core.plan.variants import at_both_signs
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_core.reference import (
    Reference,
    ReferenceGoal,
    grow_reference,
    load_reference,
    save_reference,
    with_bounces,
)
from isogi_core.storage.atomic_file import check_folder, check_writable, write_whole
from isogi_server.answers import coverage_schema, fit
from isogi_server.clocks import waiting
from isogi_server.parameters import FrameParams, ViewParams, read
from isogi_server.pictures import FORMAT_OF_SUFFIX, encode, format_for, smoothed
from isogi_server.progress import Progress, compiling, open_scene
from isogi_server.render.engine import RenderEngine, engine_for
from isogi_server.render.patience import Patience, time_limit
from isogi_server.settings import Settings
from isogi_server.views import (
    PLACING,
    goal_of,
    in_turned_light,
    isovalue_of,
    unturned,
    view_of,
    with_first_view,
)
from isogi_worker.errors import WorkersError
from isogi_worker.progress import TimeLeft

FRAME_SECONDS = 2.0
"""Seconds between two frames while light is baked."""

LOOKED_AT = 24
"""Pictures of a series, at most, whose surfaces are fitted by the camera."""

PACKED_PIXEL_BYTES = 1
NPY_PIXEL_BYTES = 36
"""Bytes of a pixel for which free space is checked, in a compressed picture and in an npy file."""

REFERENCE_BYTES = 1 << 30
"""Bytes of light that the renderer of a reference may hold."""


def render(
    target: Target,
    output: Path,
    knobs: Mapping[str, str],
    settings: Settings,
    seconds: float | None = None,
) -> dict[str, Any]:
    """Write the picture of a view with the parameters ``knobs``; return facts about its quality and
    cost.

    Ends when the picture is final, or after ``seconds`` of baking. Raises SceneError, VolumeError,
    LightError and ViewError before any work, and StoreError, WorkersError and OSError later.
    """
    started = time.monotonic()
    form = format_of(output)
    scene = open_scene(target, settings)
    # Check all input before the engine starts.
    knobs = with_first_view(scene, knobs)
    params = smoothed(read(FrameParams, [*knobs.items(), ("f", form)]), form)
    format_for(params, None)
    scene = in_turned_light(at_both_signs(scene, isovalue_of(scene, params)), params)
    view_of(scene, params, settings)
    pixel = NPY_PIXEL_BYTES if form == "npy" else PACKED_PIXEL_BYTES
    check_writable(output, pixel * params.width * params.height)

    # Bake and draw; by default the camera sees the whole surface.
    with working(scene, settings) as engine:
        drawn = draw(engine, scene, knobs, settings, form, seconds)
    write_whole(output, drawn.encoded(form))
    return {
        "file": str(output),
        "format": form,
        **drawn.facts,
        "seconds": time.monotonic() - started,
    }


class Drawn(NamedTuple):
    """A picture: its ``frame``, the ``params`` and the ``exposure`` that it is developed with, and
    ``facts`` of its quality.
    """

    frame: Frame
    params: FrameParams
    exposure: float
    facts: dict[str, Any]

    def encoded(self, form: str) -> bytes:
        """Return the bytes of the picture in a format of FORMATS."""
        return encode(self.frame, form, self.exposure, self.params)


def draw(
    engine: RenderEngine,
    scene: Scene,
    knobs: Mapping[str, str],
    settings: Settings,
    form: str = "png",
    seconds: float | None = None,
) -> Drawn:
    """Draw the view with the parameters ``knobs`` of the ``engine``'s ``scene``, for a picture of
    the format ``form``.

    The camera shows the whole surface if no knob places it. Ends when every pixel is final, or
    after ``seconds`` of baking. Raises ParameterError, ViewError, StoreError and WorkersError.
    """
    params = smoothed(read(FrameParams, [*knobs.items(), ("f", form)]), form)
    if not is_placed(knobs):
        [params] = seen_whole(engine.renderer(scene.id), [params], settings)
    view = view_of(scene, params, settings)
    goal = goal_of(scene, params.max_error)
    frame = draw_refined(engine, scene.id, view, goal, seconds)
    left = engine.time_left(scene.id, frame, goal)
    facts = {
        **frame_facts(frame, left),
        "target_error": goal.error,
        "final": frame.coverage["final"],
        "paths": engine.baker.paths,
        "stopped": stopped_by(frame),
        "note": why_empty(scene, view) if not frame.surface else "",
        "trouble": "" if frame.final else trouble_of(engine),
    }
    exposure = scene.default_exposure if params.exposure is None else params.exposure
    return Drawn(frame, params, exposure, facts)


def trouble_of(engine: RenderEngine) -> str:
    """Return the reason, for a person, why an ``engine`` bakes no more light; empty if there is
    none, or if its store is only read on purpose.

    Workers that are still starting when the time is over are no such reason.
    """
    if engine.store.read_only:
        return ""
    return engine.trouble() or engine.baker.paused()


def why_empty(scene: Scene, view: View) -> str:
    """Return a sentence that explains why a picture shows no surface, with advice."""
    spell = scene.volume.spell
    low, high = scene.volume.value_range
    if low == high:
        return f"No surface: all values are {shortest(low)}."
    if not low < view.isovalue < high:
        return (
            f"No surface at {spell(view.isovalue)}: values go from {shortest(low)} to "
            f"{shortest(high)}, choose an isovalue between them."
        )
    if view.window is not None or scene.source.document.get("cut"):
        return (
            f"No surface at {spell(view.isovalue)} in what the cut leaves: cut away less, or "
            "choose another isovalue."
        )
    return (
        f"No surface at {spell(view.isovalue)} in view: leave the camera out, or choose another "
        "isovalue."
    )


def stopped_by(frame: Frame) -> str:
    """Return the reason for the end of a frame's rendering.

    - "target": the frame is final.
    - "samples": a path-traced picture has taken all its samples.
    - "paths": all light is there, but the check has traced as many paths from the frame's pixels as
      it may, and the error is still above the target.
    - "time": the time was over before that, or nothing was left that could be baked or checked.
    """
    if frame.final:
        return "target"
    if frame.view.shading == "path_traced":
        return "samples"
    if frame.given_up and not frame.provisional:
        return "paths"
    return "time"


def rendered(facts: Mapping[str, Any]) -> str:
    """Return the facts of ``render`` as text for a person."""
    states = {
        "target": "final",
        "time": "provisional",
        "samples": "all samples taken",
        "paths": "provisional after all paths that its pixels may take",
    }
    quality = (
        f"error {facts['error']:.4f}, {facts['final']:.1%} of the surface at "
        f"{facts['target_error']:g}"
    )
    if facts["stopped"] in ("time", "paths") and facts["error"] <= facts["target_error"]:
        quality = f"{unsure(facts)}, {quality}"
    if facts["note"]:
        return f"{facts['file']}: {facts['width']} × {facts['height']}. {facts['note']}"
    return (
        f"{facts['file']}: {facts['width']} × {facts['height']}, "
        f"{states[facts['stopped']]}, {quality}"
    )


def unsure(facts: Mapping[str, Any]) -> str:
    """Return the reason, for a person, why a picture is provisional though its error is below
    the target.
    """
    if facts["interval"] is None:
        return "not measured yet"
    low, high = facts["interval"]
    if high > facts["target_error"]:
        return f"between {low:.4f} and {high:.4f}"
    if facts["p99"] and facts["p99"] > TAIL * facts["target_error"]:
        return f"1 % of pixels off by more than {facts['p99']:.4f}"
    return "not all of its light is there"


def frame_facts(frame: Frame, left: TimeLeft | None) -> dict[str, Any]:
    """Return size, quality and version of a frame, and the time until it would be final."""
    size = {"width": frame.view.width, "height": frame.view.height}
    return {**size, **coverage_schema(frame, left).model_dump(), "version": frame.version}


@contextmanager
def working(scene: Scene, settings: Settings, with_workers: bool = True) -> Iterator[RenderEngine]:
    """Start an engine for a ``scene``: kernels compiled, stores open and, if ``with_workers``,
    its workers starting. Close it at the end of the block.
    """
    with waiting("preparing the scene"):
        engine = engine_for(scene, settings, with_workers)
    with closing(engine):
        with compiling(lambda: engine.kernels.progress, "starting workers"):
            engine.start(with_workers=with_workers)
        yield engine


def format_of(output: Path) -> str:
    """Return the picture format of the file's suffix. Raises ViewError for other suffixes, or
    if the folder is missing.
    """
    if output.suffix.lower() not in FORMAT_OF_SUFFIX:
        raise ViewError(
            f"{output} names no picture format: end it in {', '.join(FORMAT_OF_SUFFIX)}."
        )
    check_folder(output)
    return FORMAT_OF_SUFFIX[output.suffix.lower()]


def is_placed(given: Iterable[str]) -> bool:
    """Return True if any of the ``given`` parameters places the camera."""
    return not PLACING.isdisjoint(given)


def seen_whole(
    renderer: Renderer, shots: Sequence[FrameParams], settings: Settings
) -> list[FrameParams]:
    """Return the ``shots`` with one target and one distance at which the whole surface is visible
    in all of them, from the directions that they give.

    At most LOOKED_AT shots, evenly spread, are fitted.
    """
    scene = renderer.prepared.scene
    turned = [from_front(scene, shot) for shot in shots]
    # Fitting each of many pictures would take long, and neighbours differ little.
    few = np.unique(np.linspace(0, len(turned) - 1, LOOKED_AT).round().astype(int))
    stands = [stand_of(scene, turned[n], settings) for n in few]
    target, distance = fit(renderer, stands, shots[0].projection)
    return [shot.model_copy(update={"target": target, "distance": distance}) for shot in turned]


def from_front(scene: Scene, shot: FrameParams) -> FrameParams:
    """Return the ``shot`` with the angles of the scene's front for those that it leaves out."""
    azimuth, elevation = scene.front
    front = {"azimuth": azimuth, "elevation": elevation}
    return shot.model_copy(
        update={name: angle for name, angle in front.items() if name not in shot.model_fields_set}
    )


def stand_of(scene: Scene, shot: FrameParams, settings: Settings) -> Stand:
    """Return the direction that the camera of a picture looks from."""
    # The camera does not depend on the light.
    update = {"projection": PROJECTIONS[0]}
    view = view_of(replace(scene, turn=NO_TURN), unturned(shot).model_copy(update=update), settings)
    return Stand(view, shot.azimuth, shot.elevation)


def draw_refined(
    engine: RenderEngine, scene: str, view: View, goal: Goal, seconds: float | None
) -> Frame:
    """Bake and draw as ``awaited`` does, with a bar that shows the time left and never runs
    back.
    """
    begun = time.monotonic()
    shown = 0.0
    with Progress("lighting", "") as bar:
        bar.show(0, 100)

        def show(frame: Frame) -> None:
            nonlocal shown
            left = engine.time_left(scene, frame, goal)
            # Progress is the share of time that has passed; it never decreases.
            passed = time.monotonic() - begun
            if frame.final:
                done = 1.0
            elif left and passed:
                done = passed / (passed + left.likely)
            else:
                done = 0.0
            shown = max(shown, done)
            bar.show(int(100 * shown), 100, left)

        return awaited(engine, scene, view, goal, seconds, show)


def awaited(
    engine: RenderEngine,
    scene: str,
    view: View,
    goal: Goal,
    seconds: float | None,
    show: Callable[[Frame], object] = lambda _: None,
) -> Frame:
    """Return the frame once it reaches its ``goal``, or the time is over; call ``show`` with each
    frame on the way.

    A path-traced frame is as good as its samples, and is returned at once. Raises WorkersError if
    the workers fail, or if nothing has changed for as long as ``Patience`` allows.
    """
    patience = Patience(clock=time.monotonic)
    if seconds is None:
        deadline = math.inf
    else:
        deadline = time.monotonic() + seconds
    # The first picture is drawn however long it takes; refinements end at the deadline.
    frame = None
    with time_limit(deadline) as over:
        while True:
            left = max(0.0, deadline - time.monotonic())
            try:
                frame = engine.frame(
                    scene,
                    view,
                    goal=goal,
                    wait=min(FRAME_SECONDS, left) if frame or math.isinf(deadline) else 0.0,
                    cancelled=over if frame else None,
                )
            except Cancelled:
                if frame is None:
                    raise
                # Steps since the last frame have made the picture better: draw it once more.
                return engine.survey(scene, view, goal)
            # The frame lacks light of texels, or its picture is to be checked.
            coming = frame.checkable or engine.lacking(scene, frame)[1].demands
            show(frame)
            if frame.final or time.monotonic() >= deadline or not coming:
                return frame
            if frame.checkable:
                continue
            if engine.trouble():
                raise WorkersError(engine.trouble())
            patience.check(frame.version, engine.workers.preparing, engine.unready())


def reference(
    target: str,
    output: Path,
    knobs: Mapping[str, str],
    settings: Settings,
    bounces: int | None,
    goal: Mapping[str, Any],
) -> dict[str, Any]:
    """Continue the path-traced reference of a view in the file ``output``, and return facts about
    its quality.

    The file is written after each round. ``goal`` are the fields of a ReferenceGoal. Raises
    SceneError, VolumeError, LightError and ViewError before any work, and ReportError and OSError
    later.
    """
    check_file(output)
    scene = open_scene(target, settings)
    params = read(ViewParams, knobs.items())
    scene = in_turned_light(scene, params)
    view = view_of(scene, params, settings)
    return grow_file(with_bounces(scene, bounces), view, output, ReferenceGoal(**goal))


def check_file(output: Path) -> None:
    """Raise ViewError if the file's suffix is not .npz, or its folder is missing."""
    if output.suffix != ".npz":
        raise ViewError(f"{output} is no name for a reference: end it in .npz.")
    check_folder(output)


def grow_file(scene: Scene, view: View, output: Path, goal: ReferenceGoal) -> dict[str, Any]:
    """Continue the reference in ``output`` until its goal, with a bar; return its facts."""

    if output.exists():
        former = load_reference(output, scene, view)
    else:
        former = None
    found = former
    # The reference needs no store of light: a temporary one serves its renderer.
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


def show_noise(bar: Any, found: Reference, goal: ReferenceGoal) -> None:
    """Show on the bar the noise of a reference, and the expected number of paths."""
    foreseen = goal.foresee(found)
    if foreseen is None:
        bar.total = None
    else:
        bar.total = bar.n + int(found.on.sum()) * (foreseen - found.samples)
    bar.set_postfix(samples=found.samples, noise=f"{found.noise:.2%}")


def reference_facts(found: Reference) -> dict[str, Any]:
    """Return size and quality of a reference, and the seconds of processor time that it took."""
    height, width = found.on.shape
    size = {"width": width, "height": height, "surface": int(found.on.sum())}
    return {**size, "samples": found.samples, "noise": found.noise, "seconds": found.seconds}


def grown(facts: Mapping[str, Any]) -> str:
    """Return the facts of ``reference`` as text for a person."""
    size = f"{facts['width']} × {facts['height']}, {facts['samples']} paths per pixel"
    return (
        f"{facts['file']}: {size}, noise {facts['noise']:.5f}, {facts['seconds']:.1f} "
        "seconds of the processor"
    )
