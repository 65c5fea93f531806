"""The camera of pictures whose options do not place one: it looks from the front, and sees all of the surface."""

from collections.abc import Iterable, Sequence

import numpy as np

from isogi_core.frame.fitting import Stand
from isogi_core.frame.renderer import Renderer
from isogi_core.model.view import PROJECTIONS
from isogi_core.plan.first_view import front_of
from isogi_core.plan.scene import Scene
from server.answers import fit
from server.parameters import FrameParams
from server.settings import Settings
from server.views import view_of

PLACED = {"distance", "eye", "target", "up"}
"""Parameters that say where the camera is."""

LOOKED_AT = 24
"""Pictures of many, at most, whose surfaces are looked at."""


def is_placed(given: Iterable[str]) -> bool:
    """Whether any of the parameters that are ``given`` places the camera."""
    return not PLACED.isdisjoint(given)


def seen_whole(renderer: Renderer, shots: Sequence[FrameParams], settings: Settings) -> list[FrameParams]:
    """The ``shots`` with one target and one distance for all of them, from the directions that they give."""
    scene = renderer.prepared.scene
    turned = [from_front(scene, shot) for shot in shots]
    few = np.unique(np.linspace(0, len(turned) - 1, LOOKED_AT).round().astype(int))
    stands = [stand_of(scene, turned[n], settings) for n in few]
    target, distance = fit(renderer, stands, shots[0].projection)
    return [shot.model_copy(update={"target": target, "distance": distance}) for shot in turned]


def from_front(scene: Scene, shot: FrameParams) -> FrameParams:
    """The ``shot`` from the angles that it gives, and where it gives none, from the scene's front."""
    azimuth, elevation = front_of(scene.volume, scene.lighting.room.any)
    front = {"azimuth": azimuth, "elevation": elevation}
    return shot.model_copy(update={name: angle for name, angle in front.items() if name not in shot.model_fields_set})


def stand_of(scene: Scene, shot: FrameParams, settings: Settings) -> Stand:
    """Where the camera of a picture looks from."""
    view = view_of(scene, shot.model_copy(update={"projection": PROJECTIONS[0]}), settings)
    return Stand(view, shot.azimuth, shot.elevation)
