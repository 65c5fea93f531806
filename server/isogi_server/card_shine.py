"""The shine of a scene in the document of a graphics card: see docs/card.md."""

from collections.abc import Sequence
from urllib.parse import urlencode

from isogi_core.frame.card.blurred_surroundings import blurred_surroundings
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.shine import lobe_of
from isogi_server.card_schemas import CardShine, CardSurroundings


def card_shine(light: RotatedLight, query: Sequence[tuple[str, str]]) -> CardShine | None:
    """Return the lobe of the surface under a ``light``, and the surroundings that it mirrors; None
    if the surface is diffuse. The address of the surroundings carries the ``query``.
    """
    if light.shine is None:
        return None
    lobe = lobe_of(light)
    around = blurred_surroundings(light.spec.prepared.scene.lighting.environment)
    more = urlencode([*query, ("version", around.version)])
    return CardShine(
        alpha=lobe.alpha,
        facing=lobe.facing,
        strength=lobe.strength,
        metal=lobe.metal,
        energy=lobe.energy.tolist(),
        surroundings=CardSurroundings(
            rows=around.rows,
            levels=len(around.levels),
            brightness=around.brightness,
            bytes=around.nbytes,
            href=f"card/surroundings?{more}",
        ),
    )
