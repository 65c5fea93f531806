"""Light that paths bring to where they start, by what they meet: walls, several surfaces, or a surface they pass."""

import numpy as np

from isogi_core.kernels.tracing.active_cells import ActiveCells
from isogi_core.kernels.tracing.field import Field
from isogi_core.kernels.tracing.walls import NOWHERE
from isogi_core.kernels.transport.glow_paths import glow_in_room
from isogi_core.kernels.transport.light_paths import Surroundings
from isogi_core.kernels.transport.matter.inside import Passable
from isogi_core.kernels.transport.matter.matter_paths import ALONG, INWARD, light_through_matter
from isogi_core.kernels.transport.paths import PathRules, PathStarts, SampleRange
from isogi_core.kernels.transport.room_paths import RoomStarts, light_in_room
from isogi_core.kernels.transport.surface_glow import glow_among_surfaces
from isogi_core.kernels.transport.surface_paths import Surfaces, light_among_surfaces
from isogi_core.model.lights import Colour
from isogi_core.prepared.prepared_scene import Met, PreparedScene
from isogi_core.runs import Run, serially


def on_wall(starts: PathStarts, wall: float = NOWHERE) -> RoomStarts:
    """The same starts, all of them on the ``wall`` of this number, or on what stands for one: by default on none."""
    return RoomStarts(*starts, np.full(len(starts.seeds), wall))


def add_path_light(
    field: Field,
    cells: ActiveCells,
    met: Met,
    starts: PathStarts,
    samples: SampleRange,
    rules: PathRules,
    light: Surroundings,
    sums: np.ndarray,
) -> None:
    """Add what a ``SampleRange`` of paths brings to g ``starts`` on isosurfaces to ``sums`` (g, 3).

    See ``light_in_room``, ``light_among_surfaces`` and ``light_through_matter``. Where matter scatters, paths start
    inwards; where it does not, the eye's rays do, along the normals.
    """
    given = samples, rules, light, sums
    if isinstance(met, Surfaces):
        light_among_surfaces(field, met, on_wall(starts), *given)
    elif isinstance(met, Passable):
        wall = INWARD if met.matter.extinction > 0.0 else ALONG
        light_through_matter(field, cells, met, on_wall(starts, wall), *given)
    else:
        light_in_room(field, cells, met, on_wall(starts), *given)


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

    The surface has this ``albedo``, and is the first of several where there are others. See ``glow_in_room`` and
    ``glow_among_surfaces``.
    """
    room, given = prepared.dark_room(albedo), (starts, samples, rules, prepared.glows, sums)
    if prepared.scene.several:
        glow_among_surfaces(prepared.field, prepared.company(cells, run)._replace(room=room), *given)
    else:
        glow_in_room(prepared.field, cells, room, *given)
