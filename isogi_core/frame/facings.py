"""Facings: the normals that a view's texels are lit about, where their light is carried as shares."""

import threading
from dataclasses import dataclass, field

import numpy as np

from isogi_core.bake.look import look_name
from isogi_core.bake.recipe import Recipe
from isogi_core.frame.texels import ViewTexels
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.facing import face_texels
from isogi_core.model.scene import Scene

PIECE = 4096
"""Texels whose normals one thread finds in one go."""


@dataclass(eq=False)
class Facings:
    """Outward unit world normals of a view's texels: ``own`` (texels, 3) float32, at their own points.

    Of those that are read on the view's isosurface, normals there are found when they are first asked for.
    """

    own: np.ndarray
    _there: np.ndarray = field(repr=False)
    _known: np.ndarray = field(repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        return self.own.nbytes + self._there.nbytes + self._known.nbytes

    def where(self, moved: np.ndarray, texels: ViewTexels, recipe: Recipe, tiles: Tiles) -> np.ndarray:
        """The normals of the same view's ``texels``, of which those ``moved`` (texels,) lie on its isosurface."""
        if not moved.any():
            return self.own
        with self._lock:
            new = np.flatnonzero(moved & ~self._known)
            self._there[new] = normals_of(texels, texels.positions[new], True, recipe, tiles)
            self._known[new] = True
            return np.where(moved[:, None], self._there, self.own)


def find_facings(texels: ViewTexels, recipe: Recipe, tiles: Tiles) -> Facings:
    """Find the normals of a view's texels at their own points."""
    own = normals_of(texels, texels.positions, False, recipe, tiles)
    return Facings(own, np.zeros_like(own), np.zeros(len(own), np.bool_))


def normals_of(texels: ViewTexels, places: np.ndarray, moved: bool, recipe: Recipe, tiles: Tiles) -> np.ndarray:
    """Normals (m, 3) float32 at ``places`` (m, 3; z, y, x) of a view's texels, ``moved`` onto its isosurface or not."""
    normals, level = np.empty((len(places), 3), np.float32), texels.gbuffer.isovalue

    def _piece(a: int, b: int) -> None:
        face_texels(recipe.field, recipe.step, level, moved, places[a:b], normals[a:b])

    tiles.run(_piece, len(places), PIECE)
    return normals


def shares_light(scene: Scene, shading: str) -> bool:
    """Whether light is carried as shares of unshadowed light in views of this ``shading``.

    Where light is the same from all sides, and in vicinity shading, shares are the light itself. Normals' weights alone
    then help sharpened texels, and no others.
    """
    sided = scene.plan.representation in ("transfer", "irradiance") and not scene.needs.constant
    return look_name(shading) == "gi" and (sided or scene.sharpen)
