"""Frame times and memory of all shading models (S1, table 2)."""

from dataclasses import replace

from isogi_core.bake.precision import FIRST_RUNG
from isogi_core.frame.renderer import Renderer
from isogi_core.model.view import SHADINGS, View
from isogi_core.report.bake import ViewBake
from isogi_core.report.bench import Bench
from isogi_core.report.sections import Cell, Column, Section, Table
from isogi_core.report.turns import Candidate, medians, new_camera, relight

KEY, TITLE = "models", "Frame times and memory"

SIZE = 256
"""Pixels of the longer side of the picture."""

ROUNDS = 5
"""Frames of each model; the time that is told is their median."""

PATHS = 16
"""Paths from each pixel where a picture is path traced."""

CACHED = ("gi", "vicinity")
"""Models that read light of texels."""

COLUMNS = (
    Column("model"),
    Column("new camera, ms", "number"),
    Column("turned light, ms", "number"),
    Column("volume", "bytes"),
    Column("maps of the surface", "bytes"),
    Column("G-buffer", "bytes"),
    Column("light", "bytes"),
)

ABOUT = f"""\
Milliseconds on the wall, medians of {ROUNDS} frames of models that take turns, with all light baked before: after the \
camera has moved, so that all rays are cast again, and after the light alone was turned, which casts none but shadow \
rays. Path tracing takes {PATHS} paths from each pixel. Light is that of the texels that the view reads, in memory."""


def study(bench: Bench) -> Section:
    """Times and bytes of each model."""
    large = bench.sized(SIZE)
    renderer, views = large.renderer(large.scene), views_of(large.view)
    light = {name: light_of(renderer, views[name], large) for name in CACHED}
    turning = views if bench.scene.rotating else {}
    moved = medians({name: checked(bench, new_camera(renderer, view)) for name, view in views.items()}, ROUNDS)
    turned = medians({name: checked(bench, relight(renderer, view)) for name, view in turning.items()}, ROUNDS)
    surface = surface_bytes(renderer, large.view)
    rows: list[tuple[Cell, ...]] = []
    for name in views:
        again = 1e3 * turned[name] if name in turned else None
        rows.append((name, 1e3 * moved[name], again, *surface, light.get(name)))
    size = f"{large.view.width} × {large.view.height} pixels"
    table = Table(f"Models of shading, {size}, {bench.tiles.threads} threads", COLUMNS, tuple(rows))
    return Section(KEY, TITLE, f"{ABOUT} {still(bench)}".strip(), (table,))


def views_of(view: View) -> dict[str, View]:
    """The view by each model."""
    return {name: replace(view, shading=name, samples=PATHS) for name in SHADINGS}


def checked(bench: Bench, candidate: Candidate) -> Candidate:
    """The candidate, which raises Cancelled in place of a turn that nobody waits for."""

    def turn(number: int) -> float:
        bench.check()
        return candidate(number)

    return turn


def light_of(renderer: Renderer, view: View, bench: Bench) -> int:
    """Bake what the view reads, show it, and tell the bytes that it takes in memory."""
    bake = ViewBake(renderer, view)
    bake.grow(FIRST_RUNG, cancelled=bench.cancelled)
    bake.frame()
    pool = renderer.caches.of(view.shading).pool
    rows = (pool.transfer, pool.scatter, pool.error, pool.stamp)
    return len(bake.texels) * sum(row[:1].nbytes for row in rows)


def surface_bytes(renderer: Renderer, view: View) -> tuple[int, int, int]:
    """Bytes of the volume with its macrocells, of the map of one isovalue, and of the view's G-buffer."""
    recipe, gbuffer = renderer.recipe, renderer.gbuffer(view)
    field = recipe.field
    volume = field.voxels.nbytes + field.low.nbytes + field.high.nbytes
    return volume, recipe.bricks(gbuffer.isovalue, gbuffer.isovalue).nbytes, gbuffer.nbytes


def still(bench: Bench) -> str:
    """Why no time of a turned light is there, where it is not."""
    return "" if bench.scene.rotating else "The scene's light does not turn."
