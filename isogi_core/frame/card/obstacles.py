"""Reasons why a visitor's graphics card cannot draw a view, so that the server draws it."""

from typing import NamedTuple

from isogi_core.frame.features import FEATURES, SHINE
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


OTHER_SHADING = Obstacle("shading", f"This shading is drawn by the server: a card draws {SHOWN}.")

SHINE_OF_LAMPS = Obstacle(
    SHINE.name, "Lamps that a shiny surface mirrors are drawn by the server: a card mirrors skies."
)

VOLUME_TOO_LARGE = Obstacle(
    "volume too large",
    f"The volume, with its colours, takes more than {BYTES >> 20} MB: the server draws it.",
)


def find_obstacles(scene: Scene, view: View, nbytes: int) -> list[Obstacle]:
    """Return all reasons why a card cannot draw a ``view`` of a ``scene`` whose voxels and colours
    take ``nbytes`` bytes; none if it can. Raises ViewError if the scene cannot shine as the view
    asks.
    """
    found = [
        Obstacle(feature.name, feature.why_not_on_card)
        for feature in FEATURES
        if feature.why_not_on_card and feature.is_shown(scene, view)
    ]
    # A document serves all strengths of shine: a scene that shines may be asked for any.
    scene.surfaces.shine_for(view.shine)
    if SHINE.present(scene) and scene.lighting.lamps.any:
        found.append(SHINE_OF_LAMPS)
    if view.shading not in SHADINGS:
        found.append(OTHER_SHADING)
    if nbytes > BYTES:
        found.append(VOLUME_TOO_LARGE)
    return found
