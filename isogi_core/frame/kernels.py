"""The entry kernels that frames of a scene under global illumination call."""

from collections.abc import Iterable
from typing import Any

from isogi_core.kernels.bricks import fill_ranges, mark_bricks, pack_bricks
from isogi_core.kernels.camera import trace_pixels
from isogi_core.kernels.chunks import find_corners, find_places, find_rows, mark_texels, touch_chunks, weigh_chunks
from isogi_core.kernels.codes import unpack_texels
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
from isogi_core.model.scene import Scene
from isogi_core.plan.kernels import uncalled

FRAME = (
    light_lobes,
    trace_pixels,
    mark_bricks,
    carry_light,
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
    tally,
    add_lobes,
)
"""All of them, those that take longest to compile first."""


def frame_kernels(scenes: Iterable[Scene]) -> tuple[Any, ...]:
    """Those that frames of any of the ``scenes`` call, in the order of FRAME."""
    spared = set.intersection({*FRAME}, *map(spared_by, scenes))
    return tuple(kernel for kernel in FRAME if kernel not in spared)


def spared_by(scene: Scene) -> set[Any]:
    """Those that frames of a ``scene`` never call."""
    names = {*uncalled(scene.rotating, scene.environment, scene.lamps, scene.plan.lobes)}
    if not scene.sharpen:
        names.add(judge_texels.__name__)
    return {kernel for kernel in FRAME if kernel.__name__ in names}
