"""The lattice at half, once and twice its density (S1, figure 12), and as fine as light asks for (its section 6)."""

from dataclasses import replace

from isogi_core.model.plan import most_samples
from isogi_core.report import scores
from isogi_core.report.bake import ViewBake
from isogi_core.report.bench import Bench
from isogi_core.report.metrics import error_map, mean_of, spread_of
from isogi_core.report.points import lit_by_frame, own_light
from isogi_core.report.sections import Cell, Column, Picture, Section, Table

KEY, TITLE = "lattices", "Density of the lattice"

LATTICES = ((0.5, False), (1.0, True), (1.0, False), (2.0, True), (2.0, False))
"""Texels along each axis, as multiples of the scene's, and whether the scene is adaptive."""

COLUMNS = (
    Column("texels per voxel", "number"),
    Column("read"),
    *scores.COLUMNS,
    Column("interpolation", "share"),
    Column("texels of the view", "count"),
    Column("texels of the lattice", "count"),
    Column("bake", "seconds"),
)

ABOUT = """\
The plan's light on lattices of other densities, each baked to the target error. Adaptive scenes light every second \
texel first, and the others where light differs too much from one of these to the next. Interpolation is what of the \
error remains beside light at the pixels' own points; a finer lattice mends that part alone. A view reads at most \
eight texels for each pixel, so that small pictures do not show how many more texels a finer lattice has, nor how few \
an adaptive one needs. Of texels that are lit on the shown isosurface too both are counted."""


def study(bench: Bench) -> Section:
    """Errors and costs of each lattice."""
    rows, pictures = [], []
    for density, adaptive in LATTICES:
        bake = lattice(bench, density, adaptive)
        rows.append(row_of(bench, bake))
        errors = error_map(bake.frame().radiance, bench.best)
        name = f"{bake.look.recipe.scene.lattice:g} texels per voxel{', adaptive' if adaptive else ''}"
        pictures.append(Picture(name, "error", errors))
    table = Table("Lattices against the reference", COLUMNS, tuple(rows))
    return Section(KEY, TITLE, ABOUT, (table,), (), tuple(pictures))


def lattice(bench: Bench, density: float, adaptive: bool) -> ViewBake:
    """The view's light on a lattice so many times as dense, which is read so."""
    if (density, adaptive) == (1.0, bench.scene.adaptive):
        return bench.planned
    bench.check()
    scene = replace(bench.scene, lattice=density * bench.scene.lattice, adaptive=adaptive)
    target = scene.target_error
    bake = ViewBake(bench.renderer(scene), bench.view)
    bake.grow(most_samples(target), target, bench.cancelled)
    return bake


def row_of(bench: Bench, bake: ViewBake) -> tuple[Cell, ...]:
    """A lattice's row of the table."""
    scene, frame, own = bake.look.recipe.scene, bake.frame(), own_light(bench)
    lit, z_y_x = lit_by_frame(frame), scene.lattice_shape
    apart = spread_of(lit.light - own.light, lit.noise + own.noise, mean_of(own.light))
    counts = bake.lights, z_y_x[0] * z_y_x[1] * z_y_x[2]
    return (
        scene.lattice,
        "adaptive" if scene.adaptive else "all of it",
        *scores.cells(bench.score(frame.radiance)),
        apart.rmse,
        *counts,
        bake.seconds,
    )
