"""The plan's frame beside its reference, paths from each pixel (S1, figure 11)."""

from isogi_core.report import scores
from isogi_core.report.bench import Bench
from isogi_core.report.metrics import error_map
from isogi_core.report.sections import Column, Picture, Section, Table

KEY, TITLE = "tracing", "The frame and path tracing"

ABOUT = """\
The frame that the scene's plan makes, each texel baked to the target error, and the reference: paths from each pixel \
to the lights themselves. The frame's own estimate is of Monte Carlo noise alone: it knows nothing of interpolation, \
of harmonics or bounces that are cut off. Seconds are of the processor, all threads together."""

COLUMNS = (
    Column("picture"),
    *scores.COLUMNS,
    Column("its own estimate", "share"),
    Column("samples", "count"),
    Column("time", "seconds"),
)


def study(bench: Bench) -> Section:
    """Both pictures, where they differ, and by how much."""
    planned, best = bench.planned, bench.best
    frame = planned.frame()
    own = (*scores.cells(bench.score(frame.radiance)), frame.estimated_error, planned.samples, planned.seconds)
    other = (None, None, None, None, best.noise, best.samples, best.seconds)
    table = Table("The frame against its reference", COLUMNS, (("the plan's frame", *own), ("the reference", *other)))
    pictures = (
        Picture("the plan's frame", "radiance", frame.radiance),
        Picture(f"the reference, {best.samples} paths per pixel", "radiance", best.mean),
        Picture("the frame's error", "error", error_map(frame.radiance, best)),
    )
    return Section(KEY, TITLE, ABOUT, (table,), (), pictures)
