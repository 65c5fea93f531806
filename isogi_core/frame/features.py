"""The features that a scene may have, each in one record: all that pictures have to know of it
besides the stage that draws it.

The kernels of a scene's pictures, the reasons why a card cannot draw it, and the way to its first
light follow from this list. Keys of scenes, and the keys that exclude each other, are read in
``isogi_core.plan``.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from isogi_core.kernels.shading.shine import cast_shine, fill_below, filter_shine
from isogi_core.kernels.shading.surface_points import pool_noise
from isogi_core.kernels.shading.wall_light import light_walls
from isogi_core.kernels.tracing.glow import gather_from_eye
from isogi_core.kernels.tracing.peels import peel_rays
from isogi_core.kernels.transport.colours import fill_albedos
from isogi_core.kernels.transport.matter.sight import see_through
from isogi_core.kernels.transport.microfacets import fill_energy
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene


@dataclass(frozen=True)
class Feature:
    """Something that a scene may have besides one opaque, diffuse surface in the open.

    - ``name``: as clients see it.
    - ``present``: tells if a scene has it.
    - ``why_not_on_card``: sentence that says why a visitor's graphics card does not draw it; None
      if it does.
    - ``kernels``: entry kernels that frames of other scenes do not call, unless another feature
      calls them, too.
    - ``traces_paths``: True if every picture of it traces whole paths; else only checks of pictures
      do.
    - ``in_stages``: True if pictures of it ask for their light in several stages, so that the light
      that a picture lacks is not known before it is drawn.
    - ``shown``: tells if a view shows it, if views may choose; None if a view shows all that the
      scene has.
    """

    name: str
    present: Callable[[Scene], bool]
    why_not_on_card: str | None = None
    kernels: tuple[Any, ...] = ()
    traces_paths: bool = False
    in_stages: bool = False
    shown: Callable[[Scene, View], bool] | None = None

    def is_shown(self, scene: Scene, view: View) -> bool:
        """Return True if a ``view`` of a ``scene`` shows the feature. Raises ViewError if views of
        the scene may not ask for what the view asks for.
        """
        if self.shown is None:
            return self.present(scene)
        return self.shown(scene, view)


WALLS = Feature(
    "rooms",
    lambda scene: scene.lighting.room.any,
    "Walls are lit by paths of the server.",
    kernels=(light_walls,),
    traces_paths=True,
)

GLASS = Feature(
    "glass",
    lambda scene: scene.surfaces.material.refracts,
    "Rays through glass are followed by the server.",
    kernels=(see_through, pool_noise),
    traces_paths=True,
    in_stages=True,
)

SUBSURFACE = Feature(
    "subsurface",
    lambda scene: scene.surfaces.material.scatters,
    "Light from inside the surface is mixed by the server.",
)

SEVERAL_SURFACES = Feature(
    "several surfaces",
    lambda scene: scene.surfaces.several,
    kernels=(peel_rays,),
    traces_paths=True,
    in_stages=True,
)

SHINE = Feature(
    "shine",
    lambda scene: scene.surfaces.shine is not None,
    kernels=(cast_shine, fill_below, fill_energy, pool_noise, filter_shine),
    shown=lambda scene, view: scene.surfaces.shine_for(view.shine) is not None,
)

GLOW = Feature(
    "glow",
    lambda scene: scene.lighting.glowing.any,
    "What glows is gathered by the server.",
    kernels=(gather_from_eye,),
)

COLOURS = Feature(
    "colours",
    lambda scene: scene.surfaces.colours is not None,
    kernels=(fill_albedos,),
)

FEATURES = (WALLS, GLASS, SUBSURFACE, SEVERAL_SURFACES, SHINE, GLOW, COLOURS)
"""All features, in the order in which clients see them."""


def features_of(scene: Scene) -> tuple[Feature, ...]:
    """Return the features that a ``scene`` has."""
    return tuple(feature for feature in FEATURES if feature.present(scene))
