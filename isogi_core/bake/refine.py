"""Refinement: add samples to texels, level by level (16, 32, 64, …).

After each level light is rounded to the numbers that the store keeps. A texel with n samples
therefore has the same bits for any number of workers and of calls, and the parts of a texel that
climb next follow from its record in the store alone.

``find_kept`` serves cuts: if the isosurface of a texel is not in what a cut takes away, all of its
paths keep their points, and its light keeps its bits.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from isogi_core.bake.bake_spec import BakeSpec
from isogi_core.bake.noise import DECAYS, Goal, blend_noise, evenness, finished, noise_of_halves
from isogi_core.bake.texel_light import (
    VOID,
    Light,
    Part,
    next_level,
    noise_codes,
    noise_of,
    round_light,
)
from isogi_core.kernels.tracing.active_cells import ActiveCells
from isogi_core.kernels.tracing.glow import Glows
from isogi_core.kernels.tracing.walls import NO_WALL
from isogi_core.kernels.transport.entries import PATH_KERNELS
from isogi_core.kernels.transport.light_paths import Open, Surroundings
from isogi_core.kernels.transport.matter.matter_paths import ALONG_RAY, INWARD, Through
from isogi_core.kernels.transport.paths import PathRules, PathStarts, SampleRange, TransferRules
from isogi_core.kernels.transport.room_paths import fill_seeds
from isogi_core.kernels.transport.transfer import (
    TEXEL_PROJECTED,
    bake_coloured_texels,
    bake_irradiance,
    bake_texels,
    locate_texels,
    project_texels,
)
from isogi_core.model.lights import Colour
from isogi_core.model.scene_plan import GLOW_KIND, Layer, most_samples
from isogi_core.model.volume import CUT_AWAY_VALUE, Isovalue, Volume
from isogi_core.plan.volumes.masks import Ranges, box_left, is_within, values_beyond
from isogi_core.prepared.prepared_scene import Met, PreparedScene


def starts_at(
    points: np.ndarray,
    normals: np.ndarray,
    isovalue: float | Isovalue,
    seeds: np.ndarray,
    walls: np.ndarray | float = NO_WALL,
) -> PathStarts:
    """Make PathStarts at ``points`` with ``normals`` (g, 3), on the surface of an ``isovalue`` or
    near it.

    ``seeds`` (g,) identify the random sequences, ``walls`` (g,) the walls of the starts, none by
    default.
    """
    here, around = (np.ascontiguousarray(each.T, np.float64) for each in (points, normals))
    g = len(seeds)
    return PathStarts(
        here,
        around,
        np.full(g, float(isovalue)),
        seeds,
        np.broadcast_to(walls, g).astype(np.float64),
    )


def starts_between(starts: PathStarts, first: int, last: int) -> PathStarts:
    """Return the starts from ``first`` to ``last``."""
    return PathStarts(*(np.ascontiguousarray(each[..., first:last]) for each in starts))


def add_paths(
    met: Met,
    starts: PathStarts,
    samples: SampleRange,
    rules: PathRules,
    source: Surroundings | Glows,
    sums: np.ndarray,
) -> None:
    """Add the light of a ``source`` along a ``SampleRange`` of paths from g ``starts`` to ``sums``
    (g, channels).

    PATH_KERNELS holds the kernel for each pair of geometry ``met`` and source; its docstring
    defines the sums.
    """
    PATH_KERNELS[type(met), type(source)](met, starts, samples, rules, source, sums)


def add_path_light(
    met: Met,
    starts: PathStarts,
    samples: SampleRange,
    rules: PathRules,
    light: Surroundings,
    sums: np.ndarray,
) -> None:
    """Add the light of a ``SampleRange`` of paths from g ``starts`` on isosurfaces to ``sums`` (g,
    3).

    If matter scatters, paths start inwards; if it only refracts, they follow the normals as the
    eye's rays do.
    """
    if isinstance(met, Through):
        if met.matter.extinction > 0.0:
            wall = INWARD
        else:
            wall = ALONG_RAY
        starts = starts._replace(walls=np.full(len(starts.walls), wall))
    add_paths(met, starts, samples, rules, light, sums)


def add_glow_paths(
    prepared: PreparedScene,
    cells: ActiveCells,
    albedo: Colour,
    starts: PathStarts,
    samples: SampleRange,
    rules: PathRules,
    sums: np.ndarray,
) -> None:
    """Add the light of glowing regions of radiance 1 at g ``starts`` to ``sums`` (g, 3 k).

    The surface has this ``albedo``; it is the first one if the scene has several.
    """
    add_paths(prepared.met_by_glow(albedo, cells), starts, samples, rules, prepared.glows, sums)


NOISE_ORDER = 2
"""Lowest order of harmonics that paths are projected to, so that their noise can be estimated."""

Place = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Texels (m, 3; z, y, x) int32, their points and normals (3, m), and isovalues (m,): see
``locate_texels``.
"""

Located = tuple[Place, np.ndarray]
"""Place of texels, and which of them are void (m,): see ``locate``."""


def refine(
    light: Light,
    texels: np.ndarray,
    spec: BakeSpec,
    until: int,
    goal: Goal,
    located: Located | None = None,
) -> None:
    """Add samples to the ``light`` of the ``texels`` (m, 3; z, y, x), in place, until each has at
    least ``until`` samples, is final or is void.

    A texel is final if it is good enough for pictures with this ``goal``. It climbs nevertheless if
    one of its parts lags, see ``next_samples``. Each round finds the lowest level at which a part
    still climbs, and takes all parts at this level to the next one. Parts of a texel that climb
    together share their paths. Texels are ``located`` here unless that is given.
    """
    while True:
        # Find the texels that still climb; stop if there are none.
        waiting = next_samples(light, spec, goal)
        climbing = (waiting >= 0) & (waiting < until)
        if not climbing.any():
            return
        located = located or locate(texels, spec.prepared, spec.shown)
        # Let the texels at the lowest level climb first. Mark their parts that are at this level,
        # (parts, rows) bool.
        rows = np.flatnonzero(climbing & (waiting == waiting[climbing].min()))
        level = np.array([part.samples[rows] == waiting[rows] for part in light.parts])
        # Group the texels by the parts that are marked, so that each group shares its paths.
        for pattern in np.unique(level, axis=1).T:
            parts = tuple(part for part, climbs in zip(light.parts, pattern, strict=True) if climbs)
            climb(parts, rows[(level == pattern[:, None]).all(axis=0)], located, spec)


def next_samples(light: Light, spec: BakeSpec, goal: Goal) -> np.ndarray:
    """Return the fewest samples of any part of each texel, (texels,) int; -1 if the texel is void,
    or final without a part that lags.

    A part lags if it has fewer samples than another one of its texel, and fewer than the most that
    the ``goal`` takes: it was lost, or not written before a kill. It takes its samples once more,
    which the other parts do not need.
    """
    most = np.max([part.samples for part in light.parts], axis=0)
    lags = ~light.void & (light.samples < np.minimum(most, most_samples(goal.error)))
    return np.where(finished(light, spec, goal) & ~lags, -1, light.samples)


def climb(parts: Sequence[Part], rows: np.ndarray, located: Located, spec: BakeSpec) -> None:
    """Take ``rows`` of some parts with equal numbers of samples to the next level."""
    samples = int(parts[0].samples[rows[0]])
    total = next_level(samples)
    place, void = some_located(located, rows)
    # Trace new samples of both halves for all layers that share paths.
    for sample, some in by_sampler(parts):
        layers = [part.layer for part in some]
        sampled = sample(layers, place, void, spec, samples, total - samples)
        # Blend them into mean and noise of each part, and round as the store does.
        for part, (halves, second) in zip(some, sampled, strict=True):
            add(part, rows, halves, second, total, spec)
            part.samples[rows] = np.where(void, VOID, total)


Sampler = Callable[
    [Sequence[Layer], Place, np.ndarray, BakeSpec, int, int],
    Iterator[tuple[np.ndarray, np.ndarray]],
]
"""Function that draws samples for some layers of the same paths: layers, place, void, spec,
samples so far, and number of new ones. It yields sums as ``sample_transfer`` does.
"""


def by_sampler(parts: Sequence[Part]) -> Iterator[tuple[Sampler, list[Part]]]:
    """Group parts by their sampler: transfer layers that share harmonics, irradiance, and glow."""
    samplers: dict[str, Sampler] = {"irradiance": sample_irradiance, GLOW_KIND: sample_glow}
    if lit := [part for part in parts if part.layer.kind not in samplers]:
        yield sample_transfer, lit
    for part in parts:
        if part.layer.kind in samplers:
            yield samplers[part.layer.kind], [part]


def add(
    part: Part, rows: np.ndarray, halves: np.ndarray, second: np.ndarray, total: int, spec: BakeSpec
) -> None:
    """Add sums over new samples, the ``halves`` (m, 2, channels, N²), to the mean and the noise of
    ``rows``, which then have ``total`` samples.

    N² is at least the number of coefficients that the layer keeps; further ones only serve its
    noise (NOISE_ORDER). ``second`` (m,) are sums of squares, see ``evenness``. Mean and noise are
    rounded as the store rounds them, so that texels that are read have the same bits.
    """
    layer = part.layer
    samples = int(part.samples[rows[0]])
    added = halves.sum(axis=1)[:, :, : layer.order**2]
    # Estimate the noise of the new samples, and blend it with the noise so far.
    noise = noise_of_new(halves, second, total - samples, layer, spec)
    noise = blend_noise(part.noise[rows], samples, noise, DECAYS[layer.kind])
    part.coefficients[rows] = round_light(
        add_to_mean(part.coefficients[rows], samples, added, total), layer
    )
    part.noise[rows] = noise_of(noise_codes(noise, layer.scale), layer.scale)


def noise_of_new(
    halves: np.ndarray, second: np.ndarray, count: int, layer: Layer, spec: BakeSpec
) -> np.ndarray:
    """Estimate the noise of a layer from the sums of ``count`` new samples: see
    ``noise_of_halves``.
    """
    seen = spec.luminance_sums(halves, layer)
    if layer.order > 1 or layer.kind in ("irradiance", GLOW_KIND):
        return noise_of_halves(seen, count, layer.order)
    # If a single coefficient is kept, band 1 of the same paths makes the estimate more certain.
    even = evenness(seen.sum(axis=1) / count, second / count, count)
    return noise_of_halves(seen, count, layer.order, even)


def seeds_of(words: np.ndarray) -> np.ndarray:
    """Return the seeds of the rows of ``words`` (g, 2 or more); (g,) uint64."""
    seeds = np.empty(len(words), np.uint64)
    fill_seeds(np.ascontiguousarray(words, np.int64), seeds)
    return seeds


def some_located(located: Located, rows: np.ndarray) -> Located:
    """Return the place of the texels in some ``rows``, and which of these are void."""
    (texels, points, normals, isovalues), void = located
    points, normals = (np.ascontiguousarray(v[:, rows]) for v in (points, normals))
    return (texels[rows], points, normals, isovalues[rows]), void[rows]


def locate(texels: np.ndarray, prepared: PreparedScene, shown: Isovalue | None = None) -> Located:
    """Find the points, in index space, that texels are lit at, and which texels are void (m,).

    Points are the texels themselves, each on its own isosurface, or the rim of a plateau that they
    lie on. If ``shown`` is given, they are projected onto that isosurface; texels that cannot be
    projected are void then (see ``project_texels``).
    """
    m = len(texels)
    void = np.empty(m, np.bool_)
    place = (
        np.ascontiguousarray(texels, np.int32),
        np.empty((3, m)),
        np.empty((3, m)),
        np.empty(m),
    )
    if shown is None:
        locate_texels(prepared.field, prepared.step, *place, void)
        return place, void
    # Projected texels lie on the isosurface that is shown, all at one isovalue.
    verdicts = np.empty(m, np.uint8)
    project_texels(prepared.field, prepared.step, shown, *place[:3], verdicts)
    place[3][:] = shown
    return place, verdicts != TEXEL_PROJECTED


def sample_transfer(
    layers: Sequence[Layer],
    place: Place,
    void: np.ndarray,
    spec: BakeSpec,
    samples: int,
    count: int,
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield sums over ``count`` samples after the first ``samples``, of the same paths for all
    ``layers``.

    For each layer these are sums of harmonics for both halves, (m, 2, channels, N²) float64, and
    band 0 of the squares of the paths' light, over both halves, (m,).
    """
    # Project each channel to its order, and the squares of each layer to band 0.
    orders = np.repeat(
        [max(layer.order, NOISE_ORDER) for layer in layers], [layer.channels for layer in layers]
    )
    orders = np.append(orders, np.ones(len(layers), np.int64))
    sums = np.zeros((len(void), 2, len(orders), int(orders.max()) ** 2))
    sample = (sample_colours if spec.coloured else sample_greys)(layers, orders, spec)
    # Trace texels of near isovalues together, as they share an active-cell map.
    for bricks, rows in by_isovalue(place[3], void, spec.prepared):
        sample(bricks, place, rows, SampleRange(samples // 2, count // 2), sums)
    first = 0
    for number, layer in enumerate(layers):
        halves = sums[:, :, first : first + layer.channels, : max(layer.order, NOISE_ORDER) ** 2]
        yield halves, sums[:, :, number - len(layers), 0].sum(axis=1)
        first += layer.channels


Sample = Callable[[ActiveCells, Place, np.ndarray, SampleRange, np.ndarray], None]
"""Function that adds transfer of some rows to the sums: map, place, rows, samples, sums."""


def sample_greys(layers: Sequence[Layer], orders: np.ndarray, spec: BakeSpec) -> Sample:
    """Return the sampler of a surface with one albedo.

    The weight of a path follows from the number of its bounces, so that paths carry no colours. The
    tables of weights are computed once for all groups of texels: a row for each channel of the
    ``layers``, then one for the square of each layer's luminance.
    """
    counts = np.vstack([spec.shares(layers), spec.squares(layers)])
    plan = spec.plan
    rules = TransferRules(counts, plan.survival, plan.branches)

    def _sample(
        bricks: ActiveCells, place: Place, rows: np.ndarray, some: SampleRange, sums: np.ndarray
    ) -> None:
        bake_texels(spec.prepared.field, bricks, place, rows, some, rules, orders, sums)

    return _sample


def sample_colours(layers: Sequence[Layer], orders: np.ndarray, spec: BakeSpec) -> Sample:
    """Return the sampler of a surface whose albedo varies with data: its paths carry the product
    of the albedos that they meet.
    """
    rules = spec.coloured_rules(layers, orders)

    def _sample(
        bricks: ActiveCells, place: Place, rows: np.ndarray, some: SampleRange, sums: np.ndarray
    ) -> None:
        bake_coloured_texels(
            spec.prepared.field, bricks, spec.prepared.colours, place, rows, some, rules, sums
        )

    return _sample


def sample_irradiance(
    layers: Sequence[Layer],
    place: Place,
    void: np.ndarray,
    spec: BakeSpec,
    samples: int,
    count: int,
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield sums of the irradiance of fixed light, over both halves of ``count`` samples after the
    first ``samples``, and zeros in place of squares.

    Squares serve layers of harmonics alone: see ``noise_of_new``. The environment is as the scene
    has it, unturned. Sums have three channels; a layer with one channel takes the first of three
    equal ones.
    """
    prepared = spec.prepared
    sums = np.zeros((len(void), 2, 3))
    bounces = spec.plan.bounces
    around = prepared.surroundings(np.eye(3))
    some = SampleRange(samples // 2, count // 2)
    rules = PathRules(
        np.broadcast_to(start_weights(layers[0], spec), (bounces + 1, 3)).copy(), spec.plan.survival
    )
    # Trace texels of near isovalues together; a surface alone in the open has a faster kernel.
    for bricks, rows in by_isovalue(place[3], void, prepared):
        met = prepared.met(prepared.scene.surfaces.albedo, bricks)
        if isinstance(met, Open):
            bake_irradiance(prepared.field, bricks, place, rows, some, rules, around, sums)
            continue
        added = np.zeros((2 * len(rows), 3))
        add_path_light(met, path_starts(place, rows), some, rules, around, added)
        sums[rows] += added.reshape(-1, 2, 3)
    for layer in layers:
        yield sums[:, :, : layer.channels, None], np.zeros(len(void))


def start_weights(layer: Layer, spec: BakeSpec) -> np.ndarray:
    """Return the path weights of a ``layer``.

    Light from within a scattering material is kept divided by the albedo, as frames multiply by it.
    """
    scene = spec.prepared.scene
    if scene.surfaces.material.scatters:
        return 1.0 / np.array(scene.surfaces.albedo)
    return spec.weights(layer)


def sample_glow(
    layers: Sequence[Layer],
    place: Place,
    void: np.ndarray,
    spec: BakeSpec,
    samples: int,
    count: int,
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield sums of the light of each glowing region of radiance 1, its channels side by side."""
    prepared = spec.prepared
    plan = spec.plan
    some = SampleRange(samples // 2, count // 2)
    # The kernel multiplies by albedos along the path: of the weights only their number counts.
    rules = PathRules(np.ones((plan.bounces + 1, 3)), plan.survival)
    sums = np.zeros((len(void), 2, 3 * len(prepared.glows.rates)))
    for bricks, rows in by_isovalue(place[3], void, prepared):
        added = np.zeros((2 * len(rows), sums.shape[2]))
        starts = path_starts(place, rows)
        add_glow_paths(prepared, bricks, prepared.scene.surfaces.albedo, starts, some, rules, added)
        sums[rows] += added.reshape(-1, 2, sums.shape[2])
    for layer in layers:
        yield sums[:, :, :: 3 // layer.colours, None], np.zeros(len(void))


def path_starts(place: Place, rows: np.ndarray) -> PathStarts:
    """Make the PathStarts of both halves of the texels in some ``rows`` of a place."""
    texels, points, normals, isovalues = place
    # Each texel starts two independent randomisations, seeded by its place and the number of the
    # half.
    both = np.repeat(rows, 2)
    seeds = seeds_of(np.column_stack([texels[both], np.tile([0, 1], len(rows))]))
    here, around = (np.ascontiguousarray(each[:, both]) for each in (points, normals))
    return PathStarts(here, around, isovalues[both], seeds, np.full(len(both), NO_WALL))


def by_isovalue(
    isovalues: np.ndarray, void: np.ndarray, prepared: PreparedScene
) -> Iterator[tuple[ActiveCells, np.ndarray]]:
    """Yield rows that are not void in groups of near isovalues, each with the map of its
    isosurfaces.

    Rows keep their order in space within a group: sorted by isovalue, paths took a twentieth
    longer.
    """
    # Group lit texels by isovalue, and give each group a map that covers it.
    lit = np.flatnonzero(~void)
    groups, spans = prepared.maps.groups(isovalues[lit])
    for group in np.unique(groups):
        yield prepared.maps.covering(spans[group]), lit[groups == group]


def add_to_mean(mean: np.ndarray, samples: int, added: np.ndarray, total: int) -> np.ndarray:
    """Return the mean over ``total`` samples, from a mean over ``samples`` and the sum of the
    new ones; float64.
    """
    return (mean.astype(np.float64) * samples + added) / total


KEEPABLE_KINDS = frozenset(("direct", "indirect", "whole"))
"""Kinds of layers whose light a cut may keep: their paths meet one surface and nothing else."""


def keeps(spec: BakeSpec) -> bool:
    """Return True if light of a ``spec`` of a whole volume may be kept if the volume is cut."""
    return (
        spec.shown is None
        and spec.kinds <= KEEPABLE_KINDS
        and bool(spec.prepared.field.low.min() >= CUT_AWAY_VALUE)
    )


@dataclass(frozen=True, eq=False)
class Remains:
    """The part of a volume that a cut leaves: the ``box`` of ``box_left``, and the range of
    values ``beyond`` it.
    """

    box: np.ndarray
    beyond: tuple[float, float]

    @classmethod
    def of(cls, volume: Volume, left: Ranges) -> Self:
        """Describe the rest of a ``volume`` of which the voxels ``left`` remain."""
        box = box_left(left, volume.size)
        return cls(box, values_beyond(volume, box))


def find_kept(texels: np.ndarray, whole: BakeSpec, remains: Remains) -> np.ndarray:
    """Return which of the ``texels`` (m, 3; z, y, x) keep their light in a cut of a ``whole``
    volume; (m,) bool.

    A texel keeps it if it and its point lie in the box that is left, and if the isosurface of the
    texel does not exist outside of the box, so that no path can have met it there.
    """
    prepared = whole.prepared
    place, _ = locate(texels, prepared)
    positions = texels[:, ::-1] * prepared.step
    within = is_within(positions, remains.box) & is_within(place[1].T, remains.box)
    lowest, highest = remains.beyond
    return within & ((place[3] < lowest) | (place[3] > highest))
