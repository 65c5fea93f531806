"""The entry kernels of paths that gather light,
in one table by the scene and the source of light.
"""

from typing import Any

from isogi_core.kernels.tracing.glow import Glows
from isogi_core.kernels.transport.glow_paths import glow_among_surfaces, glow_in_room
from isogi_core.kernels.transport.light_paths import Open, Surroundings, light_in_the_open
from isogi_core.kernels.transport.matter.matter_paths import Through, light_through_matter
from isogi_core.kernels.transport.room_paths import InRoom, fill_seeds, light_in_room
from isogi_core.kernels.transport.surface_paths import Among, light_among_surfaces

PATH_KERNELS = {
    (Open, Surroundings): light_in_the_open,
    (InRoom, Surroundings): light_in_room,
    (InRoom, Glows): glow_in_room,
    (Among, Surroundings): light_among_surfaces,
    (Among, Glows): glow_among_surfaces,
    (Through, Surroundings): light_through_matter,
}
"""Kernels by the types of scene and source; each takes scene, starts, samples, rules, source, and
the sums to add to.

Texels in the Open have a kernel that takes them by their places, ``bake_irradiance``.
"""


def path_kernels(meets: type, gathers: type) -> tuple[Any, ...]:
    """Return the entry kernels for paths that meet scenes of type ``meets``
    and gather light of type ``gathers``.
    """
    return PATH_KERNELS[meets, gathers], fill_seeds
