"""What glows as the eye sees it: what the camera's rays gather on their way to what they show."""

import math
from dataclasses import dataclass, replace

import numpy as np

from isogi_core.frame.frame import Frame
from isogi_core.frame.gbuffer import RAYS, GBuffer, Vector, view_pinhole
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.framebuffer import FINAL
from isogi_core.kernels.tracing.field import Field
from isogi_core.kernels.tracing.glow import Glows, gather_from_eye
from isogi_core.model.sky import LUMINANCE
from isogi_core.prepared.prepared_scene import PreparedScene


@dataclass(frozen=True, eq=False)
class EyeGlow:
    """What rays of cameras gather of ``glows`` in a ``field``, which give off ``radiances`` (k, 3)."""

    field: Field
    glows: Glows
    radiances: np.ndarray

    @classmethod
    def of(cls, prepared: PreparedScene) -> "EyeGlow | None":
        """That of a scene; None where nothing glows."""
        glowing = prepared.scene.glowing
        return cls(prepared.field, prepared.glows, glowing.radiances) if glowing.any else None

    def along(self, eye: Vector, directions: np.ndarray, reaches: np.ndarray, tiles: Tiles) -> np.ndarray:
        """Linear RGB (n, 3) float32 that rays from the ``eye`` gather, which go ``reaches`` (n,) of their
        ``directions`` (n, 3), all in index space. Raises Cancelled.
        """
        gathered = np.empty((len(reaches), len(self.radiances)))

        def _piece(a: int, b: int) -> None:
            ways = np.ascontiguousarray(directions[a:b].T)
            gather_from_eye(self.field, self.glows, eye, ways, reaches[a:b], gathered[a:b])

        tiles.run(_piece, len(reaches), RAYS)
        return np.minimum(gathered @ self.radiances, np.finfo(np.float32).max).astype(np.float32)

    def through(self, frame: Frame, places: np.ndarray, tiles: Tiles) -> np.ndarray:
        """What rays through the ``places`` (n, 2; x, y) of a frame gather that meet nothing; as ``along``."""
        camera = view_pinhole(frame.view, frame.gbuffer.spacing)
        directions = places.astype(np.float64) @ np.array([camera.right, camera.down]) + np.array(camera.corner)
        return self.along(camera.eye, directions, np.full(len(places), math.inf), tiles)


def add_glow_seen(frame: Frame, glow: EyeGlow, tiles: Tiles) -> Frame:
    """The ``frame`` with what its rays gather on their way to what they show; beside that they show what glows alone.

    Relative errors become those of the sum. Raises Cancelled.
    """
    gbuffer, (height, width) = frame.gbuffer, frame.gbuffer.shape
    y, x = np.divmod(np.arange(height * width), width)
    camera = view_pinhole(frame.view, gbuffer.spacing)
    ways = np.column_stack([x + 0.5, y + 0.5]) @ np.array([camera.right, camera.down]) + np.array(camera.corner)
    seen = glow.along(camera.eye, ways, reaches_of(gbuffer, ways), tiles)
    radiance, state, error = frame.framebuffer
    before, added = radiance @ LUMINANCE, seen @ LUMINANCE
    error *= (before / np.maximum(before + added, np.finfo(np.float32).tiny)).astype(np.float32)
    radiance += seen
    state[(state == 0) & (added > 0.0)] = FINAL
    return replace(frame, glow=seen)


def reaches_of(gbuffer: GBuffer, directions: np.ndarray) -> np.ndarray:
    """How far, over their ``directions`` (n, 3), the rays of a picture's pixels go; inf beside all; (n,) float64."""
    reaches = np.full(len(directions), math.inf)
    for each in (gbuffer, gbuffer.walls, gbuffer.faces):
        ways, found = directions[each.pixels], each.points - np.array(gbuffer.eye)
        reaches[each.pixels] = np.sqrt((found**2).sum(axis=1) / (ways**2).sum(axis=1))
    return reaches
