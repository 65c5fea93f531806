"""Reasons why a visitor's graphics card cannot draw a view, so that the server draws it."""

from typing import NamedTuple

from isogi_core.frame.features import FEATURES
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene

BYTES = 64 << 20
"""Bytes of voxels that are sent at most: small cards have room for them, and networks transfer
them in some seconds.
"""

SHADINGS = ("gi", "lambert")
"""Shadings that a card draws."""


class Obstacle(NamedTuple):
    """Something that a card does not draw: its ``name``, and a sentence that tells ``why``."""

    name: str
    why: str


OTHER_SHADING = Obstacle(
    "shading", "This shading is drawn by the server: a card draws gi and lambert."
)

VOLUME_TOO_LARGE = Obstacle(
    "volume too large", f"The volume takes more than {BYTES >> 20} MB: the server draws it."
)


def find_obstacles(scene: Scene, view: View, nbytes: int) -> list[Obstacle]:
    """Return all reasons why a card cannot draw a ``view`` of a ``scene`` whose voxels take
    ``nbytes`` bytes; none if it can.

    Raises ViewError if views of the scene may not ask for the view's shine.
    """
    found = [
        Obstacle(feature.name, feature.why_not_on_card)
        for feature in FEATURES
        if feature.why_not_on_card and feature.is_shown(scene, view)
    ]
    if view.shading not in SHADINGS:
        found.append(OTHER_SHADING)
    if nbytes > BYTES:
        found.append(VOLUME_TOO_LARGE)
    return found
