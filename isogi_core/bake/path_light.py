"""Light that paths bring to where they start, by what they meet: walls, several surfaces, or a surface they pass."""

import numpy as np

from isogi_core.kernels.tracing.active_cells import ActiveCells
from isogi_core.kernels.tracing.glow import Glows
from isogi_core.kernels.tracing.walls import NO_WALL
from isogi_core.kernels.transport.entries import PATH_KERNELS
from isogi_core.kernels.transport.light_paths import Surroundings
from isogi_core.kernels.transport.matter.matter_paths import ALONG_RAY, INWARD, Through
from isogi_core.kernels.transport.paths import PathRules, PathStarts, SampleRange
from isogi_core.model.lights import Colour
from isogi_core.model.volume import Isovalue
from isogi_core.prepared.prepared_scene import Met, PreparedScene
from isogi_core.runs import Run, serially


def starts_at(
    points: np.ndarray,
    normals: np.ndarray,
    isovalue: float | Isovalue,
    seeds: np.ndarray,
    walls: np.ndarray | float = NO_WALL,
) -> PathStarts:
    """Starts of paths at ``points`` with ``normals`` (g, 3), on the surface of this ``isovalue`` or about it.

    ``seeds`` (g,) are of the sequences that paths draw from, ``walls`` (g,) the numbers of walls: none by default.
    """
    here, around = (np.ascontiguousarray(each.T, np.float64) for each in (points, normals))
    g = len(seeds)
    return PathStarts(here, around, np.full(g, float(isovalue)), seeds, np.broadcast_to(walls, g).astype(np.float64))


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
    """Add what a ``SampleRange`` of paths gathers of a ``source`` at g ``starts`` to ``sums`` (g, channels).

    The kernel of PATH_KERNELS for what is ``met`` and gathered does so, and says how.
    """
    PATH_KERNELS[type(met), type(source)](met, starts, samples, rules, source, sums)


def add_path_light(
    met: Met, starts: PathStarts, samples: SampleRange, rules: PathRules, light: Surroundings, sums: np.ndarray
) -> None:
    """Add what a ``SampleRange`` of paths brings to g ``starts`` on isosurfaces to ``sums`` (g, 3).

    Where matter scatters, paths start inwards; where it does not, the eye's rays do, along the normals.
    """
    if isinstance(met, Through):
        wall = INWARD if met.matter.extinction > 0.0 else ALONG_RAY
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
    run: Run = serially,
) -> None:
    """Add what a ``SampleRange`` of paths gathers of what glows, of radiance 1, at g ``starts`` to ``sums`` (g, 3 k).

    The surface has this ``albedo``, and is the first of several where there are others.
    """
    add_paths(prepared.met_by_glow(albedo, cells, run), starts, samples, rules, prepared.glows, sums)
