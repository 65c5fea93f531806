"""The entry kernels that frames of a scene call, so that they can be compiled before the first
frame.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from isogi_core.frame.features import FEATURES, SHINE, features_of
from isogi_core.frame.view_texels import carries_irradiance_ratios
from isogi_core.kernels.shading.chunks import (
    add_footprints,
    find_coarse_corners,
    find_corners,
    find_places,
    find_rows,
    mark_texels,
    touch_chunks,
    weigh_chunks,
)
from isogi_core.kernels.shading.edges import borrow_light, find_contrasts
from isogi_core.kernels.shading.filtering import filter_texels, lend_texels, take_filtered
from isogi_core.kernels.shading.framebuffer import develop_rows, fill_curve, tally
from isogi_core.kernels.shading.irradiance_ratio import carry_ratios, fill_records
from isogi_core.kernels.shading.lattice import carry_light, light_texels
from isogi_core.kernels.shading.lobes import (
    add_halves,
    add_lobes,
    find_sides,
    light_points,
    mark_edges,
    see_discs,
    see_middles,
    see_rims,
    share_rays,
    spread_edges,
)
from isogi_core.kernels.shading.local_models import find_normals, find_shadows, shade_local
from isogi_core.kernels.shading.shadow_points import prepare_points, sort_by_turn
from isogi_core.kernels.shading.shine import light_ends
from isogi_core.kernels.shading.surface_points import mean_around
from isogi_core.kernels.shading.texel_normals import (
    fill_texel_normals,
    keep_normals,
    look_up_normals,
)
from isogi_core.kernels.shading.texel_table import add_part, find_fewest, judge_rows, unpack_texels
from isogi_core.kernels.shading.wall_light import light_walls
from isogi_core.kernels.tracing.active_cells import (
    fill_ranges,
    mark_bricks,
    number_bricks,
    pack_bricks,
)
from isogi_core.kernels.tracing.camera import read_values, trace_pixels, trace_places
from isogi_core.kernels.tracing.extents import fill_row_ends
from isogi_core.kernels.tracing.glow import Glows
from isogi_core.kernels.tracing.macrocells import fill_macrocells
from isogi_core.kernels.tracing.peels import peel_rays
from isogi_core.kernels.tracing.stiffness import count_stiffness
from isogi_core.kernels.transport.entries import path_kernels
from isogi_core.kernels.transport.harmonics import rotate
from isogi_core.kernels.transport.light_paths import Surroundings
from isogi_core.kernels.transport.lights import project_lamps
from isogi_core.kernels.transport.room_paths import fill_seeds, light_in_room
from isogi_core.kernels.transport.transfer import measure_distances
from isogi_core.plan.left_out import uncalled
from isogi_core.plan.scene import Scene

LOBES = (
    see_middles,
    see_rims,
    see_discs,
    mark_edges,
    prepare_points,
    sort_by_turn,
    spread_edges,
    find_sides,
    share_rays,
    light_points,
    add_halves,
    add_lobes,
)
"""Kernels that only lights with lobes call."""

FRAME = (
    LOBES[0],
    trace_pixels,
    trace_places,
    borrow_light,
    mark_bricks,
    fill_texel_normals,
    carry_light,
    carry_ratios,
    rotate,
    fill_ranges,
    find_normals,
    mark_texels,
    light_texels,
    find_rows,
    project_lamps,
    develop_rows,
    touch_chunks,
    pack_bricks,
    number_bricks,
    fill_macrocells,
    fill_row_ends,
    find_coarse_corners,
    find_corners,
    add_footprints,
    count_stiffness,
    measure_distances,
    weigh_chunks,
    fill_curve,
    add_part,
    judge_rows,
    find_fewest,
    unpack_texels,
    find_places,
    fill_records,
    filter_texels,
    lend_texels,
    take_filtered,
    tally,
    find_contrasts,
    look_up_normals,
    keep_normals,
    *LOBES[1:],
)
"""Kernels of a plain scene under light that turns, with lobes and projected texels; those that
take longest to compile come first.
"""

KERNELS = tuple(
    dict.fromkeys((*(kernel for each in FEATURES for kernel in each.kernels), light_ends, *FRAME))
)
"""All kernels of frames without those of whole paths: those of features, and then those of plain
scenes; of the latter those that take longest to compile come first.
"""

CALLED_IF: Mapping[Any, Callable[[Scene, bool], bool]] = {
    **dict.fromkeys((trace_pixels, trace_places), lambda scene, _: not scene.surfaces.several),
    light_ends: lambda scene, _: SHINE.present(scene) and scene.plan.lobes > 0,
    count_stiffness: lambda scene, _: scene.settings.projected is None,
    measure_distances: lambda _, projects: projects,
    carry_ratios: lambda scene, projects: projects or carries_irradiance_ratios(scene, "gi", False),
    carry_light: lambda scene, _: not carries_irradiance_ratios(scene, "gi", False),
}
"""Conditions under which frames of a scene call a kernel that is not of a feature alone: functions
of the scene, and of a truth, True if it projects texels. See also ``uncalled``.
"""

OTHER_KERNELS = (
    mean_around,
    find_shadows,
    shade_local,
    read_values,
)
"""Kernels of local shadings and path-traced pictures, of checks of pictures, and of views
through a window.
"""


FIRST_KERNELS = (
    *(trace_pixels, light_in_room, light_walls, fill_seeds, peel_rays),
    *(mark_bricks, fill_ranges, pack_bricks, number_bricks, fill_macrocells, count_stiffness),
    *(fill_row_ends, find_normals, tally, develop_rows, fill_curve),
)
"""Kernels that pictures without light from texels call as well: they come first if none are
compiled.
"""


def first_kernels(scenes: Iterable[Scene]) -> tuple[Any, ...]:
    """Return the entry kernels of the first pictures of ``scenes``, which have a local shading
    without shadows and no smooth edges.
    """
    called = {*frame_kernels(scenes, surveyed=False)}
    return (*(kernel for kernel in FIRST_KERNELS if kernel in called), shade_local)


def frame_kernels(scenes: Iterable[Scene], surveyed: bool = True) -> tuple[Any, ...]:
    """Return the kernels that frames of any of the ``scenes`` call: those of paths first, then in
    the order of KERNELS. Kernels of paths that only checks trace are left out, as they may be
    compiled later: see ``other_kernels``.

    A survey of the volume tells if a scene projects texels, and calls kernels itself: scenes that
    are not ``surveyed`` count as if they do.
    """
    shown = tuple(scenes)
    paths = dict.fromkeys(
        kernel for scene in shown if not only_checked(scene) for kernel in paths_of(scene)
    )
    called = set().union(*(called_by(scene, surveyed) for scene in shown))
    return (*paths, *(kernel for kernel in KERNELS if kernel in called))


def called_by(scene: Scene, surveyed: bool) -> set[Any]:
    """Return the kernels of KERNELS that frames of a ``scene`` call; for ``surveyed`` see
    ``frame_kernels``.
    """
    lighting = scene.lighting
    projects = not surveyed or scene.projection.any
    # Leave out the kernels of features that the scene does not have, and those that its lights do
    # not need.
    needed = {kernel for feature in features_of(scene) for kernel in feature.kernels}
    absent = {kernel for feature in FEATURES for kernel in feature.kernels} - needed
    names = uncalled(lighting.rotating, lighting.environment, lighting.lamps, scene.plan.lobes)
    rest = (each for each in KERNELS if each not in absent and each.__name__ not in names)
    return {
        kernel for kernel in rest if kernel not in CALLED_IF or CALLED_IF[kernel](scene, projects)
    }


def other_kernels(scenes: Iterable[Scene]) -> tuple[Any, ...]:
    """Return OTHER_KERNELS, and the kernels of whole paths of any of the ``scenes``."""
    return (
        *OTHER_KERNELS,
        *dict.fromkeys(kernel for scene in scenes for kernel in paths_of(scene)),
    )


def paths_of(scene: Scene) -> tuple[Any, ...]:
    """Return the kernels of whole paths in a ``scene``: for its light, and for its glow."""
    if scene.lighting.glowing.any:
        glow = path_kernels(scene.glow_meets, Glows)
    else:
        glow = ()
    return (*path_kernels(scene.meets, Surroundings), *glow)


def only_checked(scene: Scene) -> bool:
    """Return True if frames of a ``scene`` trace paths only when they are checked."""
    return not any(feature.traces_paths for feature in features_of(scene))
