"""The light of walls in a store: layers like all others, whose lattices lie on the walls.

Light of walls is that of one isosurface in the room, so there is a layer for each isovalue that it
was baked for: see ``WallState``. A side of a wall has two planes of its layer's lattice, as its
paths are kept in two halves, whose difference gives the noise. A note in the store lists the
isovalues that have light, so that views in between can interpolate (S3 bakes walls at levels of the
range).
"""

import logging
from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from isogi_core.bake.texel_light import Part
from isogi_core.cache.layer import LayerStore
from isogi_core.errors import StoreError
from isogi_core.model.lights import Colour
from isogi_core.model.scene_plan import Layer
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import Index, PreparedScene
from isogi_core.storage.store import Documents, Store

log = logging.getLogger("isogi.cache")

WALLS_FOLDER = "walls"
"""Folder of the notes of isovalues at the top of a store, and the kind of the layers."""

WALL_CHUNK_SIDE = 64
"""Side of a chunk in texels and in planes:
all sides of sixteen walls are then in one object, or in a few.
"""

Side = tuple[int, int]
"""A wall by its number, and its side: 1 is the front, -1 the back."""

Planes = tuple[np.ndarray, np.ndarray]
"""Means of E/π of each half, (planes, across, across, 3) float64,
and their numbers of paths, (planes, across, across) int64.
"""


@dataclass(frozen=True)
class WallState:
    """The state that light of walls depends on besides its scene:
    the isovalue, and the albedo and glow that a view asks for.
    """

    isovalue: float
    albedo: Colour
    glow: float


def wall_layer(scene: Scene) -> Layer:
    """Return the layer that texels of walls keep: E/π in linear RGB."""
    return Layer(WALLS_FOLDER, channels=3, half=False, scale=scene.plan.layers[0].scale)


def planes_of(side: Side) -> slice:
    """Return the planes of the lattice that hold both halves of a side of a wall:
    four a wall, its front first.
    """
    first = 4 * side[0] + 2 * int(side[1] < 0)
    return slice(first, first + 2)


class WallLayer(LayerStore):
    """The chunks of the light of all walls in one ``state``, with ``across`` texels along the
    longest edge of any wall.

    Methods raise StoreError.
    """

    def __init__(
        self, store: Store, prepared: PreparedScene, state: WallState, across: int
    ) -> None:
        """Set up without a request to the store."""
        scene = prepared.scene
        digest = scene.wall_digest(
            state.albedo, state.glow, state.isovalue, across, wall_layer(scene).scale
        )
        super().__init__(store, prepared, wall_layer(scene), None, digest, WALL_CHUNK_SIDE**3)
        self.isovalue = state.isovalue
        self.shape = 4 * len(scene.lighting.room.walls), across, across

    @property
    def chunks(self) -> Index:
        """Chunks along z, y, x."""
        z, y, x = (-(-count // WALL_CHUNK_SIDE) for count in self.shape)
        return z, y, x

    @property
    def facts(self) -> dict[str, Any]:
        """The attributes of the array."""
        return super().facts | {
            "texels": list(self.shape),
            "chunk": WALL_CHUNK_SIDE,
            "shown": self.isovalue,
        }

    def planes(self) -> Planes:
        """Read all light that is there; elsewhere the number of paths is 0."""
        means = np.zeros((*self.shape, 3))
        counts = np.zeros(self.shape, np.int64)
        for index in np.ndindex(*self.chunks):
            stored = self.read(index)
            if stored is not None:
                offsets, part = self.decode(index, stored)
                # Places in the lattice from offsets in the chunk.
                z, y, x = (
                    np.unravel_index(offsets, (WALL_CHUNK_SIDE,) * 3)
                    + WALL_CHUNK_SIDE * np.array(index)[:, None]
                )
                means[z, y, x] = part.coefficients[:, :, 0]
                # Samples of a part are the paths of both halves, a plane's those of its half.
                counts[z, y, x] = part.samples // 2
        return means, counts

    def keep(self, planes: Planes) -> None:
        """Write the light of ``planes``, merged with the light in the store: each texel keeps that
        of more paths. Texels without paths are left out.
        """
        means, counts = planes
        for index in np.ndindex(*self.chunks):
            block = tuple(slice(WALL_CHUNK_SIDE * i, WALL_CHUNK_SIDE * (i + 1)) for i in index)
            lit = np.nonzero(counts[block])
            if len(lit[0]):
                part = Part.dark(self.layer, len(lit[0]))
                # A plane counts the paths of its half. The samples of a part are the paths of both
                # halves, which are equal in number.
                part.samples[:] = 2 * counts[block][lit]
                part.coefficients[:, :, 0] = means[block][lit]
                self.save(
                    index, np.ravel_multi_index(lit, (WALL_CHUNK_SIDE,) * 3).astype(np.int32), part
                )


class WallStore:
    """The light of the walls of a ``prepared`` scene in a ``store``.

    Failures are logged and not raised: light that cannot be read is baked again, light that cannot
    be written is not kept.
    """

    def __init__(self, store: Store, prepared: PreparedScene) -> None:
        """Set up without a request to the store."""
        self._store = store
        self._prepared = prepared
        self._notes = Documents(store, WALLS_FOLDER)

    def planes(self, state: WallState, across: int) -> Planes | None:
        """Read the light in a ``state`` with ``across`` texels; None if there is none."""
        try:
            means, counts = WallLayer(self._store, self._prepared, state, across).planes()
        except StoreError as error:
            log.warning("Light of walls is baked again: %s", error)
            return None
        return (means, counts) if counts.any() else None

    def keep(self, state: WallState, planes: Planes) -> None:
        """Write light in a ``state``, merged with the light in the store, and note its isovalue."""
        try:
            WallLayer(self._store, self._prepared, state, planes[0].shape[1]).keep(planes)
            self._note(state)
        except StoreError as error:
            log.info("Light of walls is not kept: %s", error)

    def around(self, state: WallState) -> tuple[WallState, WallState] | None:
        """Return the ``state`` at two isovalues that have light: the highest one below the
        isovalue of ``state``, and the lowest one that is not below it.

        Return None if there is no such isovalue on one side, or if the note of isovalues cannot be
        read, which is logged.
        """
        try:
            known = self._isovalues(state)
        except StoreError as error:
            log.info("The isovalues that have light of walls cannot be read: %s", error)
            return None
        # The isovalue lies between the noted ones k - 1 and k.
        k = bisect_left(known, state.isovalue)
        if not 0 < k < len(known):
            return None
        low, high = (replace(state, isovalue=known[i]) for i in (k - 1, k))
        return low, high

    def _note(self, state: WallState) -> None:
        """Note that the isovalue of a ``state`` has light. Raises StoreError."""
        known = self._isovalues(state)
        if state.isovalue not in known:
            self._notes.write(self._name(state), {"isovalues": sorted([*known, state.isovalue])})

    def _isovalues(self, state: WallState) -> list[float]:
        """Return the noted isovalues with light, ascending. Raises StoreError."""
        found: Mapping[str, Any] = self._notes.read(self._name(state)) or {}
        return [float(value) for value in found.get("isovalues", ())]

    def _name(self, state: WallState) -> str:
        """Return the name of the note for views of this albedo and glow."""
        return self._prepared.scene.wall_digest(state.albedo, state.glow)
