"""Paths from points of a picture: where they start, and the light of what glows that they bring there."""

import numpy as np

from isogi_core.bake.refine import add_glow_paths, seeds_of, starts_at
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.lighting import RotatedLight
from isogi_core.kernels.shading.surface_points import SurfacePoints
from isogi_core.kernels.tracing.cast import TracedSurface
from isogi_core.kernels.transport.matter.sight import START_BACK_VOXELS
from isogi_core.kernels.transport.paths import PathRules, PathStarts, SampleRange


def path_starts(traced: TracedSurface, points: SurfacePoints, replicas: range) -> PathStarts:
    """Where paths of some ``replicas``, by number, start from the points of a picture: all of a point side by side."""
    each, replica = (part.ravel() for part in np.indices((len(points.pixels), len(replicas))))
    seeds = seeds_of(np.column_stack([points.pixels[each], replicas.start + replica]))
    return starts_at(points.points[each], points.normals[each], traced.isovalue, seeds)


def sight_lines(gbuffer: GBuffer) -> SurfacePoints:
    """Where the eye's rays are just before the points of a G-buffer, and their unit world ways as normals; float64.

    In glass rays soon part from those that start a rounding beside.
    """
    spacing = np.array(gbuffer.spacing)
    ways = (gbuffer.points - np.array(gbuffer.eye)) * spacing
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    along = ways / spacing
    before = gbuffer.points - START_BACK_VOXELS * along / np.abs(along).max(axis=1, keepdims=True)
    return SurfacePoints(before, ways, gbuffer.pixels)


def add_glow(
    sums: np.ndarray,
    light: RotatedLight,
    traced: TracedSurface,
    starts: PathStarts,
    rules: PathRules,
    samples: SampleRange,
) -> None:
    """Add a ``SampleRange`` of E/π of what glows at ``starts`` about a surface to ``sums`` (g, 3), where there is any.

    Bounces count as in ``light_in_room``, the first weight of the ``rules`` all.
    """
    prepared = light.spec.prepared
    if not prepared.scene.lighting.glowing.any:
        return
    radiances = light.glow * prepared.scene.lighting.glowing.radiances
    own = np.zeros((len(sums), radiances.size))
    add_glow_paths(prepared, traced.cells, light.seen.albedo, starts, samples, rules, own)
    sums += np.einsum("gkc,kc->gc", own.reshape(-1, *radiances.shape), radiances)
