"""The head of a report: the subject, the machine, and versions of software."""

import math
import os
import platform
from collections.abc import Iterable, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from isogi_core.files.spelling import shortest
from isogi_core.model.view import Camera, View
from isogi_core.plan.scene import Scene
from isogi_server.answers import scene_schema
from isogi_server.inspect.text import amount, by, plan_rows, summary
from isogi_server.schemas import SceneSchema

PARALLEL_VIEW_DEGREES = 1e-3
"""Field of view, in degrees, below which rays count as parallel:
orthographic cameras are narrower.
"""

REPORTED_PACKAGES = ("isogi", "numpy", "numba", "zarr", "matplotlib", "flip-evaluator")

Rows = tuple[tuple[str, str], ...]


OMITTED_SETTINGS = {"histogram", "ranges", "presets", "stops", "stops_note", "shadings", "defaults"}
"""Parts of a scene's document that serve to choose a view,
and that a report of one view leaves out.
"""


def heading(scene: Scene, view: View) -> dict[str, Any]:
    """Return the head as a document."""
    return {
        "title": f"{scene.name} at {scene.volume.spell(view.isovalue)}",
        "scene": scene_schema(scene).model_dump(mode="json", exclude=OMITTED_SETTINGS),
        "view": view_facts(view),
        "machine": machine(),
        "versions": versions(),
    }


def view_facts(view: View) -> dict[str, Any]:
    """Return the facts of the measured view."""
    camera = view.camera.in_world(view.orientation)
    return {
        "isovalue": view.isovalue,
        "width": view.width,
        "height": view.height,
        "eye": list(camera.eye),
        "target": list(camera.target),
        "up": list(camera.up),
        "fov": camera.fov,
        "light": list(view.light),
    }


def machine() -> dict[str, Any]:
    """Return the processor, the number of its cores, and the system."""
    return {
        "processor": processor(),
        "cores": os.cpu_count() or 1,
        "system": f"{platform.system()} {platform.machine()}",
    }


def processor(listing: Path = Path("/proc/cpuinfo")) -> str:
    """Return the processor's name, from the system's ``listing`` if there is one."""
    # Linux lists the name in this file; other systems have other ways.
    try:
        lines = listing.read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or "unknown")


def versions() -> dict[str, str | None]:
    """Return the versions of Python and of packages
    that measure and draw; None for a missing one.
    """
    return {
        "python": platform.python_version(),
        **{name: installed(name) for name in REPORTED_PACKAGES},
    }


def installed(name: str) -> str | None:
    """Return the version of a package; None if it is missing."""
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def scene_rows(scene: Scene, view: View) -> Rows:
    """Return name and text of each fact of the scene and its view, for a person."""
    facts = scene_schema(scene)
    return (
        *inspected_facts(facts, "scene", "volume", "solid", "albedo", "lights", "target error"),
        *view_rows(view),
    )


def inspected_facts(facts: SceneSchema, *names: str) -> Rows:
    """Return some of the facts that ``isogi inspect`` prints, by their names."""
    rows = dict(summary(facts))
    return tuple((name, rows[name]) for name in names)


def view_rows(view: View) -> Rows:
    """Return name and text of each fact of a view."""
    return (
        ("isovalue", f"{shortest(view.isovalue)}"),
        (
            "picture",
            (
                f"{by((view.width, view.height))} pixels, "
                f"{standpoint(view.camera.in_world(view.orientation))}"
            ),
        ),
    )


def standpoint(camera: Camera) -> str:
    """Return a text with the position and field of view of a camera in world coordinates,
    or the direction and height of an orthographic one.
    """
    if camera.fov > PARALLEL_VIEW_DEGREES:
        return f"from {listed(camera.eye)}, {camera.fov:g} degrees high"
    # A camera with parallel rays is a distant one with a narrow field of view: give the height of
    # its picture at the target.
    height = 2.0 * math.dist(camera.eye, camera.target) * math.tan(math.radians(camera.fov / 2.0))
    return (
        f"orthographic, along {listed(camera.basis()[2])} to {listed(camera.target)}, "
        f"{height:.4g} high there"
    )


def listed(numbers: Iterable[float]) -> str:
    """Return numbers as text, with four digits."""
    return ", ".join(f"{number:.4g}" for number in numbers)


def plan_facts_rows(scene: Scene) -> Rows:
    """Return name and text of each fact of the scene's plan, for a person."""
    return tuple(plan_rows(scene_schema(scene).plan))


def left_out_rows(scene: Scene) -> tuple[tuple[str, str, str], ...]:
    """Return everything that the plan leaves out, with the reason and the saving."""
    omissions = scene_schema(scene).plan.left_out
    return tuple((each.what, each.why, ", ".join(map(amount, each.saves))) for each in omissions)


def machine_rows(head: Mapping[str, Any]) -> Rows:
    """Return name and text of machine and versions, for a person."""
    box = head["machine"]
    known = head["versions"]
    texts = ", ".join(f"{name} {text}" for name, text in known.items() if text is not None)
    missing = [name for name, text in known.items() if text is None]
    rows = (
        ("machine", f"{box['processor']}, {box['cores']} cores, {box['system']}"),
        ("versions", texts),
    )
    if missing:
        return (*rows, ("missing", ", ".join(missing)))
    return rows
