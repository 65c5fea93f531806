"""``isogi reference``: path-trace one view from every pixel, for comparison with whatever else shows it."""

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from isogi_core.errors import ViewError
from isogi_core.model.scene import Scene
from isogi_core.model.view import View
from server.opening import open_scene
from server.params import ViewParams, read
from server.settings import Settings
from server.views import view_of

if TYPE_CHECKING:
    from isogi_core.report.growth import Goal
    from isogi_core.report.reference import Reference


def reference(
    target: str,
    output: Path,
    knobs: Mapping[str, str],
    settings: Settings,
    bounces: int | None,
    goal: Mapping[str, Any],
) -> dict[str, Any]:
    """Grow the reference of a view, named by ``knobs``, in the file ``output``, and tell how good it is.

    It is written after each round, and gone on from where it is there already. ``goal`` are a Goal's. Raises
    SceneError, VolumeError, LightError and ViewError before anything is begun, ReportError and OSError later.
    """
    check_file(output)
    scene = open_scene(target, settings)
    view = view_of(scene, read(ViewParams, knobs.items()), settings)
    from isogi_core.report.growth import Goal  # noqa: PLC0415 (kernels: bad input is told before they are compiled)
    from isogi_core.report.reference import with_bounces  # noqa: PLC0415

    return grow_file(with_bounces(scene, bounces), view, output, Goal(**goal))


def check_file(output: Path) -> None:
    """ViewError where the file's name is of another kind, or its folder missing."""
    if output.suffix != ".npz":
        raise ViewError(f"{output} is no name for a reference: end it in .npz.")
    if not output.parent.is_dir():
        raise ViewError(f"There is no folder {output.parent} for {output.name}: make it first.")


def grow_file(scene: Scene, view: View, output: Path, goal: "Goal") -> dict[str, Any]:
    """Grow the reference in ``output`` to its goal, with a bar, and tell its facts."""
    from isogi_core.report.growth import grow  # noqa: PLC0415
    from isogi_core.report.reference import load_reference, save_reference  # noqa: PLC0415
    from server.measure import make_renderer  # noqa: PLC0415

    former = load_reference(output, scene, view) if output.exists() else None
    found = former
    with tempfile.TemporaryDirectory(prefix="isogi-reference-") as store, tqdm(unit="path", unit_scale=True) as bar:
        for found in grow(make_renderer(scene, store), view, goal, former, progress=bar.update):
            save_reference(output, found, scene, view)
            show(bar, found, goal)
    assert found is not None, "one round is made in any case"
    return {"file": str(output), "scene": scene.name, "bounces": scene.bounces, **facts(found)}


def show(bar: Any, found: "Reference", goal: "Goal") -> None:
    """Put on the bar how good a reference is, and how many paths are still to come."""
    foreseen = goal.foresee(found)
    bar.total = None if foreseen is None else bar.n + int(found.on.sum()) * (foreseen - found.samples)
    bar.set_postfix(samples=found.samples, noise=f"{found.noise:.2%}")


def facts(found: "Reference") -> dict[str, Any]:
    """Size and quality of a reference, and the processor's seconds that it took."""
    height, width = found.on.shape
    size = {"width": width, "height": height, "surface": int(found.on.sum())}
    return {**size, "samples": found.samples, "noise": found.noise, "seconds": found.seconds}
