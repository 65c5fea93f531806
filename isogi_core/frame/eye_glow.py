"""Glow as the eye sees it: the light that the camera's rays gather on their way to the points that
pixels show.
"""

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
"""Part of the content of rays: ray numbers, points and shares; see ``Frame.layers``."""

MIN_RAY_SHARE = 1e-6
"""Share of a ray, left by the layers that it shows, up to which it is not followed to infinity."""


@dataclass(frozen=True, eq=False)
class EyeGlow:
    """Gathers light of ``glows`` in a ``field`` along rays of cameras; ``radiances`` (k, 3) are
    those that they give off.
    """

    field: Field
    glows: Glows
    radiances: np.ndarray

    @classmethod
    def of(cls, prepared: PreparedScene, strength: float) -> "EyeGlow | None":
        """Return the glow of a scene at a ``strength``; None if nothing glows. Raises ViewError
        if nothing glows and a view asks for another strength than 1.
        """
        glowing = prepared.scene.lighting.glowing
        strength = prepared.scene.lighting.glow_for(strength)
        if glowing.any:
            return cls(prepared.field, prepared.glows, strength * glowing.radiances)
        return None

    def along(
        self, eye: Vector, directions: np.ndarray, reaches: np.ndarray, tiles: Tiles
    ) -> np.ndarray:
        """Gather each glow, as if of radiance 1, along rays from the ``eye``; (n, k).

        Rays go ``reaches`` (n,) times their ``directions`` (n, 3), all in index space. Raises
        Cancelled.
        """
        gathered = np.empty((len(reaches), len(self.radiances)))

        def _piece(a: int, b: int) -> None:
            ways = np.ascontiguousarray(directions[a:b].T)
            gather_from_eye(self.field, self.glows, eye, ways, reaches[a:b], gathered[a:b])

        tiles.run(_piece, len(reaches), TILE_RAYS)
        return gathered

    def lit(self, gathered: np.ndarray) -> np.ndarray:
        """Return the linear RGB (n, 3) float32 of ``gathered`` (n, k) glow."""
        return np.minimum(gathered @ self.radiances, np.finfo(np.float32).max).astype(np.float32)

    def before(self, frame: Frame, tiles: Tiles) -> np.ndarray:
        """Gather glow along the rays of a frame's pixels, up to the points that they show;
        (pixels, k). Raises Cancelled.
        """
        height, width = frame.gbuffer.shape
        y, x = np.divmod(np.arange(height * width), width)
        eye, directions = rays_through(frame, np.column_stack([x + 0.5, y + 0.5]))
        return self.before_layers(eye, directions, frame.layers, tiles)

    def before_layers(
        self, eye: Vector, directions: np.ndarray, layers: Iterable[Layer], tiles: Tiles
    ) -> np.ndarray:
        """Gather each glow, as if of radiance 1, along rays from the ``eye`` in ``directions`` (n,
        3), all in index space; (n, k).

        It is a mean over each ray by shares: the glow from the eye to the point of each of the
        ``layers`` that the ray shows counts by the share of that point, and the glow from the eye
        to infinity by the share that is left. A ray is in each layer at most once. Raises
        Cancelled.
        """
        gathered = np.zeros((len(directions), len(self.radiances)))
        left = np.ones(len(directions))
        for rays, points, shares in layers:
            ways = directions[rays]
            # A point is at eye + reach · direction.
            reaches = np.sqrt(((points - np.array(eye)) ** 2).sum(axis=1) / (ways**2).sum(axis=1))
            gathered[rays] += np.reshape(shares, (-1, 1)) * self.along(eye, ways, reaches, tiles)
            left[rays] -= shares
        # The share that no layer stops shows all glow along the ray, from the eye to infinity.
        open_air = np.flatnonzero(left > MIN_RAY_SHARE)
        endless = self.along(eye, directions[open_air], np.full(len(open_air), math.inf), tiles)
        gathered[open_air] += left[open_air, None] * endless
        return gathered

    def through(self, frame: Frame, places: np.ndarray, tiles: Tiles) -> np.ndarray:
        """Return the linear RGB (n, 3) float32 of rays through the ``places`` (n, 2; x, y) of a
        frame that meet nothing. Raises Cancelled.
        """
        eye, directions = rays_through(frame, places)
        reaches = np.full(len(places), math.inf)
        return self.lit(self.along(eye, directions, reaches, tiles))


def rays_through(frame: Frame, places: np.ndarray) -> tuple[Vector, np.ndarray]:
    """Return the eye of a frame, and the directions (n, 3) of rays through ``places`` (n, 2; x,
    y); both in index space.
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
    """Add the glow in front of all that a ``frame`` shows, in place; return the frame with it. If
    nothing glows, return the same frame.

    The gathered glow is ``kept``, for any colour and strength, by a ``key`` that names the camera
    and the surface. Raises Cancelled, and ViewError if the view asks for glow and nothing glows.
    """
    glow = EyeGlow.of(prepared, frame.view.glow)
    if glow is None:
        return frame
    with watch.stage("glow"):
        gathered = kept.get((EyeGlow, *key), lambda: glow.before(frame, tiles))
        return add_seen(frame, glow.lit(gathered))


def add_seen(frame: Frame, seen: np.ndarray) -> Frame:
    """Add the light ``seen`` (pixels, 3) of glow to a ``frame``, in place; return the frame with
    it.

    Pixels that show nothing but glow become final.
    """
    radiance, state, error = frame.framebuffer
    before = radiance @ LUMINANCE_WEIGHTS
    added = seen @ LUMINANCE_WEIGHTS
    # Glow has no noise: absolute errors stay, so relative errors become less.
    error *= (before / np.maximum(before + added, np.finfo(np.float32).tiny)).astype(np.float32)
    radiance += seen
    state[(state == 0) & (added > 0.0)] = FINAL
    return replace(frame, glow=seen)
