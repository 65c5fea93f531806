"""The entry kernels that a frame under global illumination calls, those that take longest to compile first."""

from isogi_core.kernels.bricks import fill_ranges, mark_bricks, pack_bricks
from isogi_core.kernels.camera import trace_pixels
from isogi_core.kernels.film import develop_rows, fill_curve
from isogi_core.kernels.harmonics import rotate
from isogi_core.kernels.lattice import (
    carry_light,
    find_corners,
    find_places,
    find_rows,
    light_texels,
    mark_texels,
    touch_chunks,
    weigh_chunks,
)
from isogi_core.kernels.macrocells import fill_macrocells
from isogi_core.kernels.planes import tally
from isogi_core.kernels.shading import find_normals

FRAME = (
    trace_pixels,
    mark_bricks,
    carry_light,
    rotate,
    fill_ranges,
    find_normals,
    mark_texels,
    light_texels,
    find_rows,
    develop_rows,
    touch_chunks,
    pack_bricks,
    fill_macrocells,
    find_corners,
    weigh_chunks,
    fill_curve,
    find_places,
    tally,
)
