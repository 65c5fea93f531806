"""Shine: rays of a microfacet lobe from the points of a picture, and the light at their ends.

A shiny surface mirrors light to the eye alone; light that it sends to other places of the scene is
diffuse, as texels have it. So shine needs no bake, and a ray takes the light of the surface that it
meets from texels, or from paths that start there.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import count

import numpy as np

from isogi_core.bake.bake_spec import path_weights
from isogi_core.bake.refine import add_paths, seeds_of, starts_at, starts_between
from isogi_core.files.vector import triple
from isogi_core.frame.gbuffer import GBuffer, OtherPoints
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.point_paths import add_glow
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.shine import (
    MET_ISOSURFACE,
    MET_NOTHING,
    ShineDraws,
    ShineEnds,
    cast_shine,
    fill_below,
)
from isogi_core.kernels.shading.surface_points import SurfacePoints
from isogi_core.kernels.tracing.camera import NO_WALLS
from isogi_core.kernels.tracing.walls import NO_WALL
from isogi_core.kernels.transport import streams
from isogi_core.kernels.transport.colours import NO_COLOURS, fill_albedos
from isogi_core.kernels.transport.light_paths import Open
from isogi_core.kernels.transport.lights import AREA, DIRECTIONAL, LampArrays
from isogi_core.kernels.transport.microfacets import ENERGY_STEPS, ShineLobe, fill_energy
from isogi_core.kernels.transport.paths import PathRules, SampleRange
from isogi_core.kernels.transport.ray_lights import Discs, Panels, ShineLights
from isogi_core.kernels.transport.room_paths import Room
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.model.material import DULL
from isogi_core.model.view import View
from isogi_core.plan.budget import survival_for

PLASTIC = 0.04
"""Reflectance of plastic head on: Fresnel's ((n - 1)/(n + 1))² for an index of refraction of
1.5.
"""

TOWARDS_LIGHTS = 0.5
ROUGH = 0.4
"""Share of the rays that are drawn towards lights from this roughness on. Smoother lobes have a
smaller share, as their rays find lights better.
"""

WAYS = 8
"""Candidates of which each ray is chosen if there are lights to aim at: one ray then tells as
much as several.
"""

LOW_WORD = np.uint64(0xFFFFFFFF)
"""Bits of the sequence of a ray that become the sequence of the path from its end, if the path
is in the open.
"""

RAYS_TOGETHER = 1 << 14
PATHS_TOGETHER = 256
RAYS_OF_PATHS = 1 << 17
"""Rays that are cast together; paths that are traced together from their ends; and rays whose
ends are kept together if all of them send paths.
"""

NO_ROOM = Room(
    NO_WALLS,
    *(np.empty((0, 3)), np.empty((0, 2, 3)), np.empty((0, 3)), np.empty(0)),
    *(np.empty((0, 3)), np.empty((0, 3)), np.empty(0), np.zeros(3)),
    NO_COLOURS,
)
"""No walls about the isosurface."""


@lru_cache(maxsize=64)
def energy_of(alpha: float) -> np.ndarray:
    """Return the table of ``fill_energy`` for a lobe's ``alpha``."""
    energy = np.empty((ENERGY_STEPS + 1, 2))
    fill_energy(alpha, energy)
    return energy


def lobe_of(light: RotatedLight) -> ShineLobe:
    """Return the lobe of the surface under a ``light``; metal mirrors by its albedo. A surface
    without shine has a lobe that mirrors nothing.
    """
    shine = light.shine or DULL
    albedo = light.albedo
    metal = shine.kind == "metal"
    towards_lights = TOWARDS_LIGHTS * min(1.0, shine.roughness / ROUGH)
    # The colour that is mirrored head on.
    if metal:
        facing = triple(albedo)
    else:
        facing = triple(np.full(3, PLASTIC))
    energy = energy_of(shine.alpha)
    return ShineLobe(shine.alpha, facing, shine.strength, metal, towards_lights, energy)


def lights_of(light: RotatedLight, ways: int) -> ShineLights:
    """Return the lights that rays of shine may be drawn towards, and those that they may meet,
    under a rotated ``light``. Each ray is chosen of ``ways`` candidates.
    """
    around = light.surroundings
    room = light.spec.prepared.scene.lighting.room
    kinds, places, edges, colours = around.lamps
    # Sort the lamps: discs of lobes, areas, and those without an extent.
    discs = (kinds == DIRECTIONAL) & edges.any(axis=(1, 2))
    flat = kinds == AREA
    sharp = (kinds != AREA) & ~discs
    squares = (edges[discs, 0] ** 2).sum(axis=1)[:, None]
    luminous = np.array([any(wall.radiance) for wall in room.walls], bool)
    twofold = np.array([wall.sides == 2 for wall in room.walls], np.float64)[luminous]
    radiances = np.array([wall.radiance for wall in room.walls], np.float64).reshape(-1, 3)
    # Areas and luminous walls are panels. The radiance of an area is π times its colour.
    panels = Panels(
        np.concatenate([places[flat], room.corners[luminous]]),
        np.concatenate([edges[flat], room.edges[luminous]]),
        np.concatenate([np.pi * colours[flat], radiances[luminous]]),
        np.concatenate([np.zeros(int(flat.sum())), twofold]),
        np.concatenate([np.ones(int(flat.sum())), np.zeros(int(luminous.sum()))]),
    )
    lamps = LampArrays(kinds[sharp], places[sharp], edges[sharp], colours[sharp])
    far = Discs(places[discs], edges[discs], colours[discs] / squares)
    # If there is no light to aim at, all candidates are alike, and one is enough.
    if not (len(around.table.rows) or len(panels.corners) or len(far.towards)):
        ways = 1
    # Rays that end on a surface are expected to bring the mean radiance of the environment.
    ambient = max(float(light.mean @ LUMINANCE_WEIGHTS), 1e-30)
    return ShineLights(around._replace(lamps=lamps), panels, far, ambient, ways)


def light_below(light: RotatedLight, gbuffer: GBuffer, tiles: Tiles) -> np.ndarray:
    """Return the share of diffuse light that shine leaves at each point of a G-buffer; (m, 3)
    float32. Raises Cancelled.
    """
    lobe = lobe_of(light)
    shown = gbuffer.shown(tiles)
    below = np.empty_like(shown.points)

    def _piece(a: int, b: int) -> None:
        fill_below(shown.part(slice(a, b)), gbuffer.eye, gbuffer.spacing, lobe, below[a:b])

    tiles.run(_piece, len(below), RAYS_TOGETHER)
    return below


@dataclass(frozen=True, eq=False)
class ShineRays:
    """Rays of shine from the points of a G-buffer, ``each`` from every point, in order.

    - ``brought`` (rays, 3): light that rays bring by themselves.
    - ``ends``: ends of the h rays that meet the surface or a wall, ascending.
    - ``seeds`` (h,): random sequences of paths from these ends.
    - ``hits``: a picture of one row that shows these ends.
    - ``number``: number of that picture, so that a cache tells it from others.
    """

    each: int
    brought: np.ndarray
    ends: ShineEnds
    seeds: np.ndarray
    hits: GBuffer
    number: int

    @property
    def nbytes(self) -> int:
        """The size of its arrays in bytes."""
        ends = (self.brought, self.ends.weights, *self.ends.points, self.ends.met, self.seeds)
        return sum(each.nbytes for each in ends) + self.hits.nbytes

    @property
    def seen(self) -> np.ndarray:
        """The numbers of the rays that meet the surface or a wall; (h,) uint32."""
        return np.asarray(self.ends.points.pixels)

    def view(self, view: View) -> View:
        """Return a view of ``hits``, diffuse and moving; all else is of the ``view`` that the
        rays start from.
        """
        row = replace(
            view, width=max(len(self.seen), 1), height=1, strip=(self.number, self.number + 1)
        )
        return replace(row, moving=True, smooth=False, shine=DULL)

    def gather(self, light: np.ndarray) -> np.ndarray:
        """Return the light of each ray, if ``light`` (h, 3) leaves the points at their ends;
        (points, each, 3) float64.
        """
        total = self.brought.astype(np.float64)
        total[self.seen] += self.ends.weights * light.astype(np.float64)
        return total.reshape(-1, self.each, 3)


NUMBERS = count()
"""Numbers of pictures, all different."""


def room_of(light: RotatedLight) -> Room:
    """Return the walls about a surface with its colours, or of the albedo of the view."""
    prepared = light.spec.prepared
    if prepared.scene.many_albedos:
        return prepared.room(light.seen.albedo)
    return NO_ROOM


def cast_rays(
    light: RotatedLight,
    gbuffer: GBuffer,
    replicas: range,
    samples: range,
    tiles: Tiles,
    ways: int = WAYS,
) -> ShineRays:
    """Cast rays of shine from each point of a G-buffer: the ``samples`` of each of the
    ``replicas``.

    Replicas are numbers of independent randomisations. Each ray is chosen of ``ways`` candidates,
    in proportion to the light that each is expected to bring. Raises Cancelled.
    """
    shown = gbuffer.shown(tiles)
    lobe = lobe_of(light)
    lights = lights_of(light, ways)
    room = room_of(light)
    traced = gbuffer.surface.traced(tiles.run)
    each = len(replicas) * len(samples)
    total = each * len(shown.pixels)
    brought, weights, here, around = np.empty((4, total, 3), np.float32)
    points = SurfacePoints(here, around, np.arange(total, dtype=np.uint32))
    ends = ShineEnds(brought, weights, points, np.empty(total, np.int8))

    # Cast the rays of points a to b: by one random sequence for each pixel and replica, of which
    # each sample is an element.
    def _piece(a: int, b: int) -> None:
        some = shown.part(slice(a, b))
        rays = slice(a * each, b * each)
        point, replica, sample = (
            part.ravel() for part in np.indices((b - a, len(replicas), len(samples)))
        )
        stream = streams.SHINE_STREAM + replicas.start + replica
        seeds = seeds_of(np.column_stack([some.pixels[point], stream]))
        draws = ShineDraws(point, seeds, samples.start + sample)
        cast_shine(traced, room, some, gbuffer.eye, lobe, lights, draws, some_of(ends, rays))

    count = len(shown.pixels)
    tiles.run(_piece, count, max(min(RAYS_TOGETHER // each, tiles.even(count)), 1))
    # Keep the ends on surfaces and walls, whose light is still to be found. A path from there may
    # be traced later, so each has a random sequence: it follows from pixel, replica and sample.
    seen = np.flatnonzero(ends.met > MET_NOTHING)
    point, rest = np.divmod(seen, each)
    replica, sample = np.divmod(rest, len(samples))
    stream = streams.SHINE_STREAM + replicas.start + replica
    seeds = seeds_of(np.column_stack([shown.pixels[point], stream, samples.start + sample]))
    kept = some_of(ends, seen)
    return ShineRays(each, brought, kept, seeds, seen_by(kept, gbuffer), next(NUMBERS))


def some_of(ends: ShineEnds, rows: slice | np.ndarray) -> ShineEnds:
    """Return the ``ends`` of some rays."""
    return ShineEnds(ends.brought[rows], ends.weights[rows], ends.points.part(rows), ends.met[rows])


def seen_by(ends: ShineEnds, gbuffer: GBuffer) -> GBuffer:
    """Return a G-buffer of one row that shows the ``ends`` of rays."""
    met = ends.met
    on = ends.met == MET_ISOSURFACE
    shown = ends.points._replace(pixels=np.arange(len(met), dtype=np.uint32))
    walls = OtherPoints(shown.pixels[~on], shown.points[~on], met[~on])
    row = GBuffer.of_points(gbuffer.surface, gbuffer.eye, shown.points)
    return row.of_these(shown.part(on), walls)


def paths_from(
    rays: ShineRays, rows: np.ndarray, light: RotatedLight, bounces: int, tiles: Tiles
) -> np.ndarray:
    """Trace one path of ``bounces`` bounces from each end in ``rows`` (k,) of the rays; return the
    light that leaves there, (k, 3) float64.

    Raises Cancelled.
    """
    traced = rays.hits.surface.traced(tiles.run)
    ends = some_of(rays.ends, rows)
    points = ends.points
    on_surface = ends.met == MET_ISOSURFACE
    walls = np.where(on_surface, NO_WALL, ends.met)
    starts = starts_at(points.points, points.normals, traced.isovalue, rays.seeds[rows], walls)
    survival = survival_for(light.reflecting, bounces)
    met = light.spec.prepared.met(light.seen.albedo, traced.cells, tiles.run)
    one = SampleRange(0, 1)
    # Paths of glow, and paths among walls or colours, carry the albedos that they meet. Paths in
    # the open have sequences of their own, and the albedo's powers as weights.
    glow_rules = PathRules(path_weights(np.ones(3), bounces, 1.0), survival)
    light_starts = starts
    light_rules = glow_rules
    if isinstance(met, Open):
        words = np.column_stack(
            [(starts.seeds & LOW_WORD).astype(np.int64), np.full(len(rows), streams.SHINE_STREAM)]
        )
        light_starts = starts._replace(seeds=seeds_of(words))
        light_rules = PathRules(path_weights(light.albedo, bounces, survival), survival)
    arrived = np.zeros((len(rows), 3))

    def _piece(a: int, b: int) -> None:
        some = starts_between(light_starts, a, b)
        add_paths(met, some, one, light_rules, light.surroundings, arrived[a:b])
        add_glow(arrived[a:b], light, traced, starts_between(starts, a, b), glow_rules, one)

    tiles.run(_piece, len(rows), PATHS_TOGETHER)
    # Reflect the light by surface or wall, and add what a wall emits.
    room = room_of(light)
    albedos = albedos_at(points.points, light)
    emitted = np.zeros((len(rows), 3))
    on_wall = ~on_surface
    albedos[on_wall] = room.albedos[ends.met[on_wall]]
    emitted[on_wall] = room.radiances[ends.met[on_wall]]
    return np.asarray(emitted + albedos * arrived)


def albedos_at(points: np.ndarray, light: RotatedLight) -> np.ndarray:
    """Return the albedo of the surface at ``points`` (k, 3) float32 in index space; (k, 3)
    float64.
    """
    if not light.coloured:
        return np.tile(light.albedo, (len(points), 1))
    found = np.empty((len(points), 3), np.float32)
    fill_albedos(light.spec.prepared.colours, np.ascontiguousarray(points), found)
    return found.astype(np.float64)


def trace_shine(
    light: RotatedLight,
    gbuffer: GBuffer,
    replicas: range,
    samples: range,
    bounces: int,
    tiles: Tiles,
) -> np.ndarray:
    """Return the light that shine brings to each point, by whole paths, as sums over the
    ``samples`` of each of the ``replicas``; (points, replicas, 3) float64 linear RGB.

    A sample is a ray, and a path of at most ``bounces`` bounces from its end. The caller divides
    the sums by the number of samples. Raises Cancelled.
    """
    rays = cast_rays(light, gbuffer, replicas, samples, tiles)
    leaving = paths_from(rays, np.arange(len(rays.seen)), light, bounces, tiles)
    return rays.gather(leaving).reshape(-1, len(replicas), len(samples), 3).sum(axis=2)


def add_shine(
    sums: np.ndarray,
    light: RotatedLight,
    gbuffer: GBuffer,
    stream: int,
    samples: range,
    bounces: int,
    tiles: Tiles,
) -> None:
    """Let a surface shine whose diffuse light is ``sums`` (points, replicas, 3), in place; see
    ``Paths.add``.

    Shine takes its share of diffuse light, and adds the light that it mirrors. Raises Cancelled.
    """
    replicas = range(stream, stream + sums.shape[1])
    sums *= light_below(light, gbuffer, tiles)[:, None]
    step = max(RAYS_OF_PATHS // (len(replicas) * len(samples)), 1)
    for a in range(0, len(sums), step):
        rows = np.arange(a, min(a + step, len(sums)))
        some = gbuffer.part(rows, tiles)
        sums[rows] += trace_shine(light, some, replicas, samples, bounces, tiles)
