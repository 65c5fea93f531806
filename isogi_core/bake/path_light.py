"""Light that paths bring to where they start, by what they meet: walls, several surfaces, or a surface they pass."""

import numpy as np

from isogi_core.kernels.tracing.active_cells import ActiveCells
from isogi_core.kernels.tracing.glow import Glows
from isogi_core.kernels.tracing.walls import NO_WALL
from isogi_core.kernels.transport.entries import PATH_KERNELS
from isogi_core.kernels.transport.light_paths import Surroundings
from isogi_core.kernels.transport.matter.matter_paths import ALONG_RAY, INWARD, Through
from isogi_core.kernels.transport.paths import PathRules, PathStarts, SampleRange
from isogi_core.kernels.transport.room_paths import RoomStarts
from isogi_core.model.lights import Colour
from isogi_core.prepared.prepared_scene import Met, PreparedScene
from isogi_core.runs import Run, serially


def on_wall(starts: PathStarts, wall: float = NO_WALL) -> RoomStarts:
    """The ``starts``, all of them on the ``wall`` of this number, or on what stands for one: by default on none."""
    return RoomStarts(*starts, np.full(len(starts.seeds), wall))


def add_paths(
    met: Met,
    starts: RoomStarts,
    samples: SampleRange,
    rules: PathRules,
    source: Surroundings | Glows,
    sums: np.ndarray,
) -> None:
    """Add what a ``SampleRange`` of paths gathers of a ``source`` at g ``starts`` to ``sums`` (g, channels).

    The kernel of PATHS for what is ``met`` and gathered does so, and says how.
    """
    PATH_KERNELS[type(met), type(source)](met, starts, samples, rules, source, sums)


def add_path_light(
    met: Met, starts: PathStarts, samples: SampleRange, rules: PathRules, light: Surroundings, sums: np.ndarray
) -> None:
    """Add what a ``SampleRange`` of paths brings to g ``starts`` on isosurfaces to ``sums`` (g, 3).

    Where matter scatters, paths start inwards; where it does not, the eye's rays do, along the normals.
    """
    wall = NO_WALL
    if isinstance(met, Through):
        wall = INWARD if met.matter.extinction > 0.0 else ALONG_RAY
    add_paths(met, on_wall(starts, wall), samples, rules, light, sums)


def add_glow_paths(
    prepared: PreparedScene,
    cells: ActiveCells,
    albedo: Colour,
    starts: RoomStarts,
    samples: SampleRange,
    rules: PathRules,
    sums: np.ndarray,
    run: Run = serially,
) -> None:
    """Add what a ``SampleRange`` of paths gathers of what glows, of radiance 1, at g ``starts`` to ``sums`` (g, 3 k).

    The surface has this ``albedo``, and is the first of several where there are others.
    """
    add_paths(prepared.met_by_glow(albedo, cells, run), starts, samples, rules, prepared.glows, sums)
