"""What comes straight from lobes to the surface points of a view, along shadow rays of their own."""

import threading
from dataclasses import dataclass

import numpy as np

from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.surroundings import Turned
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.lattice import DARKEST
from isogi_core.kernels.lobes import light_lobes
from isogi_core.model.sky import LUMINANCE

LOBE_POINTS = 1024
"""Surface points of a tile."""


@dataclass(frozen=True, eq=False)
class LobeLight:
    """Light of lobes at a view's surface points: ``lit`` (m, 4) float32, in the look's unit, see ``light_lobes``.

    It leaves a surface of the look's own albedo.
    """

    lit: np.ndarray

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        return self.lit.nbytes

    def tinted(self, tint: np.ndarray) -> "LobeLight":
        """The same from a surface that reflects ``tint`` (3,) times as much of each colour."""
        if (tint == 1.0).all():
            return self
        if (tint == tint[0]).all():
            return LobeLight(self.lit * np.array([*tint, tint[0] ** 2], np.float32))
        colours = (self.lit[:, :3] * tint).astype(np.float32)
        grown = (colours @ LUMINANCE) / np.maximum(self.lit[:, :3] @ LUMINANCE, DARKEST)
        return LobeLight(np.column_stack([colours, self.lit[:, 3] * grown**2]).astype(np.float32))


def find_lobes(turned: Turned, gbuffer: GBuffer, tiles: Tiles, cancelled: threading.Event | None) -> LobeLight:
    """Cast the shadow rays towards the lobes of ``turned`` lights. Raises Cancelled when that is set on the way."""
    recipe, points, pixels = turned.look.recipe, gbuffer.points, gbuffer.pixels
    normals = gbuffer.normals(recipe, tiles, cancelled)
    surface = recipe.field, recipe.bricks(gbuffer.isovalue, gbuffer.isovalue, cancelled), gbuffer.isovalue
    lit = np.empty((len(points), 4), np.float32)

    def _piece(a: int, b: int) -> None:
        light_lobes(*surface, points[a:b], normals[a:b], pixels[a:b], turned.lobes, lit[a:b])

    tiles.run(_piece, len(points), LOBE_POINTS, cancelled)
    return LobeLight(lit)
