"""The entry kernels that frames of a scene under global illumination call."""

from collections.abc import Iterable
from typing import Any

from isogi_core.frame.facings import shares_light
from isogi_core.kernels.bricks import fill_ranges, mark_bricks, pack_bricks
from isogi_core.kernels.camera import trace_pixels
from isogi_core.kernels.chunks import find_corners, find_places, find_rows, mark_texels, touch_chunks, weigh_chunks
from isogi_core.kernels.codes import unpack_texels
from isogi_core.kernels.facing import face_texels
from isogi_core.kernels.film import develop_rows, fill_curve
from isogi_core.kernels.footprints import add_footprints
from isogi_core.kernels.harmonics import rotate
from isogi_core.kernels.lamps import project_lamps
from isogi_core.kernels.lattice import carry_light, light_texels
from isogi_core.kernels.lobes import add_lobes, light_lobes
from isogi_core.kernels.macrocells import fill_macrocells
from isogi_core.kernels.moves import judge_texels
from isogi_core.kernels.planes import tally
from isogi_core.kernels.rows import add_part, judge_rows
from isogi_core.kernels.shading import find_normals
from isogi_core.kernels.shares import carry_shares, share_texels
from isogi_core.kernels.wide import (
    ask_texels,
    choose_cells,
    find_around,
    mark_around,
    mark_wide,
    number_wide,
    spread_light,
    spread_shares,
    touch_wide,
)
from isogi_core.model.scene import Scene
from isogi_core.plan.kernels import uncalled

FRAME = (
    light_lobes,
    trace_pixels,
    mark_bricks,
    face_texels,
    carry_light,
    carry_shares,
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
    fill_macrocells,
    find_corners,
    add_footprints,
    judge_texels,
    weigh_chunks,
    fill_curve,
    add_part,
    judge_rows,
    unpack_texels,
    find_places,
    share_texels,
    tally,
    add_lobes,
    spread_shares,
    spread_light,
    touch_wide,
    number_wide,
    mark_wide,
    find_around,
    mark_around,
    choose_cells,
    ask_texels,
)
"""All of them, those that take longest to compile first."""

SHARING = {face_texels, share_texels, carry_shares, spread_shares}
"""Those of them that carry light as shares, where the PLAIN ones are not called."""

PLAIN = {carry_light, spread_light}

ADAPTIVE = {
    *(spread_shares, spread_light, touch_wide, number_wide, mark_wide),
    *(find_around, mark_around, choose_cells, ask_texels),
}
"""Those that adaptive scenes alone call."""


def frame_kernels(scenes: Iterable[Scene]) -> tuple[Any, ...]:
    """Those that frames of any of the ``scenes`` call, in the order of FRAME."""
    spared = set.intersection({*FRAME}, *map(spared_by, scenes))
    return tuple(kernel for kernel in FRAME if kernel not in spared)


def spared_by(scene: Scene) -> set[Any]:
    """Those that frames of a ``scene`` never call."""
    names = {*uncalled(scene.rotating, scene.environment, scene.lamps, scene.plan.lobes)}
    spared = {kernel for kernel in FRAME if kernel.__name__ in names}
    spared |= set() if scene.sharpen else {judge_texels}
    spared |= {touch_chunks} if scene.adaptive else ADAPTIVE
    return spared | (PLAIN if shares_light(scene, "gi") else SHARING)
