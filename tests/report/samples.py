"""Sections with one of everything, as a study might have measured them."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from isogi_core.plan.assembly import load_scene
from isogi_report.journal import Entry, Report
from isogi_report.sections import Column, Curve, Picture, Plot, Section, Table
from isogi_report.speed import view_of

SHARE = Column("relative RMSE", "share")
SECONDS = Column("processor seconds", "seconds")


def disc(size: int = 24) -> np.ndarray:
    """Where a round surface is, (size, size) bool."""
    y, x = np.mgrid[:size, :size] + 0.5
    mask: np.ndarray = np.hypot(x - size / 2, y - size / 2) < 0.4 * size
    return mask


def report_of(
    scene: Path, entries: Sequence[Entry], notes: Sequence[str] = (), exposure: float = 1.0
) -> Report:
    """A report of a scene's file, as if its surface were the disc."""
    loaded = load_scene(scene)
    return Report(loaded, view_of(loaded, 24), exposure, disc(), tuple(entries), tuple(notes))


def errors(most: float) -> np.ndarray:
    """Signed errors from ``-most`` on the left of a disc to ``most`` on its right, NaN beside
    it.
    """
    on = disc()
    ramp = np.broadcast_to(np.linspace(-most, most, on.shape[1]), on.shape)
    return np.where(on, ramp, np.nan).astype(np.float32)


def sections() -> tuple[Section, ...]:
    """A section with everything in it, and one with words alone."""
    rows = (("total", 0.0971, 12.3), ("noise", None, 1))
    table = Table("Parts <of> the error", (Column("part"), SHARE, SECONDS), rows)
    times = (0.1, 1.0, 10.0)
    curves = (
        Curve("harmonics", times, (0.2, 0.1, 0.09)),
        Curve("paths", times, (0.5, math.nan, 0.05)),
    )
    plots = (
        Plot("Error & time", SECONDS, SHARE, curves),
        Plot("Light", SECONDS, Column("light", "bytes"), curves[:1]),
    )
    radiance = (disc()[..., None] * [0.5, 0.25, 0.125]).astype(np.float32)
    pictures = (
        Picture("the frame", "radiance", radiance),
        Picture("its error", "error", errors(0.03)),
        Picture("one part", "error", errors(0.02)),
        Picture("a small part", "error", errors(0.002)),
    )
    full = Section(
        "split", "The error, by cause", "What was done.\n\nWhat is seen.", (table,), plots, pictures
    )
    return full, Section("none", "Nothing to see", "This scene has no harmonics.")
