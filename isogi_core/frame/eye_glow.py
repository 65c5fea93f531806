"""What glows as the eye sees it: what the camera's rays gather on their way to what they show."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from isogi_core.files.vector import Vector
from isogi_core.frame.frame import Frame
from isogi_core.frame.gbuffer import TILE_RAYS, view_pinhole
from isogi_core.frame.tiles import Stopwatch, Tiles
from isogi_core.kernels.shading.framebuffer import FINAL
from isogi_core.kernels.tracing.field import Field
from isogi_core.kernels.tracing.glow import Glows, gather_from_eye
from isogi_core.lru_cache import LruCache
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.prepared.prepared_scene import PreparedScene

Layer = tuple[np.ndarray, np.ndarray, np.ndarray | float]
"""What some rays show: see ``Frame.layers``."""

MIN_RAY_SHARE = 1e-6
"""The share that is left of a ray below which nothing is gathered behind what it shows."""


@dataclass(frozen=True, eq=False)
class EyeGlow:
    """What rays of cameras gather of ``glows`` in a ``field``, which give off ``radiances`` (k,
    3).
    """

    field: Field
    glows: Glows
    radiances: np.ndarray

    @classmethod
    def of(cls, prepared: PreparedScene, strength: float) -> "EyeGlow | None":
        """The glow of a scene at a ``strength``; None where nothing glows. ViewError where a view
        asks for it there.
        """
        glowing = prepared.scene.lighting.glowing
        strength = prepared.scene.lighting.glow_for(strength)
        if glowing.any:
            return cls(prepared.field, prepared.glows, strength * glowing.radiances)
        return None

    def along(
        self, eye: Vector, directions: np.ndarray, reaches: np.ndarray, tiles: Tiles
    ) -> np.ndarray:
        """What rays from the ``eye`` gather of each glow of radiance 1, (n, k), which go
        ``reaches`` (n,) of their ``directions`` (n, 3), all in index space. Raises Cancelled.
        """
        gathered = np.empty((len(reaches), len(self.radiances)))

        def _piece(a: int, b: int) -> None:
            ways = np.ascontiguousarray(directions[a:b].T)
            gather_from_eye(self.field, self.glows, eye, ways, reaches[a:b], gathered[a:b])

        tiles.run(_piece, len(reaches), TILE_RAYS)
        return gathered

    def lit(self, gathered: np.ndarray) -> np.ndarray:
        """Linear RGB (n, 3) float32 of what is ``gathered`` (n, k)."""
        return np.minimum(gathered @ self.radiances, np.finfo(np.float32).max).astype(np.float32)

    def before(self, frame: Frame, tiles: Tiles) -> np.ndarray:
        """What the rays of a frame's pixels gather on their way to what they show; (pixels, k).
        Raises Cancelled.
        """
        height, width = frame.gbuffer.shape
        y, x = np.divmod(np.arange(height * width), width)
        return self.before_layers(
            *rays_through(frame, np.column_stack([x + 0.5, y + 0.5])), frame.layers, tiles
        )

    def before_layers(
        self, eye: Vector, directions: np.ndarray, layers: Iterable[Layer], tiles: Tiles
    ) -> np.ndarray:
        """What rays from the ``eye`` in ``directions`` (n, 3) gather before the ``layers`` that
        they show, by their shares, and before what is left behind all of these; (n, k). Raises
        Cancelled.
        """
        gathered = np.zeros((len(directions), len(self.radiances)))
        left = np.ones(len(directions))
        for rays, points, shares in layers:
            ways = directions[rays]
            reaches = np.sqrt(((points - np.array(eye)) ** 2).sum(axis=1) / (ways**2).sum(axis=1))
            gathered[rays] += np.reshape(shares, (-1, 1)) * self.along(eye, ways, reaches, tiles)
            left[rays] -= shares
        open_air = np.flatnonzero(left > MIN_RAY_SHARE)
        endless = self.along(eye, directions[open_air], np.full(len(open_air), math.inf), tiles)
        gathered[open_air] += left[open_air, None] * endless
        return gathered

    def through(self, frame: Frame, places: np.ndarray, tiles: Tiles) -> np.ndarray:
        """Linear RGB (n, 3) float32 of rays through the ``places`` (n, 2; x, y) of a frame that
        meet nothing.

        Raises Cancelled.
        """
        return self.lit(
            self.along(*rays_through(frame, places), np.full(len(places), math.inf), tiles)
        )


def rays_through(frame: Frame, places: np.ndarray) -> tuple[Vector, np.ndarray]:
    """The eye of a frame, and the directions (n, 3) from it through ``places`` (n, 2; x, y), both
    in index space.
    """
    camera = view_pinhole(frame.view, frame.gbuffer.spacing)
    across = np.array([camera.right, camera.down])
    return camera.eye, places.astype(np.float64) @ across + np.array(camera.corner)


Key = tuple[Any, ...]


def with_glow(
    frame: Frame,
    kept: LruCache[Any],
    key: Key,
    prepared: PreparedScene,
    tiles: Tiles,
    watch: Stopwatch,
) -> Frame:
    """The ``frame`` with what glows before what it shows, where something does.

    What its rays gather is ``kept`` for a ``key``, whatever the colours and the strength. Raises
    Cancelled, and ViewError where the view asks for a glow that is not there.
    """
    glow = EyeGlow.of(prepared, frame.view.glow)
    if glow is None:
        return frame
    with watch.stage("glow"):
        return add_seen(
            frame, glow.lit(kept.get((EyeGlow, *key), lambda: glow.before(frame, tiles)))
        )


def add_seen(frame: Frame, seen: np.ndarray) -> Frame:
    """The ``frame`` with what is ``seen`` (pixels, 3) before what it shows; beside that it shows
    what glows alone.

    Relative errors become those of the sum.
    """
    radiance, state, error = frame.framebuffer
    before = radiance @ LUMINANCE_WEIGHTS
    added = seen @ LUMINANCE_WEIGHTS
    error *= (before / np.maximum(before + added, np.finfo(np.float32).tiny)).astype(np.float32)
    radiance += seen
    state[(state == 0) & (added > 0.0)] = FINAL
    return replace(frame, glow=seen)
