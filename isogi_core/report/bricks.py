"""A lattice that is fine where the light asks for it: bricks of space, each read at a density of its own.

The idea of S1's section 6, "future work". A brick is read coarse at first, and at twice the density where an estimate
of what interpolation errs by there is above a tolerance; then again. What is told is how few texels that takes.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from isogi_core.bake.precision import FIRST_RUNG
from isogi_core.frame.sharpening import STEEPNESS
from isogi_core.frame.surroundings import Turned
from isogi_core.plan.projection import evaluate_harmonics
from isogi_core.report.bake import ViewBake
from isogi_core.report.bench import Bench
from isogi_core.report.metrics import Spread, luminance, mean_of, spread_of
from isogi_core.report.points import Lit, cuts_harmonics, lit_by_transfer, own_light, straight_light
from isogi_core.report.sections import Column, Section, Table
from isogi_core.report.strides import Lights, Net, Texels, find_texels

KEY, TITLE = "bricks", "Lattice where it is needed"

FINEST = 2.0
"""Texels along each axis of the finest lattice, as multiples of the scene's."""

STRIDES = (8, 4, 2, 1)
"""Of the nets of it; the first serves one estimate alone. The scene's own density is MIDDLE."""

MIDDLE = 2

SAMPLES = 1024
"""Of each texel: noise is to hide little of how bricks differ."""

PATHS = 4096
"""From each pixel, for transfer of its own."""

EDGES = (4.0, 8.0, 16.0)
"""Voxels along each side of a brick."""

WIDE = 512
"""Pixels along each side of the picture that texels are counted in: small ones hardly share any between pixels."""

TOLERANCES = tuple(np.geomspace(0.002, 2.0, 61).tolist())
"""Of estimates, relative to the picture's mean luminance."""

TOLD = (0.02, 0.03, 0.04, 0.06, 0.08, 0.12, 0.16)
"""Those that a table of their own tells of."""

ABOUT = """\
The same light on lattices of {densities} texels per voxel, of {samples} samples a texel, in single floats, carried as \
shares of unshadowed light with weights of normals; texels farther than {way:.2g} voxels from the shown isosurface are \
lit on that. Errors are those of the view's pixels against light at their own points, less the noise of both sides. \
Texels are counted in the same view at {wide} × {wide} pixels, those that are moved twice, as both lights are baked. \
In a mixture each brick is read at the first density whose estimate is within the tolerance, and all that was read on \
the way there counts, too. Bricks that no pixel of the small view lies in are left out of both counts."""

ONE = (
    Column("texels per voxel", "number"),
    *(Column(f"{way}: {what}", "share") for way in ("own", "moved") for what in ("relative RMSE", "99th percentile")),
    Column("texels of the wide view", "count"),
    Column("with moved ones", "count"),
)

FIRST = (
    Column("light"),
    Column("relative RMSE", "share"),
    Column("99th percentile", "share"),
    Column("texels of the wide view", "count"),
    Column("bake", "seconds"),
)

MIXED = (
    Column("bricks, refined by"),
    Column("texels at equal RMSE", "share"),
    Column("texels at equal 99th percentile", "share"),
)

ALONG = (
    Column("tolerance"),
    Column("relative RMSE", "share"),
    Column("99th percentile", "share"),
    Column("texels", "share"),
)


@dataclass(frozen=True, eq=False)
class Bricks:
    """Bricks of space that a view's pixels lie in: ``numbers`` (m,) of them, and ``wide`` (M,) of the wide view's.

    The latter are -1 in bricks without a pixel of the former.
    """

    numbers: np.ndarray
    wide: np.ndarray

    @classmethod
    def of(cls, points: np.ndarray, wide: np.ndarray, edge: float) -> "Bricks":
        """Those with an ``edge``, in voxels, of ``points`` (m, 3) and (M, 3)."""
        keys, others = (brick_keys(each, edge) for each in (points, wide))
        found, numbers = np.unique(keys, return_inverse=True)
        at = np.minimum(np.searchsorted(found, others), len(found) - 1)
        return cls(numbers, np.where(found[at] == others, at, -1))

    @cached_property
    def pixels(self) -> np.ndarray:
        """Pixels in each brick, at least one."""
        return np.bincount(self.numbers)

    def rms(self, squares: np.ndarray) -> np.ndarray:
        """The root of the mean of pixels' ``squares`` (m,) in each brick; 0 where that is negative."""
        return np.asarray(np.sqrt(np.maximum(np.bincount(self.numbers, squares) / self.pixels, 0.0)))

    def spread_out(self, nets: np.ndarray) -> np.ndarray:
        """The net of each pixel of the wide view, by those of bricks; -1 where it is left out."""
        return np.where(self.wide >= 0, nets[self.wide], -1)


def brick_keys(points: np.ndarray, edge: float) -> np.ndarray:
    """A number for the brick that each of the ``points`` (m, 3) lies in, int64."""
    z, y, x = np.floor(points.T / edge).astype(np.int64)
    return np.asarray((z << 42) + (y << 21) + x)


@dataclass(frozen=True, eq=False)
class Study:
    """What mixtures are made of: the ``nets`` of a view, coarse to fine, its ``own`` light, and ``wide`` texels.

    ``lights`` (t,) are how many each of the latter takes: a second one where it is moved.
    """

    nets: tuple[Net, ...]
    own: Lit
    wide: Texels
    lights: np.ndarray

    @cached_property
    def mean(self) -> float:
        """The mean luminance, which all errors are told against."""
        return mean_of(self.own.light)

    @cached_property
    def squares(self) -> tuple[np.ndarray, ...]:
        """The squared error of each pixel from each net, less what noise brings in the mean; (m,)."""
        return tuple((net.lit.light - self.own.light) ** 2 - net.lit.noise - self.own.noise for net in self.nets)

    def texels(self, nets: np.ndarray, whole: bool = True) -> int:
        """Lights of texels where the wide view's pixels read these ``nets`` (M,), with coarser ones if ``whole``."""
        read = np.zeros(len(self.lights), np.bool_)
        for k in range(1, len(self.nets)):
            read[self.wide.numbers[k][nets >= k if whole else nets == k]] = True
        return int(self.lights[read].sum())

    def errors(self, nets: np.ndarray) -> Spread:
        """Errors where the view's pixels read these ``nets`` (m,)."""
        light, noise = (np.choose(nets, [getattr(net.lit, name) for net in self.nets]) for name in ("light", "noise"))
        return spread_of(light - self.own.light, noise + self.own.noise, self.mean)


Estimate = Callable[[Study, Bricks, int], np.ndarray]
"""What each brick is expected to err by from a net, as a luminance; (bricks,)."""


def by_error(study: Study, bricks: Bricks, k: int) -> np.ndarray:
    """The error itself, which nobody knows who has not lit the pixels: how well estimates could do."""
    return bricks.rms(study.squares[k])


def by_spread(study: Study, bricks: Bricks, k: int) -> np.ndarray:
    """The spread of the shares that a pixel reads, for each voxel of a cell's edge."""
    return study.nets[k].edge * bricks.rms(study.nets[k].spread ** 2)


def by_turn(study: Study, bricks: Bricks, k: int) -> np.ndarray:
    """How far the normals of a pixel's texels are turned, for each voxel of a cell's edge."""
    return study.nets[k].edge * bricks.rms(study.nets[k].turn ** 2)


def by_coarser(study: Study, bricks: Bricks, k: int) -> np.ndarray:
    """How far the net is from the one of half its density."""
    one, other = study.nets[k].lit, study.nets[k - 1].lit
    return bricks.rms((one.light - other.light) ** 2 - one.noise - other.noise)


ESTIMATES: Mapping[str, Estimate] = {
    "the error itself": by_error,
    "the spread of shares": by_spread,
    "the turn of normals": by_turn,
    "the coarser net": by_coarser,
}


@dataclass(frozen=True)
class Mixture:
    """What a mixture comes to: its ``errors``, and its texels as a ``share`` of those of the scene's own density."""

    tolerance: float
    errors: Spread
    share: float


def study(bench: Bench) -> Section:
    """Errors and texels of one density, of the first light, and of mixtures."""
    way = bench.scene.target_error / STEEPNESS
    finer = replace(bench, scene=replace(bench.scene, lattice=FINEST * bench.scene.lattice), _made={})
    wide = replace(bench.view, width=WIDE, height=WIDE)
    lights = Lights(finer, find_texels(finer, finer.view, STRIDES), SAMPLES)
    texels, own = find_texels(finer, wide, STRIDES), light_at_points(bench)
    moved = Study(lights.nets(way), own, texels, 1 + (texels.ways > way))
    still = Study(lights.nets(math.inf), own, texels, np.ones(len(texels.ways), np.int64))
    renderer = finer.renderer(finer.scene)
    points = renderer.gbuffer(finer.view).points, renderer.gbuffer(wide).points
    bricks = {edge: Bricks.of(*points, edge) for edge in EDGES}
    tables = one_density(still, moved), first_light(bench, finer, lights.texels), *mixtures(moved, bricks)
    densities = ", ".join(f"{1.0 / net.edge:g}" for net in moved.nets)
    return Section(KEY, TITLE, ABOUT.format(densities=densities, samples=lights.samples, way=way, wide=WIDE), tables)


def light_at_points(bench: Bench) -> Lit:
    """Light at the pixels' own points, as ``own_light`` has it, with less noise."""
    if not cuts_harmonics(bench.scene):
        return own_light(bench)
    found: Lit = bench.once("light at points", lambda: lit_by_transfer(bench, PATHS))
    return found


def one_density(still: Study, moved: Study) -> Table:
    """Each density by itself: errors of texels on their own isosurfaces, and of moved ones."""
    rows = []
    for k in range(1, len(moved.nets)):
        nets, wide = (np.full(n, k) for n in (len(moved.own.light), moved.wide.numbers.shape[1]))
        own, there = still.errors(nets), moved.errors(nets)
        counts = still.texels(wide, whole=False), moved.texels(wide, whole=False)
        rows.append((1.0 / moved.nets[k].edge, own.rmse, own.p99, there.rmse, there.p99, *counts))
    return Table("One density", ONE, tuple(rows))


def first_light(bench: Bench, finer: Bench, texels: Texels) -> Table:
    """What a view shows first: no light of its own, and the first samples on coarse and fine lattices, with noise."""
    own, lights = light_at_points(bench), Lights(finer, texels, FIRST_RUNG)
    shown: dict[str, tuple[np.ndarray, int, float]] = {"unshadowed": (unshadowed(finer, lights), 0, 0.0)}
    for net in lights.nets(math.inf)[1 : MIDDLE + 1]:
        bake = wide_bake(bench, 1.0 / (net.edge * bench.scene.lattice))
        name = f"{1.0 / net.edge:g} texels per voxel, {FIRST_RUNG} samples"
        shown[name] = net.lit.light, len(bake.texels), bake.seconds
    rows = []
    for name, (light, count, seconds) in shown.items():
        spread = spread_of(light - own.light, own.noise, mean_of(own.light))
        rows.append((name, spread.rmse, spread.p99, count, seconds))
    return Table("First light", FIRST, tuple(rows))


def unshadowed(bench: Bench, lights: Lights) -> np.ndarray:
    """What pixels show where nothing is baked: the light about their normals without shadows, and that of lobes."""
    look, n = bench.renderer(bench.scene).caches.look(bench.view.shading), lights.sides.normals
    sky = Turned(look, bench.view).sky
    basis = evaluate_harmonics(sky.order, np.arccos(np.clip(n[:, 2], -1.0, 1.0)), np.arctan2(n[:, 1], n[:, 0]))
    light = luminance(((sky.lobe * sky.light) @ basis).T)
    return np.asarray(look.unit * np.maximum(light, 0.0) + straight_light(bench))


def wide_bake(bench: Bench, density: float) -> ViewBake:
    """The first samples of all texels of the wide view on a lattice so many times as dense as the scene's."""
    bench.check()
    scene = replace(bench.scene, lattice=density * bench.scene.lattice, sharpen=False)
    bake = ViewBake(bench.renderer(scene), replace(bench.view, width=WIDE, height=WIDE))
    bake.grow(FIRST_RUNG, cancelled=bench.cancelled)
    return bake


def mixtures(study: Study, bricks: Mapping[float, Bricks]) -> tuple[Table, ...]:
    """Texels of mixtures that err no more than the scene's own density; and errors by the tolerance."""
    rows = [
        (f"{edge:g} voxels, {name}", *at_equal_error(study, mixed(study, those, estimate, TOLERANCES)))
        for edge, those in bricks.items()
        for name, estimate in ESTIMATES.items()
    ]
    finest = tuple(by_tolerance(study, bricks, finest) for finest in (len(study.nets) - 1, MIDDLE))
    return Table("Mixtures that err no more than one density", MIXED, tuple(rows)), *finest


def by_tolerance(study: Study, bricks: Mapping[float, Bricks], finest: int) -> Table:
    """Errors and texels of mixtures by the spread of shares, of nets up to the ``finest``."""
    rows = [
        (f"{edge:g} voxels, {it.tolerance:g}", it.errors.rmse, it.errors.p99, it.share)
        for edge, those in bricks.items()
        for it in mixed(study, those, by_spread, TOLD, finest)
    ]
    density = 1.0 / study.nets[finest].edge
    return Table(f"Mixtures by the spread of shares, up to {density:g} texels per voxel", ALONG, tuple(rows))


def at_equal_error(study: Study, curve: Sequence[Mixture]) -> tuple[float | None, float | None]:
    """The least share of texels among mixtures with the RMSE of the scene's own density, and its 99th percentile.

    None where none errs as little.
    """
    fixed = study.errors(np.full(len(study.own.light), MIDDLE))
    alike = ([it.share for it in curve if getattr(it.errors, name) <= getattr(fixed, name)] for name in ("rmse", "p99"))
    rmse, p99 = (min(each, default=None) for each in alike)
    return rmse, p99


def mixed(
    study: Study, bricks: Bricks, estimate: Estimate, tolerances: Sequence[float], finest: int | None = None
) -> list[Mixture]:
    """Mixtures by an estimate, of several tolerances; of nets up to the ``finest``, all of them by default."""
    nets = range(len(study.nets) if finest is None else finest + 1)
    told = np.stack([estimate(study, bricks, k) if k else np.zeros(len(bricks.pixels)) for k in nets]) / study.mean
    whole = study.texels(bricks.spread_out(np.full(len(bricks.pixels), MIDDLE)), whole=False)
    found = []
    for tolerance in tolerances:
        chosen = choose(told, tolerance)
        share = study.texels(bricks.spread_out(chosen)) / max(whole, 1)
        found.append(Mixture(tolerance, study.errors(chosen[bricks.numbers]), share))
    return found


def choose(told: np.ndarray, tolerance: float) -> np.ndarray:
    """The net of each brick: the first but one whose estimate, of those ``told`` (nets, bricks), is within the
    tolerance, or the last."""
    chosen = np.ones(told.shape[1], np.int64)
    for k in range(1, len(told) - 1):
        chosen[(chosen == k) & (told[k] > tolerance)] += 1
    return chosen
