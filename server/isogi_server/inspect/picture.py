"""The picture of an inspection, drawn with matplotlib, an optional dependency that only this
module imports.
"""

import re
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from isogi_server.inspect.inspection import InspectionSchema, SurfaceSchema

FIGURE_INCHES = (7.2, 5.2)
"""Width and height of the figure, in inches."""

DPI = 150

MAX_SHARE_SHOWN = 1.2
"""Upper end of the axis of shares: above 1 there is room for the legend."""

INK = "#010101"
SOFT_STAND_IN = "#020202"
LINE_STAND_IN = "#030303"
"""Colours that stand for names of the colour scheme while matplotlib draws."""

DASHES: tuple[tuple[float, ...], ...] = ((), (5, 2), (1.5, 1.5), (7, 2, 1.5, 2), (3, 3), (9, 3))
"""Dashes of the curves, in points, so that they can be told apart without colours."""


STYLE: Any = {
    "svg.fonttype": "none",
    "font.size": 9.5,
    "axes.linewidth": 0.8,
    "text.color": INK,
    "axes.edgecolor": SOFT_STAND_IN,
    "axes.labelcolor": INK,
    "xtick.color": SOFT_STAND_IN,
    "ytick.color": SOFT_STAND_IN,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
}

SCHEME = (Path(__file__).parent / "scheme.css").read_text(encoding="utf-8")
"""The style sheet with the colours of the scheme."""

SCHEME_COLOURS = dict(reversed(re.findall(r"--([\w-]+): (#\w{6})", SCHEME)))
"""Colours of the light scheme, by name: the first definition of each name."""

INKS = {
    INK: SCHEME_COLOURS["ink"],
    SOFT_STAND_IN: SCHEME_COLOURS["soft"],
    LINE_STAND_IN: SCHEME_COLOURS["line"],
}

SHARE_CURVES = ("steep", "plateau", "noisy", "holes")
"""Shares that are drawn; the last one only if any surface has holes."""


def save_picture(path: Path, facts: InspectionSchema) -> None:
    """Draw the stiffness of a scene's volume to a PNG file. Raises OSError."""
    style: Any = {name: INKS.get(value, value) for name, value in STYLE.items()}
    with mpl.rc_context(style):
        figure = Figure(
            figsize=FIGURE_INCHES, dpi=DPI, layout="constrained", facecolor=SCHEME_COLOURS["paper"]
        )
        upper, lower = figure.subplots(2, sharex=True, height_ratios=(5, 3))
        figure.suptitle(f"How stiff is {facts.volume.name}?", x=0.01, ha="left", fontsize=12)
        draw_histogram(upper.twinx(), facts)
        draw_shares(upper, facts)
        draw_error(lower, facts)
        for axes in (upper, lower):
            frame(axes, facts)
        upper.set_title(key_of(facts), fontsize=9.5, loc="left", color=SCHEME_COLOURS["soft"])
        lower.set_xlabel("isovalue")
        figure.savefig(path, format="png", metadata={"Software": None})


def key_of(facts: InspectionSchema) -> str:
    """Return the legend of the picture's marks."""
    return (
        "Share of the surface's cells, by isovalue; grey: voxels (logarithmic); line: the "
        f"scene's {facts.stiffness.surfaces[facts.stiffness.own].spelled}"
    )


def own_of(facts: InspectionSchema) -> float:
    """Return the scene's isovalue."""
    return facts.stiffness.surfaces[facts.stiffness.own].isovalue


def draw_histogram(axes: Axes, facts: InspectionSchema) -> None:
    """Draw the histogram of the volume, with logarithmic counts, behind all else."""
    counts = np.log1p(facts.histogram.counts)
    edges = np.array(facts.histogram.edges)
    axes.fill_between(
        edges, np.append(counts, counts[-1]), step="post", color=SCHEME_COLOURS["line"], linewidth=0
    )
    axes.set_ylim(0.0, MAX_SHARE_SHOWN * max(counts.max(), 1.0))
    axes.set_axis_off()
    axes.set_zorder(-1)


def draw_shares(axes: Axes, facts: InspectionSchema) -> None:
    """Draw the shares of each surface that are steep, on a plateau, noisy, next to holes."""
    surfaces = facts.stiffness.surfaces
    shown = SHARE_CURVES if any(surface.holes for surface in surfaces) else SHARE_CURVES[:-1]
    for i, name in enumerate(shown):
        style: Any = (0, DASHES[i]) if DASHES[i] else "solid"
        shares = [getattr(surface, name) if surface.cells else np.nan for surface in surfaces]
        axes.plot(isovalues(surfaces), shares, label=name, linestyle=style, **mark_of(i))
    axes.set_ylim(0.0, MAX_SHARE_SHOWN)
    axes.set_yticks(np.linspace(0.0, 1.0, 6))
    axes.legend(frameon=False, ncols=len(shown), loc="upper right")


def draw_error(axes: Axes, facts: InspectionSchema) -> None:
    """Draw the expected error, and its range."""
    seen = [surface for surface in facts.stiffness.surfaces if surface.error is not None]
    errors = [
        (each.error.low, each.error.likely, each.error.high)
        for each in seen
        if each.error is not None
    ]
    low, likely, high = np.array(errors or np.empty((0, 3))).T
    axes.fill_between(isovalues(seen), low, high, color=SCHEME_COLOURS["line"], linewidth=0)
    axes.plot(isovalues(seen), likely, **mark_of(4))
    axes.set_ylim(0.0)
    axes.set_title(
        "Error of interpolated light that is to be expected, and its range",
        fontsize=9.5,
        loc="left",
    )


def isovalues(surfaces: list[SurfaceSchema]) -> list[float]:
    """Return the abscissae of surfaces in the picture."""
    return [surface.isovalue for surface in surfaces]


def mark_of(i: int) -> dict[str, Any]:
    """Return the line style of curve ``i``."""
    return {
        "color": SCHEME_COLOURS[f"curve-{i + 1}"],
        "linewidth": 1.5,
        "marker": "o",
        "markersize": 3.2,
    }


def frame(axes: Axes, facts: InspectionSchema) -> None:
    """Draw grid, ticks, and a line at the scene's isovalue."""
    axes.axvline(
        own_of(facts), ymax=1.0 / MAX_SHARE_SHOWN, color=SCHEME_COLOURS["accent"], linewidth=1.0
    )
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    axes.grid(color=SCHEME_COLOURS["line"], linewidth=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.patch.set_visible(False)
