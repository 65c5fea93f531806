"""The entry kernels that a frame under global illumination calls, those that take longest to compile first."""

from isogi_core.kernels.bricks import fill_leaps, fill_ranges, mark_bricks
from isogi_core.kernels.camera import trace_rows
from isogi_core.kernels.film import develop_rows, fill_curve
from isogi_core.kernels.harmonics import project, rotate
from isogi_core.kernels.lattice import (
    carry_light,
    find_corners,
    light_texels,
    mark_texels,
    number_texels,
    touch_chunks,
    weigh_chunks,
)
from isogi_core.kernels.macrocells import fill_macrocells
from isogi_core.kernels.shading import find_normals

FRAME = (
    trace_rows,
    mark_bricks,
    carry_light,
    rotate,
    project,
    fill_ranges,
    find_normals,
    mark_texels,
    light_texels,
    develop_rows,
    touch_chunks,
    fill_leaps,
    fill_macrocells,
    find_corners,
    weigh_chunks,
    fill_curve,
    number_texels,
)
