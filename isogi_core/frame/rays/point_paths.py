"""Paths from points of a picture, by what they meet: walls, several surfaces, or a surface that light passes."""

from collections.abc import Callable

import numpy as np

from isogi_core.bake.refine import seeds_of
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.kernels.shading.framebuffer import PixelPoints
from isogi_core.kernels.tracing.cast import TracedSurface
from isogi_core.kernels.tracing.walls import NOWHERE
from isogi_core.kernels.transport.light_paths import Surroundings
from isogi_core.kernels.transport.matter.inside import Passable
from isogi_core.kernels.transport.matter.matter_paths import ALONG, INWARD, light_through_matter
from isogi_core.kernels.transport.matter.sight import BACK
from isogi_core.kernels.transport.paths import PathRules, PathStarts, SampleRange
from isogi_core.kernels.transport.room_paths import Room, RoomStarts, light_in_room
from isogi_core.kernels.transport.surface_paths import Surfaces, light_among_surfaces


def trace_in_room(
    traced: TracedSurface,
    room: Room,
    points: PixelPoints,
    light: Surroundings,
    rules: PathRules,
    replicas: range,
    samples: SampleRange,
) -> np.ndarray:
    """What ``trace_points`` adds for some ``replicas``, by number, in a ``room``; (m, replicas, 3)."""
    starts, sums = starts_at(traced, points, replicas), np.zeros((len(replicas) * len(points.pixels), 3))
    light_in_room(traced.field, traced.cells, room, starts, samples, rules, light, sums)
    return sums.reshape(-1, len(replicas), 3)


def starts_at(traced: TracedSurface, points: PixelPoints, replicas: range) -> RoomStarts:
    """The same starts as ``path_starts``, none of them on a wall."""
    starts = path_starts(traced, points, replicas)
    return RoomStarts(*starts, np.full(len(starts.seeds), NOWHERE))


def path_starts(traced: TracedSurface, points: PixelPoints, replicas: range) -> PathStarts:
    """Where paths of some ``replicas``, by number, start from the points of a picture: all of a point side by side."""
    each, replica = (part.ravel() for part in np.indices((len(points.pixels), len(replicas))))
    return PathStarts(
        np.ascontiguousarray(points.points[each].T, np.float64),
        np.ascontiguousarray(points.normals[each].T, np.float64),
        np.full(len(each), traced.isovalue),
        seeds_of(np.column_stack([points.pixels[each], replicas.start + replica])),
    )


def trace_among_surfaces(
    traced: TracedSurface,
    surfaces: Surfaces,
    points: PixelPoints,
    light: Surroundings,
    rules: PathRules,
    replicas: range,
    samples: SampleRange,
) -> np.ndarray:
    """What ``trace_points`` adds for some ``replicas``, by number, among ``surfaces``; (m, replicas, 3)."""
    starts = path_starts(traced, points, replicas)
    sums = np.zeros((len(starts.seeds), 3))
    light_among_surfaces(traced.field, surfaces, starts, samples, rules, light, sums)
    return sums.reshape(-1, len(replicas), 3)


def sight_lines(gbuffer: GBuffer) -> tuple[np.ndarray, np.ndarray]:
    """Where the eye's rays are just before the points of a G-buffer, and their unit world ways; (m, 3) float32 each."""
    spacing = np.array(gbuffer.spacing)
    ways = (gbuffer.points - np.array(gbuffer.eye)) * spacing
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    along = ways / spacing
    before = gbuffer.points - BACK * along / np.abs(along).max(axis=1, keepdims=True)
    return before.astype(np.float32), ways.astype(np.float32)


def trace_through(
    traced: TracedSurface,
    met: Passable,
    points: PixelPoints,
    light: Surroundings,
    rules: PathRules,
    replicas: range,
    samples: SampleRange,
) -> np.ndarray:
    """Sums of the radiance of some ``replicas``, by number, along the normals of ``points``, see ``sight_lines``; of
    matter that scatters what comes from inside there.
    """
    starts = path_starts(traced, points, replicas)
    count, given = len(starts.seeds), (traced.field, traced.cells, met)
    sums, along = (
        np.zeros((count, 3)),
        RoomStarts(*starts, np.full(count, INWARD if met.matter.extinction > 0.0 else ALONG)),
    )
    light_through_matter(*given, along, samples, rules, light, sums)
    return sums.reshape(-1, len(replicas), 3)


TRACERS: dict[type, Callable[..., np.ndarray]] = {
    Room: trace_in_room,
    Surfaces: trace_among_surfaces,
    Passable: trace_through,
}
"""Who traces paths, by what they meet."""
