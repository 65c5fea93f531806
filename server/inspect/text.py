"""``isogi inspect`` as text, for a person."""

import importlib.util
import math
from collections.abc import Iterator
from pathlib import Path

from isogi_core.plan.scene import Scene
from server.errors import LibraryError, ParameterError
from server.inspect.brief import brief
from server.inspect.inspection import (
    InspectionSchema,
    Remark,
    StiffnessSchema,
    SurfaceSchema,
    inspection_schema,
    percent,
    span,
)
from server.inspect.rows import LEAD, omission, plan_rows, summary, wrapped
from server.progress import open_scene

BINS = 24
BAR = 48
ROWS = 10
"""Isovalues in the table, besides the scene's own and the stiffest."""

MORE_TO_ASK = "--plan shows the plan, the histogram, every remark, and more isovalues; prewarm --dry-run, the time."

HEAD = f"  {'isovalue':>11} {'cells':>13} {'steep':>6} {'plateau':>8} {'noisy':>6} {'holes':>6}   error about"


def report(scene: Scene, facts: InspectionSchema) -> str:
    """Facts, plan, what it leaves out, histogram of a scene, and how stiff its volume is."""
    rows = [f"{name:<14}{text}" for name, text in (*summary(facts), *plan_rows(facts.plan))]
    omissions = ["left out", *(line for each in facts.plan.left_out for line in omission(each))]
    bars = ["histogram (bars are logarithmic)", *histogram(scene)]
    return "\n".join([*rows, *omissions, *bars, *stiffness(facts)])


def histogram(scene: Scene) -> Iterator[str]:
    """One line per bin: its lower edge, a bar, its count."""
    counts, edges = scene.volume.histogram(BINS)
    longest = math.log1p(counts.max())
    for count, edge in zip(counts, edges, strict=False):
        yield f"{edge:>12.5g} {'█' * round(BAR * math.log1p(count) / longest):<{BAR}} {count}"


def stiffness(facts: InspectionSchema) -> Iterator[str]:
    """How stiff the volume is: a row for some of the isovalues, and what that means for the scene's own."""
    found = facts.stiffness
    yield "stiffness (shares of the cells that a surface passes; > is the scene's isovalue)"
    yield HEAD
    yield from (row(found.surfaces[place], place == found.own) for place in shown_places(found))
    yield from (line for remark in found.remarks for line in lines_of(remark))


def lines_of(remark: Remark) -> Iterator[str]:
    """A remark: what it means, what isogi does, and what a person can do, each on lines of its own."""
    yield from wrapped(f"  {remark.about:<{LEAD - 2}}", remark.means)
    if remark.does:
        yield from wrapped(f"{'isogi':>{LEAD - 1}} ", remark.does)
    for can in remark.can:
        yield from wrapped(f"{'you can':>{LEAD - 1}} ", can)


def shown_places(found: StiffnessSchema) -> list[int]:
    """Places of ROWS surfaces, evenly taken, of the scene's own, and of the one that is expected to err most."""
    step = (len(found.surfaces) - 1) / (ROWS - 1)
    errors = [0.0 if surface.error is None else surface.error.likely for surface in found.surfaces]
    return sorted({*(round(step * i) for i in range(ROWS)), found.own, errors.index(max(errors))})


def row(surface: SurfaceSchema, own: bool) -> str:
    """A row of the table."""
    name = f"{'>' if own else ' '} {surface.isovalue:>11.6g} {surface.cells:>13,}"
    if surface.error is None:
        return f"{name}   nothing is seen"
    columns = ((surface.steep, 6), (surface.plateau, 8), (surface.noisy, 6), (surface.holes, 6))
    shares = " ".join(f"{percent(share):>{width}}" for share, width in columns)
    return f"{name} {shares}   {span(surface.error)}"


def inspect(target: str, picture: Path | None = None, as_json: bool = False, plan: bool = False) -> str:
    """The inspection of ``target``, a volume or a scene; draws the ``picture`` where one is asked for.

    It is in brief, unless the ``plan`` and all facts are asked for, or their document ``as_json``. Raises SceneError,
    VolumeError, LightError, and ParameterError or LibraryError where no picture can be drawn.
    """
    if picture is not None:
        check_picture(picture)
    scene = open_scene(target)
    facts = inspection_schema(scene)
    if picture is not None:
        from server.inspect.picture import save_picture  # noqa: PLC0415 (matplotlib is an extra)

        save_picture(picture, facts)
    if as_json:
        return facts.model_dump_json(indent=2)
    return report(scene, facts) if plan else f"{brief(scene, facts)}\n{MORE_TO_ASK}"


def check_picture(path: Path) -> None:
    """LibraryError where matplotlib is missing, ParameterError where ``path`` is no place for a PNG file."""
    if importlib.util.find_spec("matplotlib") is None:
        raise LibraryError("A picture of the stiffness is drawn with matplotlib: pip install 'isogi[report]'.")
    if path.suffix.lower() != ".png" or not path.parent.is_dir():
        raise ParameterError(
            f"{path} is no place for a picture: give a name that ends in .png, in a folder that is there."
        )
