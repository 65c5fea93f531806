"""The split: a frame's error, and its parts, each found by putting its exact counterpart in place of one ingredient."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from isogi_core.model.scene_plan import ScenePlan
from isogi_core.plan.scene import Scene
from isogi_report.bench import Bench
from isogi_report.exact import (
    Lit,
    converged,
    cuts_harmonics,
    lit_by_frame,
    lit_by_paths,
    own_light,
    reference_difference,
    short_paths,
)
from isogi_report.metrics import Spread, map_of, mean_of, spread_of
from isogi_report.sections import Column, Picture, Section, Table

SPLIT_KEY, SPLIT_TITLE = "split", "Where the error comes from"

SPLIT_COLUMNS = (Column("part"), Column("relative RMSE", "share"), Column("bias", "share"), Column("what is compared"))

SPLIT_TEXT = """\
Each part is the difference that remains when one ingredient of the frame gives way to its exact counterpart, one \
after the other, so that biases add up to the total's. Noise that is known of either side is taken off. The parts' \
root sum of squares equals the total where they are independent. Normals and offset are the scene's own choice, and so \
the reference's too: what they change is listed apart."""


@dataclass(frozen=True, eq=False)
class Part:
    """One part of a frame's error: its ``name``, ``what`` was compared, and ``wrong`` (m,), the pixels' luminance too
    much; ``noise`` (m,) is the variance of it that belongs to no part, negative where some of the part is missing.
    """

    name: str
    what: str
    wrong: np.ndarray
    noise: np.ndarray | float = 0.0


@dataclass(frozen=True, eq=False)
class Split:
    """The ``parts`` of a frame's error, and the ``whole`` of it; ``mean`` is the luminance that they are relative to.

    ``surface`` is what the scene's normals and offset make of it, and ``beyond`` the whole with that.
    """

    parts: tuple[Part, ...]
    whole: Part
    surface: Part
    beyond: Part
    mean: float

    def spread(self, part: Part) -> Spread:
        """The size of a part."""
        return spread_of(part.wrong, part.noise, self.mean)

    @property
    def together(self) -> float:
        """Root sum of squares of the parts."""
        return math.sqrt(sum(self.spread(part).rmse ** 2 for part in self.parts))


def study(bench: Bench) -> Section:
    """The frame's error and its parts, as a table and as maps."""
    split = split_error(bench)
    bias = sum(split.spread(part).bias for part in split.parts)
    reported = bench.planned.frame().noise
    rows = (
        *(row_of(part, split) for part in split.parts),
        ("parts together", split.together, bias, "root sum of squares, sum of biases"),
        row_of(split.whole, split),
        ("the frame's own estimate", reported, None, "Monte Carlo noise alone, estimated by the texels"),
        row_of(split.surface, split),
        row_of(split.beyond, split),
    )
    shown = (*split.parts, split.whole, split.surface)
    pictures = tuple(Picture(part.name, "error", map_of(part.wrong, bench.best.on, split.mean)) for part in shown)
    table = Table("Error of the plan's frame and its parts", SPLIT_COLUMNS, rows)
    return Section(SPLIT_KEY, SPLIT_TITLE, f"{SPLIT_TEXT} {missing(bench)}".strip(), (table,), (), pictures)


def split_error(bench: Bench) -> Split:
    """Split the error of the plan's frame."""
    best = lit_by_paths(bench.best)
    planned = lit_by_frame(bench.planned.frame())
    whole = Part("total, measured", "the frame and the reference", planned.light - best.light, best.noise)
    bare = bench.reference(bench.best.samples, true_surface(bench.scene))
    true, change = lit_by_paths(bare), reference_difference(bench.best, bare)
    what = "the scene's normals and offset, and plain gradients with rays from the surface itself"
    surface = Part("normals and offset", what, change.light, change.noise)
    beyond = Part("total with these", "the frame and such a reference", planned.light - true.light, true.noise)
    return Split(tuple(parts_of(bench, planned, best)), whole, surface, beyond, mean_of(best.light))


def true_surface(scene: Scene) -> Scene:
    """The scene with the normals that its trilinear isosurface has, and rays that start on it."""
    return scene.with_settings(normals="gradient", offset=0.0)


def parts_of(bench: Bench, planned: Lit, best: Lit) -> Iterator[Part]:
    """The parts, from the frame to the reference."""
    pair, plan = converged(bench), bench.scene.plan
    kept, exact = lit_by_frame(pair.kept), lit_by_frame(pair.exact)
    what = f"texels as they are, and after {pair.samples:,.0f} samples each on average"
    yield Part("Monte Carlo noise", what, planned.light - kept.light, -kept.noise)
    if plan.precision != "single":
        yield Part("quantization", f"{plan.precision} and single floats", kept.light - exact.light)
    own, short = own_light(bench), short_paths(bench)
    noise = exact.noise + own.noise
    yield Part("interpolation", "texels around a pixel, and light at its own point", exact.light - own.light, noise)
    if cuts_harmonics(bench.scene):
        what, lights = f"{harmonics(plan)}, and the lights themselves", lit_by_paths(short)
        yield Part("harmonics cut off", what, own.light - lights.light, own.noise + lights.noise)
    if bench.scene.bounces:
        cut, what = reference_difference(short, bench.best), f"{bench.scene.bounces} bounces, and {bench.whole.bounces}"
        yield Part("bounces cut off", what, cut.light, cut.noise)


def harmonics(plan: ScenePlan) -> str:
    """What texels keep of a light, and what pixels see of it themselves."""
    lobes = {0: "", 1: ", a lobe beside"}.get(plan.lobes, f", {plan.lobes} lobes beside")
    return f"harmonics of order {plan.order}{lobes}"


def missing(bench: Bench) -> str:
    """Why some parts are not there."""
    plan = bench.scene.plan
    reasons = []
    if plan.precision == "single":
        reasons.append("Light is kept in single floats: nothing is rounded.")
    if not cuts_harmonics(bench.scene):
        reasons.append("Texels keep no harmonics that could be cut off.")
    if not bench.scene.bounces:
        reasons.append("The scene has direct light alone: no bounces are missing.")
    return " ".join(reasons)


def row_of(part: Part, split: Split) -> tuple[str, float, float, str]:
    """A part's row of the table."""
    spread = split.spread(part)
    return part.name, spread.rmse, spread.bias, part.what
