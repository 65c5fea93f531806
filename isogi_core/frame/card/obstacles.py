"""Reasons why a visitor's graphics card cannot draw a view, so that the server draws it."""

from collections.abc import Callable
from typing import NamedTuple

from isogi_core.model.view import View
from isogi_core.plan.scene import Scene

BYTES = 64 << 20
"""Bytes of voxels and colours that are sent at most: small cards have room for them, and networks
transfer them in some seconds.
"""

SHADINGS = ("gi", "lambert", "lambert_shadow", "lambert_fog", "phong", "phong_shadow")
"""Shadings that a card draws."""

SHOWN = f"{', '.join(SHADINGS[:-1])} and {SHADINGS[-1]}"


class Obstacle(NamedTuple):
    """Something that a card does not draw: its ``name``, and a sentence that tells ``why``."""

    name: str
    why: str


Test = Callable[[Scene, View], bool]
TESTS: tuple[tuple[Obstacle, Test], ...] = (
    (
        Obstacle("rooms", "Walls are lit by paths of the server."),
        lambda scene, _: scene.lighting.room.any,
    ),
    (
        Obstacle("glass", "Rays through glass are followed by the server."),
        lambda scene, _: scene.surfaces.material.refracts,
    ),
    (
        Obstacle("subsurface", "Light from inside the surface is mixed by the server."),
        lambda scene, _: scene.surfaces.material.scatters,
    ),
    (
        Obstacle("several surfaces", "Several surfaces are composed by the server."),
        lambda scene, _: scene.surfaces.several,
    ),
    (
        Obstacle("shine", "Rays of shine are cast by the server."),
        lambda scene, view: scene.surfaces.shine_for(view.shine) is not None,
    ),
    (
        Obstacle("glow", "What glows is gathered by the server."),
        lambda scene, _: scene.lighting.glowing.any,
    ),
    (
        Obstacle("shading", f"This shading is drawn by the server: a card draws {SHOWN}."),
        lambda _, view: view.shading not in SHADINGS,
    ),
)

VOLUME_TOO_LARGE = Obstacle(
    "volume too large",
    f"The volume, with its colours, takes more than {BYTES >> 20} MB: the server draws it.",
)


def find_obstacles(scene: Scene, view: View, nbytes: int) -> list[Obstacle]:
    """Return all reasons why a card cannot draw a ``view`` of a ``scene`` whose voxels and colours
    take ``nbytes`` bytes; none if it can.

    Raises ViewError if views of the scene may not ask for the view's shine.
    """
    found = [obstacle for obstacle, meets in TESTS if meets(scene, view)]
    return found + ([VOLUME_TOO_LARGE] if nbytes > BYTES else [])
