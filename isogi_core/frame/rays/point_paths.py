"""Paths from points of a picture: where they start, and what they bring there by what they meet."""

import numpy as np

from isogi_core.bake.path_light import add_path_light
from isogi_core.bake.refine import seeds_of
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.kernels.shading.framebuffer import PixelPoints
from isogi_core.kernels.tracing.cast import TracedSurface
from isogi_core.kernels.transport.light_paths import Surroundings
from isogi_core.kernels.transport.matter.sight import START_BACK_VOXELS
from isogi_core.kernels.transport.paths import PathRules, PathStarts, SampleRange
from isogi_core.prepared.prepared_scene import Met


def trace_among(
    traced: TracedSurface,
    met: Met,
    points: PixelPoints,
    light: Surroundings,
    rules: PathRules,
    replicas: range,
    samples: SampleRange,
) -> np.ndarray:
    """What ``trace_points`` adds for some ``replicas``, by number, among what is ``met``; (m, replicas, 3).

    Where that lets light pass it is the radiance along the normals of ``points``, see ``sight_lines``; of matter that
    scatters what comes from inside there.
    """
    starts, sums = path_starts(traced, points, replicas), np.zeros((len(replicas) * len(points.pixels), 3))
    add_path_light(met, starts, samples, rules, light, sums)
    return sums.reshape(-1, len(replicas), 3)


def path_starts(traced: TracedSurface, points: PixelPoints, replicas: range) -> PathStarts:
    """Where paths of some ``replicas``, by number, start from the points of a picture: all of a point side by side."""
    each, replica = (part.ravel() for part in np.indices((len(points.pixels), len(replicas))))
    return PathStarts(
        np.ascontiguousarray(points.points[each].T, np.float64),
        np.ascontiguousarray(points.normals[each].T, np.float64),
        np.full(len(each), traced.isovalue),
        seeds_of(np.column_stack([points.pixels[each], replicas.start + replica])),
    )


def sight_lines(gbuffer: GBuffer) -> tuple[np.ndarray, np.ndarray]:
    """Where the eye's rays are just before the points of a G-buffer, and their unit world ways; (m, 3) float64 each.

    In glass rays soon part from those that start a rounding beside.
    """
    spacing = np.array(gbuffer.spacing)
    ways = (gbuffer.points - np.array(gbuffer.eye)) * spacing
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    along = ways / spacing
    before = gbuffer.points - START_BACK_VOXELS * along / np.abs(along).max(axis=1, keepdims=True)
    return before, ways
