"""The shine of a scene in the document of a graphics card: see docs/card.md."""

from collections.abc import Sequence
from urllib.parse import urlencode

from isogi_core.files.vector import triple
from isogi_core.frame.card.blurred_surroundings import blurred_surroundings
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.shine import PLASTIC
from isogi_server.card_schemas import CardShine, CardSurroundings


def card_shine(light: RotatedLight, query: Sequence[tuple[str, str]]) -> CardShine | None:
    """Return the shine of the surface under a ``light``, and the surroundings that it mirrors; None
    if the scene's surface is diffuse. The address of the surroundings carries the ``query``.
    """
    scene = light.spec.prepared.scene
    shine = light.view.shine or scene.surfaces.shine
    if shine is None:
        return None
    around = blurred_surroundings(scene.lighting.environment)
    more = urlencode([*query, ("version", around.version)])
    return CardShine(
        kind=shine.kind,
        roughness=shine.roughness,
        strength=shine.strength,
        plastic=PLASTIC,
        albedo=triple(light.albedo),
        surroundings=CardSurroundings(
            rows=around.rows,
            levels=len(around.levels),
            brightness=around.brightness,
            bytes=around.nbytes,
            href=f"card/surroundings?{more}",
        ),
    )
