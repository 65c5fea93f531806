"""Plots as SVG, and pictures as PNG.

Text of plots stays text. Colours are CSS variables, to which the page, or the file itself, gives
values for light and dark.
"""

import io
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from xml.sax.saxutils import escape

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator
from PIL import Image

from isogi_core.frame.film import BACKGROUND, tone_table
from isogi_report.journal import Report
from isogi_report.metrics import shown_as
from isogi_report.sections import PREFIXES, Column, Curve, Picture, Plot
from isogi_server.inspect.picture import DASHES, INK, LINE_STAND_IN, SCHEME, SOFT_STAND_IN, STYLE

PLOT_WIDTH = 4.6
PLOT_HEIGHT = 3.1
"""Size of a plot in inches; SVG has 72 units an inch."""

TICK_STEPS = ((100.0, (1.0,)), (10.0, (1.0, 2.0, 5.0)), (1.0, (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)))
"""First digits of the ticks of a logarithmic axis, by the least ratio of the axis' ends."""

LEGEND_ROW_HEIGHT = 14.0
"""Height of a line of the legend, in units of SVG."""

CURVE_COLOURS = ("#040404", "#050505", "#060606", "#070707", "#080808", "#090909")
"""Stand-ins for CSS variables while matplotlib draws: see PAGE_COLOURS."""

PAGE_COLOURS = {
    INK: "var(--ink)",
    SOFT_STAND_IN: "var(--soft)",
    LINE_STAND_IN: "var(--line)",
    **{colour: f"var(--curve-{i + 1})" for i, colour in enumerate(CURVE_COLOURS)},
}
"""CSS variables by the colours that stand in for them."""


@dataclass(frozen=True)
class Key:
    """One entry of a plot's legend: name, colour and dashes of a curve, as SVG has them."""

    name: str
    colour: str
    dashes: str


def keys(plot: Plot) -> tuple[Key, ...]:
    """Return the legend of a plot: the curves that it shows."""
    return tuple(
        Key(curve.name, PAGE_COLOURS[colour_of(i)], " ".join(map(str, dashes_of(i))) or "none")
        for i, curve in enumerate(plot.curves)
        if drawable(curve)[0]
    )


def colour_of(i: int) -> str:
    """Return the stand-in for the colour of curve ``i``."""
    return CURVE_COLOURS[i % len(CURVE_COLOURS)]


def dashes_of(i: int) -> tuple[float, ...]:
    """Return the dashes of curve ``i``."""
    return DASHES[i % len(DASHES)]


@lru_cache(64)
def draw(plot: Plot) -> str:
    """Return the plot as an ``svg`` element for a page that sets the CSS variables.

    Equal plots give equal bytes.
    """
    # A fixed salt and no date make the bytes of equal plots equal.
    with mpl.rc_context({**STYLE, "svg.hashsalt": plot.caption}):
        figure = Figure(figsize=(PLOT_WIDTH, PLOT_HEIGHT), layout="constrained")
        fill(figure.add_subplot(), plot)
        file = io.BytesIO()
        figure.savefig(file, format="svg", metadata={"Date": None})
    return inline_svg(file.getvalue().decode())


def standalone(plot: Plot) -> str:
    """Return the plot as a file with its own colours,
    light and dark, and its legend below the axes.
    """
    entries = keys(plot)
    if len(entries) == 1:
        entries = ()
    width, height = 72 * PLOT_WIDTH, 72 * PLOT_HEIGHT
    size = f'viewBox="0 0 {width:g} {height:g}"'
    below = "".join(
        legend_line(key, height + LEGEND_ROW_HEIGHT * (i + 0.5)) for i, key in enumerate(entries)
    )
    # Make the drawing higher by the lines of the legend.
    svg = draw(plot).replace(
        size, f'viewBox="0 0 {width:g} {height + LEGEND_ROW_HEIGHT * len(entries):g}"', 1
    )
    head, _, rest = svg.removesuffix("</svg>").partition(">")
    style = f"<style>{SCHEME}svg {{ background: var(--paper); }}</style>"
    return f'<?xml version="1.0" encoding="utf-8"?>\n{head}>{style}{rest}{below}</svg>\n'


def legend_line(key: Key, y: float) -> str:
    """Return an entry of a legend at height ``y``, as SVG."""
    line = (
        f'<path d="M8 {y:g}h28" style="fill: none; stroke: {key.colour}; stroke-dasharray: '
        f'{key.dashes}"/>'
    )
    text = (
        f'<text x="44" y="{y + 3:g}" style="font: 9.5px var(--text); fill: '
        f'var(--ink)">{escape(key.name)}</text>'
    )
    return f"{line}{text}"


def inline_svg(svg: str) -> str:
    """Return matplotlib's file as an element of a page:
    with CSS variables for colours and fonts, and without ids, metadata and styles.
    """
    # Remove the XML head, metadata, styles and comments; then ids, which must be unique in a page.
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", "", svg, flags=re.DOTALL)
    svg = re.sub(r'(<g) id="[^"]*"', r"\1", svg)
    # Fonts and colours are the page's, and so is the size.
    svg = re.sub(r"font-family: [^;\"]*", "font-family: var(--text)", svg)
    svg = re.sub(r'(<svg [^>]*?) width="[^"]*" height="[^"]*"', r"\1", svg)
    for colour, name in PAGE_COLOURS.items():
        svg = svg.replace(colour, name)
    return svg.strip()


def fill(axes: Axes, plot: Plot) -> None:
    """Draw the curves of a ``plot`` on ``axes``, and make these logarithmic, with units at their
    ticks. Backgrounds of axes and figure become transparent, so that the page shows behind.
    """
    for i, curve in enumerate(plot.curves):
        x, y = drawable(curve)
        # matplotlib takes dashes with the length, 0, by which they are shifted along the line.
        style = (0, dashes_of(i)) if dashes_of(i) else "solid"
        axes.plot(
            x, y, color=colour_of(i), linestyle=style, linewidth=1.5, marker="o", markersize=3.2
        )
    # Errors and times span powers of ten.
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(color=LINE_STAND_IN, linewidth=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.patch.set_visible(False)
    axes.figure.patch.set_visible(False)
    axes.set_xlabel(plot.x.name)
    axes.set_ylabel(plot.y.name)
    for axis, column in ((axes.xaxis, plot.x), (axes.yaxis, plot.y)):
        mark_ticks(axis, column)


def drawable(curve: Curve) -> tuple[list[float], list[float]]:
    """Return the points of a curve that logarithmic axes can show."""
    points = [
        (x, y)
        for x, y in zip(curve.x, curve.y, strict=True)
        if 0.0 < x < math.inf and 0.0 < y < math.inf
    ]
    return [x for x, _ in points], [y for _, y in points]


def mark_ticks(axis: Axis, column: Column) -> None:
    """Set ticks whose labels include the unit."""
    axis.set_major_formatter(FuncFormatter(lambda value, _: tick(value, column.unit)))
    low, high = axis.get_view_interval()
    # The shorter the axis in decades, the more ticks in each.
    axis.set_major_locator(
        LogLocator(10, next(firsts for times, firsts in TICK_STEPS if high >= times * low))
    )
    axis.set_minor_locator(NullLocator())
    axis.set_minor_formatter(NullFormatter())


def tick(value: float, unit: str) -> str:
    """Return a tick's label."""
    if unit == "share":
        return f"{100 * value:.6g} %"
    if unit in PREFIXES:
        step = next(
            (step for step in reversed(PREFIXES[unit]) if abs(value) >= step[1]), PREFIXES[unit][0]
        )
        return f"{value / step[1]:.3g} {step[0]}"
    return f"{value:,.6g}"


ERROR_COLOURS = "RdBu_r"
"""matplotlib's colour map of errors: blue is too dark, white right, red too bright."""

SCALE_STEPS = (1.0, 2.0, 5.0, 10.0)
"""First digits of an error map's scale."""

SCALE_PERCENTILE = 99.0
"""Percentile of the absolute errors that the scale of their maps reaches."""

MIN_SCALE_SHARE = 0.1
"""Share of a section's scale that a map must reach to use this scale."""


def scales_of(pictures: Sequence[Picture]) -> tuple[float | None, ...]:
    """Return the error at the ends of each map's colours, None for pictures that are not error
    maps.

    It is a round number, the same for all maps of a section, and SCALE_PERCENTILE percent of their
    pixels stay below it. A map whose errors stay below MIN_SCALE_SHARE of it has a scale of its
    own.
    """
    maps = {
        i: picture.pixels[np.isfinite(picture.pixels)]
        for i, picture in enumerate(pictures)
        if picture.kind == "error"
    }
    common = round_up(most_of(np.concatenate([np.empty(0), *maps.values()])))
    scales = {i: own_scale(most_of(errors), common) for i, errors in maps.items()}
    return tuple(scales.get(i) for i in range(len(pictures)))


def own_scale(most: float, common: float) -> float:
    """Return the scale of a map whose errors reach ``most``,
    in a section with the scale ``common``.
    """
    if 0.0 < most < MIN_SCALE_SHARE * common:
        return round_up(most)
    return common


def most_of(errors: np.ndarray) -> float:
    """Return the value that SCALE_PERCENTILE percent of absolute errors stay below."""
    if errors.size:
        return float(np.percentile(np.abs(errors), SCALE_PERCENTILE))
    return 0.0


def round_up(error: float) -> float:
    """Return the next of 1, 2 or 5 times a power of ten; 0.01 for an error of 0."""
    if error <= 0.0:
        return 0.01
    power = 10.0 ** math.floor(math.log10(error))
    return next(step * power for step in SCALE_STEPS if step * power >= error * (1.0 - 1e-9))


def print_picture(picture: Picture, report: Report, scale: float | None) -> bytes:
    """Return the picture as PNG; ``scale`` is the error at the ends of an error map's colours."""
    if scale is None:
        shown = shown_as(picture.pixels, report.on, report.exposure)
    else:
        shown = error_colours(picture.pixels, scale)
    file = io.BytesIO()
    Image.fromarray(shown).save(file, "png", optimize=True)
    return file.getvalue()


def error_colours(errors: np.ndarray, scale: float) -> np.ndarray:
    """Return signed errors as colours (h, w, 3) uint8 sRGB,
    with ±``scale`` at the ends and the film's background where they are NaN.
    """
    on = np.isfinite(errors)
    # Map -scale … scale to 0 … 1, the range of the colour map.
    places = np.where(on, 0.5 + 0.5 * np.clip(np.nan_to_num(errors) / scale, -1.0, 1.0), 0.5)
    shown = mpl.colormaps[ERROR_COLOURS](places, bytes=True)[..., :3]
    top = len(tone_table()) - 1
    shown[~on] = tone_table()[np.rint(np.array(BACKGROUND) * top).astype(int)]
    return np.ascontiguousarray(shown)


def gradient(steps: int = 11) -> str:
    """Return the colours of errors as a CSS gradient, from too dark to too bright."""
    colours = mpl.colormaps[ERROR_COLOURS](np.linspace(0.0, 1.0, steps), bytes=True)[:, :3]
    return (
        f"linear-gradient(to right, {', '.join('#' + bytes(colour).hex() for colour in colours)})"
    )
