"""Global illumination beside vicinity shading, which knows how open a place is and nothing more (S1, figure 10)."""

from dataclasses import replace

from isogi_core.model.plan import most_samples
from isogi_core.report import scores
from isogi_core.report.bake import ViewBake
from isogi_core.report.bench import Bench
from isogi_core.report.metrics import error_map
from isogi_core.report.sections import Column, Picture, Section, Table

KEY, TITLE = "vicinity", "Vicinity shading"

ABOUT = """\
Vicinity shading keeps one number for each texel: the share of a constant light that arrives unreflected. It knows \
neither where light comes from nor what surfaces send on. The map shows what it misses, relative to the reference's \
mean luminance."""

SAME = "Left out: the scene has constant light and no bounces, so that its plan is vicinity shading itself."

COLUMNS = (Column("shading"), *scores.COLUMNS, Column("bake", "seconds"), Column("bytes per texel", "bytes"))


def study(bench: Bench) -> Section:
    """Both frames against the reference of global illumination; nothing where the plan's own is vicinity shading."""
    if bench.scene.plan.representation == "vicinity":
        return Section(KEY, TITLE, SAME)
    near = vicinity(bench)
    rows, pictures = [], []
    for name, bake in (("global illumination", bench.planned), ("vicinity shading", near)):
        radiance = bake.frame().radiance
        rows.append((name, *scores.cells(bench.score(radiance)), bake.seconds, bake.look.plan.bytes_per_texel))
        pictures.append(Picture(name, "radiance", radiance))
    pictures.append(Picture("vicinity shading's error", "error", error_map(near.frame().radiance, bench.best)))
    table = Table("Against the reference", COLUMNS, tuple(rows))
    return Section(KEY, TITLE, ABOUT, (table,), (), tuple(pictures))


def vicinity(bench: Bench) -> ViewBake:
    """The view's light as vicinity shading has it, baked to the target error."""

    def bake() -> ViewBake:
        target = bench.scene.target_error
        light = ViewBake(bench.renderer(bench.scene), replace(bench.view, shading="vicinity"))
        light.grow(most_samples(target), target, bench.cancelled)
        return light

    return bench.once("vicinity", bake)
