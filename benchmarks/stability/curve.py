"""The curve of the ramps: the error of their light over the width of the ramp, as a picture and as a table."""

from pathlib import Path

from matplotlib.figure import Figure

from benchmarks.stability.case import Case, Outcome
from benchmarks.stability.page import row
from benchmarks.stability.ramps import GROUP, OWN_PLACES

LABELS = ("as texels are lit", "with texels in their own places")

NOTES = """\
## Ramps, as a curve

The relative RMSE of a body's light against the path tracer, as its surface's ramp grows thinner. Texels at the edge \
of a plateau are lit half-way down it; were they lit in their own places, on their own isosurfaces, which no view \
shows, it would be the upper curve.

![The error over the width of the ramp](stability/ramps.svg)
"""


def ramp_notes(results: list[tuple[Case, Outcome]], folder: Path) -> str:
    """The section of the page, as Markdown; draws its picture, ramps.svg, into the ``folder``."""
    ramps = [
        (case.name, outcome.worst, outcome.figures[OWN_PLACES]) for case, outcome in results if case.group == GROUP
    ]
    folder.mkdir(parents=True, exist_ok=True)
    draw(ramps, folder / "ramps.svg")
    cells = [("ramp", *LABELS), ("---",) * 3, *((name, f"{a:.2%}", f"{b:.2%}") for name, a, b in ramps)]
    return "\n".join([NOTES, *map(row, cells)])


def draw(ramps: list[tuple[str, float, float]], path: Path) -> None:
    """Draw the two errors of each of the named ``ramps``."""
    figure = Figure(figsize=(6.4, 3.6), layout="constrained")
    axes = figure.subplots()
    names, now, own = zip(*ramps, strict=True)
    for errors, label, style in zip((now, own), LABELS, ("o-", "s--"), strict=True):
        axes.plot(names, [100 * error for error in errors], style, label=label)
    axes.set_xlabel("width of the ramp")
    axes.set_ylabel("relative RMSE, %")
    axes.set_ylim(bottom=0.0)
    axes.legend(frameon=False)
    figure.savefig(path, metadata={"Date": None})
