"""Refinement: more samples for texels that need them, added to what is there.

Sample counts climb from level to level (16, 32, 64, …). After each one all that is kept is rounded
to what the store keeps, so that a texel with n samples has the same bits for any number of workers
and goes. Which parts of a texel climb next follows from what is kept of it alone.

Light that a cut leaves as it is: of texels no path of which met what is taken away. All their paths
meet the same points as before, so that their sums, and all that is kept of these, have the same
bits.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from isogi_core.bake.bake_spec import BakeSpec
from isogi_core.bake.noise import DECAYS, blend_noise, evenness, finished, noise_of_halves
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
    Confines,
    bake_coloured_texels,
    bake_irradiance,
    bake_texels,
    find_strays,
    locate_texels,
    project_texels,
)
from isogi_core.model.lights import Colour
from isogi_core.model.scene_plan import GLOW_KIND, MAX_SAMPLES, Layer, most_samples
from isogi_core.model.volume import Isovalue, Volume
from isogi_core.plan.volumes.masks import CUT_AWAY_VALUE, Ranges, box_left, is_within, values_beyond
from isogi_core.prepared.prepared_scene import Met, PreparedScene


def starts_at(
    points: np.ndarray,
    normals: np.ndarray,
    isovalue: float | Isovalue,
    seeds: np.ndarray,
    walls: np.ndarray | float = NO_WALL,
) -> PathStarts:
    """Starts of paths at ``points`` with ``normals`` (g, 3), on the surface of this ``isovalue`` or
    about it.

    ``seeds`` (g,) are of the sequences that paths draw from, ``walls`` (g,) the numbers of walls:
    none by default.
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
    """Starts number ``first`` … ``last`` of some ``starts``."""
    return PathStarts(*(np.ascontiguousarray(each[..., first:last]) for each in starts))


def add_paths(
    met: Met,
    starts: PathStarts,
    samples: SampleRange,
    rules: PathRules,
    source: Surroundings | Glows,
    sums: np.ndarray,
) -> None:
    """Add what a ``SampleRange`` of paths gathers of a ``source`` at g ``starts`` to ``sums`` (g,
    channels).

    The kernel of PATH_KERNELS for what is ``met`` and gathered does so, and says how.
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
    """Add what a ``SampleRange`` of paths brings to g ``starts`` on isosurfaces to ``sums`` (g, 3).

    Where matter scatters, paths start inwards; where it does not, the eye's rays do, along the
    normals.
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
    """Add what a ``SampleRange`` of paths gathers of what glows, of radiance 1, at g ``starts`` to
    ``sums`` (g, 3 k).

    The surface has this ``albedo``, and is the first of several where there are others.
    """
    add_paths(prepared.met_by_glow(albedo, cells), starts, samples, rules, prepared.glows, sums)


NOISE_ORDER = 2
"""The least order that paths are projected to, so that their noise can be estimated."""

Place = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Texels (m, 3; z, y, x) int32, their points and normals (3, m) and isovalues (m,): see
``locate_texels``.
"""

Located = tuple[Place, np.ndarray]
"""Where texels are lit, and which of them are void (m,): see ``locate``."""


def refine(
    light: Light,
    texels: np.ndarray,
    spec: BakeSpec,
    until: int,
    target: float,
    located: Located | None = None,
) -> None:
    """Bring ``light`` of the ``texels`` (m, 3; z, y, x) up to ``until`` samples each, in place.

    A texel that is final in pictures of the relative error ``target``, and whose parts are level,
    is left as it is. Of the others those parts climb that have the fewest samples: parts at one
    level do so together, since the same paths serve them. They are ``located`` here where that was
    not done before.
    """
    while True:
        waiting = next_samples(light, spec, target)
        climbing = (waiting >= 0) & (waiting < until)
        if not climbing.any():
            return
        located = located or locate(texels, spec.prepared, spec.shown)
        rows = np.flatnonzero(climbing & (waiting == waiting[climbing].min()))
        level = np.array([part.samples[rows] == waiting[rows] for part in light.parts])
        for pattern in np.unique(level, axis=1).T:
            parts = tuple(part for part, climbs in zip(light.parts, pattern, strict=True) if climbs)
            climb(parts, rows[(level == pattern[:, None]).all(axis=0)], located, spec)


def next_samples(
    light: Light, spec: BakeSpec, target: float, enough: int = MAX_SAMPLES
) -> np.ndarray:
    """Samples of the parts of each texel that climb next; -1 where the texel is finished and none
    lags; (texels,) int.

    A part that was lost, or not written before a kill, catches up with the others, and so has the
    samples it had. That costs all of its paths once more, which are of no use to the parts that did
    not lag.
    """
    most = np.max([part.samples for part in light.parts], axis=0)
    lags = ~light.void & (light.samples < np.minimum(most, most_samples(target)))
    return np.where(finished(light, spec, target, enough) & ~lags, -1, light.samples)


def climb(parts: Sequence[Part], rows: np.ndarray, located: Located, spec: BakeSpec) -> None:
    """Take ``rows`` of some parts, all with as many samples, to the next level."""
    samples = int(parts[0].samples[rows[0]])
    total = next_level(samples)
    place, void = some_located(located, rows)
    for sample, some in by_sampler(parts):
        layers = [part.layer for part in some]
        sampled = sample(layers, place, void, spec, samples, total - samples)
        for part, (halves, second) in zip(some, sampled, strict=True):
            add(part, rows, halves, second, total, spec)
            part.samples[rows] = np.where(void, VOID, total)


Sampler = Callable[
    [Sequence[Layer], Place, np.ndarray, BakeSpec, int, int],
    Iterator[tuple[np.ndarray, np.ndarray]],
]
"""Draws samples for some layers: see ``sample_transfer``."""


def by_sampler(parts: Sequence[Part]) -> Iterator[tuple[Sampler, list[Part]]]:
    """Some parts by who samples them: those that the same harmonics serve, irradiance, and what
    glows.
    """
    own: dict[str, Sampler] = {"irradiance": sample_irradiance, GLOW_KIND: sample_glow}
    if lit := [part for part in parts if part.layer.kind not in own]:
        yield sample_transfer, lit
    for part in parts:
        if part.layer.kind in own:
            yield own[part.layer.kind], [part]


def add(
    part: Part, rows: np.ndarray, halves: np.ndarray, second: np.ndarray, total: int, spec: BakeSpec
) -> None:
    """Add sums over new samples (m, 2, channels, N²; N² >= n²) to ``rows``, which then have
    ``total`` samples.

    ``second`` (m,) are those of the squares, see ``evenness``.
    """
    layer = part.layer
    samples = int(part.samples[rows[0]])
    added = halves.sum(axis=1)[:, :, : layer.order**2]
    noise = noise_of_new(halves, second, total - samples, layer, spec)
    noise = blend_noise(part.noise[rows], samples, noise, DECAYS[layer.kind])
    part.coefficients[rows] = round_light(
        add_to_mean(part.coefficients[rows], samples, added, total), layer
    )
    part.noise[rows] = noise_of(noise_codes(noise, layer.scale), layer.scale)


def noise_of_new(
    halves: np.ndarray, second: np.ndarray, count: int, layer: Layer, spec: BakeSpec
) -> np.ndarray:
    """The noise of a layer, estimated from the sums of ``count`` new samples; see
    ``noise_of_halves``.
    """
    seen = spec.judged(halves, layer)
    if layer.order > 1 or layer.kind in ("irradiance", GLOW_KIND):
        return noise_of_halves(seen, count, layer.order)
    even = evenness(seen.sum(axis=1) / count, second / count, count)
    return noise_of_halves(seen, count, layer.order, even)


def seeds_of(words: np.ndarray) -> np.ndarray:
    """The sequences that belong to rows of ``words`` (g, 2 or more); (g,) uint64."""
    seeds = np.empty(len(words), np.uint64)
    fill_seeds(np.ascontiguousarray(words, np.int64), seeds)
    return seeds


def some_located(located: Located, rows: np.ndarray) -> Located:
    """Where the texels in some ``rows`` are located."""
    (texels, points, normals, isovalues), void = located
    points, normals = (np.ascontiguousarray(v[:, rows]) for v in (points, normals))
    return (texels[rows], points, normals, isovalues[rows]), void[rows]


def locate(texels: np.ndarray, prepared: PreparedScene, shown: Isovalue | None = None) -> Located:
    """Where texels are lit, and which of them are void (m,).

    On the isosurfaces through their own points, or projected onto the one that is ``shown``: void
    are then those that cannot be projected, see ``project_texels``.
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
    """Sums over ``count`` samples after the first ``samples``, of the same paths for all
    ``layers``.

    Harmonics of the ways that paths leave: for each layer, and each half of them, (m, 2, channels,
    N²) float64; and band 0 of the squares of what paths bring, of both halves, (m,).
    """
    orders = np.repeat(
        [max(layer.order, NOISE_ORDER) for layer in layers], [layer.channels for layer in layers]
    )
    orders = np.append(orders, np.ones(len(layers), np.int64))
    sums = np.zeros((len(void), 2, len(orders), int(orders.max()) ** 2))
    sample = (sample_colours if spec.coloured else sample_greys)(layers, orders, spec)
    for bricks, rows in by_isovalue(place[3], void, spec.prepared):
        sample(bricks, place, rows, SampleRange(samples // 2, count // 2), sums)
    first = 0
    for number, layer in enumerate(layers):
        halves = sums[:, :, first : first + layer.channels, : max(layer.order, NOISE_ORDER) ** 2]
        yield halves, sums[:, :, number - len(layers), 0].sum(axis=1)
        first += layer.channels


Sample = Callable[[ActiveCells, Place, np.ndarray, SampleRange, np.ndarray], None]
"""Adds what paths from some rows bring to the sums: map, place, rows, samples, sums."""


def sample_greys(layers: Sequence[Layer], orders: np.ndarray, spec: BakeSpec) -> Sample:
    """The paths of a surface with one albedo, whose weights are worked out once for all groups of
    texels.
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
    """How the transfer of texels is sampled on a surface with colours by data."""
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
    """Samples of the light that paths meet, without squares; where a layer keeps one channel, all
    three are alike.
    """
    prepared = spec.prepared
    sums = np.zeros((len(void), 2, 3))
    bounces = spec.plan.bounces
    around = prepared.surroundings(np.eye(3))
    some = SampleRange(samples // 2, count // 2)
    rules = PathRules(
        np.broadcast_to(start_weights(layers[0], spec), (bounces + 1, 3)).copy(), spec.plan.survival
    )
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
    """What counts of the light that paths of a ``layer`` bring; of what comes from inside a
    surface, B/π over the albedo, by which frames multiply it.
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
    """Samples of what glows, one glow's channels after the other's, each of radiance 1."""
    prepared = spec.prepared
    plan = spec.plan
    some = SampleRange(samples // 2, count // 2)
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
    """Where paths start, of both halves of the texels in these ``rows`` of a place."""
    texels, points, normals, isovalues = place
    both = np.repeat(rows, 2)
    seeds = seeds_of(np.column_stack([texels[both], np.tile([0, 1], len(rows))]))
    here, around = (np.ascontiguousarray(each[:, both]) for each in (points, normals))
    return PathStarts(here, around, isovalues[both], seeds, np.full(len(both), NO_WALL))


def by_isovalue(
    isovalues: np.ndarray, void: np.ndarray, prepared: PreparedScene
) -> Iterator[tuple[ActiveCells, np.ndarray]]:
    """The rows that are not void in groups of near isovalues, each with the map of its isosurfaces.

    Within a group they stay as they lie in space: sorted by isovalue, paths took a twentieth
    longer.
    """
    lit = np.flatnonzero(~void)
    groups, spans = prepared.maps.groups(isovalues[lit])
    for group in np.unique(groups):
        yield prepared.maps.covering(spans[group]), lit[groups == group]


def add_to_mean(mean: np.ndarray, samples: int, added: np.ndarray, total: int) -> np.ndarray:
    """The mean over ``total`` samples of an old mean over ``samples`` and the sum of the new ones,
    float64.
    """
    return (mean.astype(np.float64) * samples + added) / total


KEEPABLE_KINDS = frozenset(("direct", "indirect", "whole"))
"""The kinds of layers whose light a cut may leave as it is: their paths meet one surface, and
nothing else.
"""


def keeps(spec: BakeSpec) -> bool:
    """Whether light of a ``spec`` of a whole volume may stay where that is cut."""
    return (
        spec.shown is None
        and spec.kinds <= KEEPABLE_KINDS
        and bool(spec.prepared.field.low.min() >= CUT_AWAY_VALUE)
    )


@dataclass(frozen=True, eq=False)
class Remains:
    """What a cut leaves: the ``box`` of ``box_left``, and the least and the greatest value
    ``beyond`` it.
    """

    box: np.ndarray
    beyond: tuple[float, float]

    @classmethod
    def of(cls, volume: Volume, left: Ranges) -> Self:
        """What is left where of a ``volume`` some voxels are."""
        box = box_left(left, volume.size)
        return cls(box, values_beyond(volume, box))


def find_kept(
    light: Light, texels: np.ndarray, whole: BakeSpec, remains: Remains, walks: bool
) -> np.ndarray:
    """Which of the ``texels`` (m, 3; z, y, x) keep their ``light`` where a cut of a ``whole``
    volume ``remains``.

    (m,) bool: those whose place, and all points that paths met so far, are far from what is taken
    away. Where nothing of their isosurface is there, no path can have met it. Paths of others are
    walked once more, but those of a texel end with the first that met something there. Without
    ``walks`` these are left out.
    """
    prepared = whole.prepared
    box = remains.box
    place, _ = locate(texels, prepared)
    kept = is_within(texels[:, ::-1] * prepared.step, box) & is_within(place[1].T, box)
    may_stray = (place[3] >= remains.beyond[0]) & (place[3] <= remains.beyond[1])
    if not walks:
        return kept & ~may_stray
    for some, samples, bounces in walks_of(light.parts, whole.plan.bounces):
        rows = kept & some & may_stray & ~light.void
        confines = Confines(bounces, whole.plan.survival, whole.plan.branches, box)
        kept &= ~strays_of(place, rows, whole, samples, confines)
    return kept


def walks_of(parts: Sequence[Part], bounces: int) -> Iterator[tuple[np.ndarray, SampleRange, int]]:
    """The paths that some ``parts`` took: which texels (m,) bool, their samples in each half, and
    their bounces.

    Those of parts without reflected light end with their first ray.
    """
    first = 0
    most = max((int(part.samples.max(initial=0)) for part in parts), default=0)
    while first < most:
        last = next_level(first)
        some = SampleRange(first // 2, (last - first) // 2)
        long, short = (took(parts, last, reflected) for reflected in (True, False))
        yield long, some, bounces
        yield short & ~long, some, 0
        first = last


def took(parts: Sequence[Part], samples: int, reflected: bool) -> np.ndarray:
    """Which texels took so many ``samples`` in any of the parts with ``reflected`` light, or
    without; (m,) bool.
    """
    own = [part.samples >= samples for part in parts if part.layer.reflected == reflected]
    return np.logical_or.reduce([np.zeros(len(parts[0].samples), np.bool_), *own])


def strays_of(
    place: Place, rows: np.ndarray, spec: BakeSpec, samples: SampleRange, confines: Confines
) -> np.ndarray:
    """Which of some ``rows`` (m,) bool have a path among these ``samples`` that met something
    beyond ``confines``.
    """
    strays = np.zeros(len(rows), np.bool_)
    for cells, own in by_isovalue(place[3], ~rows, spec.prepared):
        find_strays(spec.prepared.field, cells, place, own, samples, confines, strays)
    return strays
