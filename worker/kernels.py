"""The kernels that bakes need, by the kinds of layers that they bake: which are missing, and how they are loaded."""

from collections.abc import Iterable
from typing import Any

from isogi_core.kernels._jit import entries_of, load
from isogi_core.kernels.tracing.active_cells import fill_ranges, mark_bricks, number_bricks, pack_bricks
from isogi_core.kernels.tracing.macrocells import fill_macrocells
from isogi_core.kernels.transport.coloured_transfer import bake_coloured_texels
from isogi_core.kernels.transport.entries import path_kernels
from isogi_core.kernels.transport.transfer import bake_irradiance, bake_texels, locate_texels
from isogi_core.plan.scene import COLOURED_KIND, PATH_KINDS

KERNELS_OF_LAYER = {
    **{"direct": (bake_texels,), "indirect": (bake_texels,), "whole": (bake_texels,)},
    **{"irradiance": (bake_irradiance,), COLOURED_KIND: (bake_coloured_texels,)},
    **{kind: path_kernels(*cell) for cell, kind in PATH_KINDS.items()},
}
"""Entry kernels by the kind of layer that they bake; among walls or surfaces and on colours they are others."""

PLAIN_LAYER_KINDS = tuple(kind for kind in KERNELS_OF_LAYER if kind not in (COLOURED_KIND, *PATH_KINDS.values()))
"""The kinds of layers of scenes with one surface, without walls, colours and glow."""

OPENING_KERNELS = (fill_macrocells, fill_ranges, mark_bricks, pack_bricks, number_bricks)
"""Entry kernels that open a scene and map its isosurfaces."""


def bake_kernels(kinds: Iterable[str]) -> tuple[Any, ...]:
    """The entry kernels for baking layers of these ``kinds``, and those of rooms, besides those that open a scene."""
    return (*{kernel for kind in kinds for kernel in KERNELS_OF_LAYER[kind]}, locate_texels)


def kernels_missing(kinds: Iterable[str]) -> bool:
    """Whether kernels that bake layers of these ``kinds`` are not compiled yet on this machine."""
    return any(not entry.stored for entry in entries_of(bake_kernels(kinds)))


def load_kernels(kinds: Iterable[str]) -> None:
    """Compile or load the kernels that bake layers of these ``kinds``."""
    load(bake_kernels(kinds))
