"""Plots as SVG: text as text, colours as names that the page, or the file itself, gives a value in light and dark."""

import io
import math
import re
from dataclasses import dataclass
from functools import lru_cache
from xml.sax.saxutils import escape

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

from isogi_report.cells import PREFIXES
from isogi_report.sections import Column, Curve, Plot
from server.inspect.picture import DASHES, INK, LINE, SCHEME, SOFT, STYLE

WIDTH, HEIGHT = 4.6, 3.1
"""Inches of a plot, 72 units of SVG each."""

TICK_STEPS = ((100.0, (1.0,)), (10.0, (1.0, 2.0, 5.0)), (1.0, (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)))
"""First digits of the ticks of a logarithmic axis, where its ends are so many times apart."""

ROW = 14.0
"""Height of a line of the legend."""

CURVES = ("#040404", "#050505", "#060606", "#070707", "#080808", "#090909")
"""Colours that stand for a name while matplotlib draws: see NAMES."""

NAMES = {
    INK: "var(--ink)",
    SOFT: "var(--soft)",
    LINE: "var(--line)",
    **{colour: f"var(--curve-{i + 1})" for i, colour in enumerate(CURVES)},
}


@dataclass(frozen=True)
class Key:
    """One entry of a plot's legend: the curve's name, colour and dashes, as SVG has them."""

    name: str
    colour: str
    dashes: str


def keys(plot: Plot) -> tuple[Key, ...]:
    """The legend of a plot: the curves that it shows."""
    return tuple(
        Key(curve.name, NAMES[colour_of(i)], " ".join(map(str, dashes_of(i))) or "none")
        for i, curve in enumerate(plot.curves)
        if drawable(curve)[0]
    )


def colour_of(i: int) -> str:
    """What stands for the colour of curve ``i`` while matplotlib draws."""
    return CURVES[i % len(CURVES)]


def dashes_of(i: int) -> tuple[float, ...]:
    """The dashes of curve ``i``."""
    return DASHES[i % len(DASHES)]


@lru_cache(64)
def draw(plot: Plot) -> str:
    """The plot as an ``svg`` element for a page that gives the names their colours; the same bytes each time."""
    with mpl.rc_context({**STYLE, "svg.hashsalt": plot.caption}):
        figure = Figure(figsize=(WIDTH, HEIGHT), layout="constrained")
        fill(figure.add_subplot(), plot)
        file = io.BytesIO()
        figure.savefig(file, format="svg", metadata={"Date": None})
    return named(file.getvalue().decode())


def standalone(plot: Plot) -> str:
    """The plot as a file that has its own colours, light and dark, and its legend below the axes."""
    entries = keys(plot) if len(keys(plot)) > 1 else ()
    width, height = 72 * WIDTH, 72 * HEIGHT
    size = f'viewBox="0 0 {width:g} {height:g}"'
    below = "".join(legend_line(key, height + ROW * (i + 0.5)) for i, key in enumerate(entries))
    svg = draw(plot).replace(size, f'viewBox="0 0 {width:g} {height + ROW * len(entries):g}"', 1)
    head, _, rest = svg.removesuffix("</svg>").partition(">")
    style = f"<style>{SCHEME}svg {{ background: var(--paper); }}</style>"
    return f'<?xml version="1.0" encoding="utf-8"?>\n{head}>{style}{rest}{below}</svg>\n'


def legend_line(key: Key, y: float) -> str:
    """An entry of a legend, at height ``y``."""
    line = f'<path d="M8 {y:g}h28" style="fill: none; stroke: {key.colour}; stroke-dasharray: {key.dashes}"/>'
    text = f'<text x="44" y="{y + 3:g}" style="font: 9.5px var(--text); fill: var(--ink)">{escape(key.name)}</text>'
    return f"{line}{text}"


def named(svg: str) -> str:
    """matplotlib's file as an element: names for colours and fonts, nothing that a page holds once."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", "", svg, flags=re.DOTALL)
    svg = re.sub(r'(<g) id="[^"]*"', r"\1", svg)
    svg = re.sub(r"font-family: [^;\"]*", "font-family: var(--text)", svg)
    svg = re.sub(r'(<svg [^>]*?) width="[^"]*" height="[^"]*"', r"\1", svg)
    for colour, name in NAMES.items():
        svg = svg.replace(colour, name)
    return svg.strip()


def fill(axes: Axes, plot: Plot) -> None:
    """Draw the curves and their axes."""
    for i, curve in enumerate(plot.curves):
        x, y = drawable(curve)
        style = (0, dashes_of(i)) if dashes_of(i) else "solid"
        axes.plot(x, y, color=colour_of(i), linestyle=style, linewidth=1.5, marker="o", markersize=3.2)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(color=LINE, linewidth=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.patch.set_visible(False)
    axes.figure.patch.set_visible(False)
    axes.set_xlabel(plot.x.name)
    axes.set_ylabel(plot.y.name)
    for axis, column in ((axes.xaxis, plot.x), (axes.yaxis, plot.y)):
        mark(axis, column)


def drawable(curve: Curve) -> tuple[list[float], list[float]]:
    """The points of a curve that logarithmic axes can show."""
    points = [(x, y) for x, y in zip(curve.x, curve.y, strict=True) if 0.0 < x < math.inf and 0.0 < y < math.inf]
    return [x for x, _ in points], [y for _, y in points]


def mark(axis: Axis, column: Column) -> None:
    """Ticks with the unit in them."""
    axis.set_major_formatter(FuncFormatter(lambda value, _: tick(value, column.unit)))
    low, high = axis.get_view_interval()
    axis.set_major_locator(LogLocator(10, next(firsts for times, firsts in TICK_STEPS if high >= times * low)))
    axis.set_minor_locator(NullLocator())
    axis.set_minor_formatter(NullFormatter())


def tick(value: float, unit: str) -> str:
    """A tick's label."""
    if unit == "share":
        return f"{100 * value:.6g} %"
    if unit in PREFIXES:
        step = next((step for step in reversed(PREFIXES[unit]) if abs(value) >= step[1]), PREFIXES[unit][0])
        return f"{value / step[1]:.3g} {step[0]}"
    return f"{value:,.6g}"
