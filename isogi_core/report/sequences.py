"""Sequences: how far pictures jump as the isovalue slides or the light turns, beside how far the truth does."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from isogi_core.frame.paths import variance_of_mean
from isogi_core.model.plan import most_samples
from isogi_core.model.view import View, quaternion_from_angles
from isogi_core.report.bake import ViewBake
from isogi_core.report.bench import Bench
from isogi_core.report.metrics import luminance, mean_of, spread_of
from isogi_core.report.points import replicas
from isogi_core.report.reference import Reference, trace_reference
from isogi_core.report.sections import Column, Curve, Plot, Section, Table

KEY, TITLE = "sequences", "Sequences"

FRAMES = 6
"""Frames of each sequence."""

SIZE = 48
"""Pixels of the longer side of their pictures."""

PATHS = 512
"""Paths from each pixel of their references."""

STEPS = 256
"""Steps that the slider of isovalues has from one end to the other."""

DEGREES = 5.0
"""Degrees that the light turns from one frame to the next, about z."""

COLUMNS = (
    Column("sequence"),
    Column("frames", "count"),
    Column("the truth's own jump, largest", "share"),
    Column("beyond it, mean", "share"),
    Column("beyond it, largest", "share"),
    Column("beyond it, 99th percentile, largest", "share"),
)

ABOUT = f"""\
What an eye sees that follows a slider: pixels that show the surface in one frame and in the next, how much their \
luminance changes from frame to frame, and how much that differs from the change of references by the same random \
numbers. Errors that stay where they are jump nowhere. Isovalues go on by 1/{STEPS} of their range, the light turns by \
{DEGREES:g}° about z; each frame's texels are baked to the target error. Figures are root mean squares over pixels, \
relative to the mean luminance, less the noise of the references."""


@dataclass(frozen=True, eq=False)
class Shot:
    """One frame of a sequence: its ``luminance`` (h, w) float64, and its ``truth``."""

    luminance: np.ndarray
    truth: Reference


@dataclass(frozen=True)
class Jump:
    """From one frame to the next, over pixels that show the surface in both, relative to their mean luminance.

    ``own`` is the root mean square of what the truth changes by, ``beyond`` that of what the frames change by more or
    less than it; 99 % of the pixels differ by less than ``p99``, noise and all.
    """

    own: float
    beyond: float
    p99: float


def study(bench: Bench) -> Section:
    """Jumps as the isovalue slides, and as the light turns where it may."""
    small = bench.sized(SIZE)
    found = {name: list(jumps(shots(small, views))) for name, views in sequences(small).items()}
    rows = tuple((name, FRAMES, *summed(each)) for name, each in found.items())
    table = Table(f"Jumps from frame to frame, {small.view.width} × {small.view.height} pixels", COLUMNS, rows)
    return Section(KEY, TITLE, ABOUT, (table,), (plot_of(found),))


def sequences(bench: Bench) -> dict[str, list[View]]:
    """The views of each sequence by its name: the bench's own and on, and under the light unturned and on."""
    lowest, highest = bench.scene.isovalues
    step = (highest - lowest) / STEPS
    sliding = step if bench.view.isovalue + FRAMES * step < highest else -step
    found = {"the isovalue slides": slide(bench.view, [sliding * number for number in range(FRAMES)])}
    if bench.scene.rotating and not bench.scene.needs.constant:
        found["the light turns"] = turn(bench.view, [DEGREES * number for number in range(FRAMES)])
    return found


def slide(view: View, by: Iterable[float]) -> list[View]:
    """The view at other isovalues."""
    return [replace(view, isovalue=view.isovalue + each) for each in by]


def turn(view: View, degrees: Iterable[float]) -> list[View]:
    """The view under the light turned about z, by so many ``degrees`` in all."""
    return [replace(view, light=quaternion_from_angles(each, 0.0, 0.0)) for each in degrees]


def shots(bench: Bench, views: Iterable[View], paths: int = PATHS) -> Iterator[Shot]:
    """The frames of views, each with its own light baked to the scene's target, and their references.

    Raises Cancelled.
    """
    renderer, target = bench.renderer(bench.scene), bench.scene.target_error
    for view in views:
        bake = ViewBake(renderer, view)
        bake.grow(most_samples(target), target, bench.cancelled)
        truth = trace_reference(bench.renderer(bench.whole), view, paths, cancelled=bench.cancelled)
        yield Shot(luminance(bake.frame().radiance), truth)


def jumps(taken: Iterable[Shot]) -> Iterator[Jump]:
    """From each shot to the next; those that have no pixel of the surface in common are left out."""
    for before, after in pairwise(taken):
        common = before.truth.on & after.truth.on
        if common.any():
            yield jump(before, after, common)


def jump(before: Shot, after: Shot, common: np.ndarray) -> Jump:
    """From one shot to the next in ``common`` pixels (h, w) bool.

    References of the same random numbers have most of their noise in common: what is left of it is told from the
    changes of their replicas.
    """
    changes = replicas_at(after.truth, common) - replicas_at(before.truth, common)
    truth, noise = luminance(changes.mean(axis=1)), variance_of_mean(changes).astype(np.float64)
    mean = mean_of(luminance(np.concatenate([before.truth.mean[common], after.truth.mean[common]])))
    beyond = spread_of((after.luminance - before.luminance)[common] - truth, noise, mean)
    return Jump(spread_of(truth, noise, mean).rmse, beyond.rmse, beyond.p99)


def replicas_at(truth: Reference, where: np.ndarray) -> np.ndarray:
    """The replicas (m, replicas, 3) of a reference at some of its surface pixels, ``where`` (h, w) bool."""
    return replicas(truth)[where[truth.on]]


def summed(found: list[Jump]) -> tuple[float | None, ...]:
    """A row of the table."""
    if not found:
        return (None,) * 4
    beyond = [each.beyond for each in found]
    root = math.sqrt(sum(each**2 for each in beyond) / len(beyond))
    return max(each.own for each in found), root, max(beyond), max(each.p99 for each in found)


def plot_of(found: dict[str, list[Jump]]) -> Plot:
    """Jumps over frames."""
    curves = []
    for name, each in found.items():
        at = tuple(float(number + 1) for number in range(len(each)))
        curves.append(Curve(f"{name}: beyond the truth's jump", at, tuple(one.beyond for one in each)))
        curves.append(Curve(f"{name}: the truth's jump", at, tuple(one.own for one in each)))
    axes = Column("step", "count"), Column("jump", "share")
    return Plot("Jumps from frame to frame", *axes, tuple(curves), logarithmic=False)
