"""``isogi inspect`` as text, for a person."""

import math
import textwrap
from collections.abc import Iterator

from isogi_core.model.scene import Scene
from server.inspect.facts import InspectionFacts, Remark, StiffnessFacts, SurfaceFacts
from server.inspect.rows import omission, plan_rows, summary
from server.inspect.shares import percent, span

BINS = 24
BAR = 48
WIDTH, LEAD = 100, 14
ROWS = 10
"""Isovalues in the table, besides the scene's own and the stiffest."""

HEAD = f"  {'isovalue':>11} {'cells':>13} {'steep':>6} {'plateau':>8} {'noisy':>6} {'holes':>6}   error about"


def report(scene: Scene, facts: InspectionFacts) -> str:
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


def stiffness(facts: InspectionFacts) -> Iterator[str]:
    """How stiff the volume is: a row for some of the isovalues, and what that means for the scene's own."""
    found = facts.stiffness
    yield "stiffness (shares of the cells that a surface passes; > is the scene's isovalue)"
    yield HEAD
    yield from (row(found.surfaces[place], place == found.own) for place in shown_places(found))
    yield from (line for remark in found.remarks for line in told(remark))


def told(remark: Remark) -> Iterator[str]:
    """A remark: what it means, what isogi does, and what a person can do, each on lines of its own."""
    yield from wrapped(f"  {remark.about:<{LEAD - 2}}", remark.means)
    if remark.does:
        yield from wrapped(f"{'isogi':>{LEAD - 1}} ", remark.does)
    for can in remark.can:
        yield from wrapped(f"{'you can':>{LEAD - 1}} ", can)


def wrapped(lead: str, text: str) -> list[str]:
    """Lines of at most WIDTH, the first after its ``lead`` and the others under the text."""
    return textwrap.wrap(text, WIDTH, initial_indent=lead, subsequent_indent=" " * len(lead))


def shown_places(found: StiffnessFacts) -> list[int]:
    """Places of ROWS surfaces, evenly taken, of the scene's own, and of the one that is expected to err most."""
    step = (len(found.surfaces) - 1) / (ROWS - 1)
    errors = [0.0 if surface.error is None else surface.error.likely for surface in found.surfaces]
    return sorted({*(round(step * i) for i in range(ROWS)), found.own, errors.index(max(errors))})


def row(surface: SurfaceFacts, own: bool) -> str:
    """A row of the table."""
    name = f"{'>' if own else ' '} {surface.isovalue:>11.6g} {surface.cells:>13,}"
    if surface.error is None:
        return f"{name}   nothing is seen"
    columns = ((surface.steep, 6), (surface.plateau, 8), (surface.noisy, 6), (surface.holes, 6))
    shares = " ".join(f"{percent(share):>{width}}" for share, width in columns)
    return f"{name} {shares}   {span(surface.error)}"
