"""Pictures of sweeps: a line for each thing that was measured."""

import io
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import matplotlib as mpl

mpl.use("agg")
from matplotlib import pyplot as plt

Rows = Sequence[Mapping[str, Any]]
SIZE = (6.4, 4.0)


def draw(found: Mapping[str, Rows]) -> dict[str, bytes]:
    """A picture (PNG), by its file's name, for each sweep that there are figures of."""
    return {f"{name}.png": made(name, found[name]) for name in PLOTS if name in found}


def made(name: str, rows: Rows) -> bytes:
    """One picture."""
    figure, axes = plt.subplots(figsize=SIZE, layout="constrained")
    PLOTS[name](axes, rows)
    axes.grid(alpha=0.3)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False)
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=110)
    plt.close(figure)
    return file.getvalue()


def workers(axes: Any, rows: Rows) -> None:
    """Efficiency of a batch."""
    for dispatch in sorted({row["dispatch"] for row in rows}, reverse=True):
        own = [row for row in rows if row["dispatch"] == dispatch]
        label = f"a scheduler that takes {1e3 * dispatch:g} ms a task"
        axes.plot(
            [row["workers"] for row in own],
            [100 * row["efficiency"] for row in own],
            "o-",
            label=label,
        )
    axes.set(
        xscale="log", xlabel="workers", ylabel="share of their time spent baking, %", ylim=(0, 100)
    )


def visitors(axes: Any, rows: Rows) -> None:
    """Times to light and to final."""
    times(axes, rows, "visitors")
    axes.set(xscale="log", yscale="log", xlabel="visitors, 64 workers", ylabel="seconds")


def latency(axes: Any, rows: Rows) -> None:
    """The same over the store's latency."""
    times(axes, [{**row, "latency": 1e3 * row["latency"]} for row in rows], "latency")
    axes.set(xscale="log", xlabel="milliseconds that a call of the store takes", ylabel="seconds")


def failures(axes: Any, rows: Rows) -> None:
    """What failing calls cost."""
    for tries in sorted({row["tries"] for row in rows}):
        own = [row for row in rows if row["tries"] == tries]
        share = [100 * row["fail"] for row in own]
        lost = [100 * row["lost"] / (row["lost"] + row["baked"]) for row in own]
        label = f"calls are made {'once' if tries == 1 else f'up to {tries} times'}"
        (line,) = axes.plot(share, lost, "o-", label=f"processor time lost, {label}")
        missed = [100 * (1 - row["done_share"]) for row in own]
        axes.plot(share, missed, "s--", color=line.get_color(), label=f"views not final, {label}")
    axes.set(xlabel="calls of the store that fail, %", ylabel="%")


def queue(axes: Any, rows: Rows) -> None:
    """Milliseconds of a decision."""
    for clients, together in dict.fromkeys((row["clients"], row["together"]) for row in rows):
        own = [row for row in rows if (row["clients"], row["together"]) == (clients, together)]
        label = f"{clients} client{'s' if clients > 1 else ''}{', one view' if together else ''}"
        decision = [1e3 * (row["take"] + row["finish"]) for row in own]
        axes.plot([row["chunks"] for row in own], decision, "o-", label=label)
    axes.axhline(1.0, color="grey", linestyle=":")
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="chunks that wait",
        ylabel="ms of the processor a decision",
    )


def times(axes: Any, rows: Rows, over: str) -> None:
    """Times to first light and to final, medians and 95 %."""
    for name, text, marker in (("light", "first light", "o"), ("final", "final", "s")):
        (line,) = axes.plot(
            [row[over] for row in rows],
            [row[name] for row in rows],
            f"{marker}-",
            label=f"{text}, median",
        )
        many = [row[f"{name}_95"] for row in rows]
        axes.plot(
            [row[over] for row in rows],
            many,
            f"{marker}--",
            color=line.get_color(),
            label=f"{text}, 95 %",
        )


PLOTS: dict[str, Callable[[Any, Rows], None]] = {
    "workers": workers,
    "visitors": visitors,
    "latency": latency,
    "failures": failures,
    "queue": queue,
}
