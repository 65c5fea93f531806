"""Shade views by their texels: find these, read their light, filter it, and carry it to the
pixels.
"""

import hashlib
import math
import weakref
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from isogi_core.bake.bake_spec import spec_name
from isogi_core.cache.page_pool import Held, PagePool
from isogi_core.cache.scene_caches import Caches
from isogi_core.frame.gbuffer import GBuffer, surface_key
from isogi_core.frame.projected_texels import Distances, find_distances, held_chunks, join_readings
from isogi_core.frame.several.mixed_reading import Level, mixed
from isogi_core.frame.shading import (
    carry_irradiance_ratios,
    carry_texel_light,
    fill_texel_records,
    filter_texel_light,
    light_sources,
)
from isogi_core.frame.shot import Shot
from isogi_core.frame.texel_normals import (
    ENTRY,
    LatticeNormals,
    TexelNormals,
    find_texel_normals,
    nearby_normals,
)
from isogi_core.frame.texel_reading import Reading, read_texels
from isogi_core.frame.tiles import Tiles
from isogi_core.frame.view_texels import (
    ViewTexels,
    carries_irradiance_ratios,
    find_texels,
    reads_coarsely,
)
from isogi_core.kernels.shading.framebuffer import CONVERGING, FINAL, Framebuffer
from isogi_core.kernels.shading.lattice import BURIED_GRADE, PARTIAL_GRADE, UNBAKED_GRADE
from isogi_core.kernels.shading.surface_points import SurfacePoints
from isogi_core.lru_cache import LruCache
from isogi_core.model.view import View
from isogi_core.plan.volumes.masks import Ranges, box_left, is_within
from isogi_core.prepared.prepared_scene import PreparedScene


class StandIn:
    """Light of a whole volume that stands in for views of the same volume with a cut: for
    texels that are far from the faces of the cut. Also light of another time step, of which
    nothing is cut.
    """

    def __init__(self, whole: Caches, left: Ranges) -> None:
        """Borrow light of the caches ``whole``, for a volume of which only the ranges ``left`` are
        shown.

        A weak reference does not keep the caches in memory.
        """
        self._whole = weakref.ref(whole)
        self._box = box_left(left, whole.prepared.scene.volume.size)

    def light(
        self, texels: ViewTexels, reading: Reading, lit: np.ndarray, shot: Shot
    ) -> tuple[Reading, np.ndarray]:
        """Return the ``reading`` of a ``shot`` and the light ``lit`` of its texels, with borrowed
        light for texels that have none yet.

        Such texels count as partly lit, so pixels that read them stay provisional. Texels that are
        buried in the whole volume are dark. Raises Cancelled.
        """
        # Borrow only light that was baked by the same plan.
        light = shot.light
        tiles = shot.tiles
        caches = self._whole()
        waiting = reading.grade == UNBAKED_GRADE
        if caches is None or not waiting.any():
            return reading, lit
        if caches.spec(shot.view.shading).plan != light.spec.plan:
            return reading, lit
        loader = caches.of(shot.view.shading)
        loader.ensure(texels.chunks, tiles.check)
        with loader.pool.hold(texels.chunks) as held:
            other = read_texels(texels, held.slots, loader.pool, reading.goal, tiles)
            # Borrow for texels without light that are far from the cut, if the whole has light
            # there, or is known to be dark.
            known = np.isin(other.grade, (CONVERGING, FINAL, BURIED_GRADE))
            fit = waiting & known & self._is_far(texels, caches)
            rows = np.where(fit, other.rows, -1).astype(np.int32)
            borrowed = light_sources(((rows, loader.pool),), light, tiles)
        version = hashlib.sha256(other.version + fit.tobytes()).digest()
        grade = np.where(fit, np.uint8(PARTIAL_GRADE), reading.grade)
        found = replace(reading, grade=grade, version=reading.version + version)
        return found, np.where(fit[:, None], borrowed, lit)

    def _is_far(self, texels: ViewTexels, caches: Caches) -> np.ndarray:
        """Mark texels that are far from the faces of the cut; (texels,) bool."""
        return is_within(texels.positions[:, ::-1] * caches.prepared.step, self._box)


@dataclass(frozen=True, eq=False)
class FilteredLight:
    """The light of a view's texels after filtering, ``lit`` (texels, LIGHT_NUMBERS); ``borrowed``
    (texels,) marks texels that have light of their neighbours only.
    """

    borrowed: np.ndarray
    lit: np.ndarray

    @property
    def nbytes(self) -> int:
        """The size of its arrays in bytes."""
        return self.borrowed.nbytes + self.lit.nbytes


class TexelShading:
    """Finds the texels of views, reads the light that they have at its ``levels``, and carries it
    to pictures. Safe to use from many threads.
    """

    def __init__(
        self,
        prepared: PreparedScene,
        levels: tuple[Level, ...],
        kept: LruCache[Any],
        most: int,
        filters: bool,
        stand_in: StandIn | None,
    ) -> None:
        """Shade with the mixed light of ``levels``; keep results of steps in ``kept``.

        Normals of texels take up to ``most`` bytes besides. Set ``filters=False`` to measure
        unfiltered light. ``stand_in`` is light for texels that have none yet.
        """
        self.prepared = prepared
        self.levels = levels
        self._kept = kept
        self._filters = filters
        self._stand_in = stand_in
        self.normals = LatticeNormals(min(most, 4 * ENTRY * math.prod(self.prepared.shape)))

    @property
    def nbytes(self) -> int:
        """The bytes that normals of texels take."""
        return self.normals.nbytes

    def under(self, view: View, gbuffer: GBuffer, tiles: Tiles) -> ViewTexels:
        """Return the texels of a view, kept or found now. They hold its G-buffer, so that a
        cache keeps both or neither.
        """
        coarse = reads_coarsely(view, gbuffer, self.prepared.lattice)
        make = partial(find_texels, gbuffer, self.prepared, tiles, coarse)
        return self._kept.get((ViewTexels, surface_key(view), coarse), make)

    def ages(self, texels: ViewTexels, shot: Shot) -> tuple[int | None, ...] | None:
        """Load the light of the ``texels`` of a ``shot``, and return the ages of its page pools: as
        long as these are equal, so is the light. None in place of them if a ``StandIn`` may lend
        light, as its pool is not among them.

        The age of projected texels is None if memory has no room for them. Raises the errors of
        ``Loader.ensure``.
        """
        if self._stand_in is not None:
            return None
        ages = list[int | None]()
        for level in self.levels:
            loader = level.caches.of(shot.view.shading)
            with shot.watch.stage("load"):
                loader.ensure(texels.chunks, shot.tiles.check)
            ages.append(loader.pool.age)
            # Projected texels have a pool of their own.
            if self._projects(texels, shot.view):
                projected = level.caches.projected(texels.gbuffer.isovalue)
                with held_chunks(projected, texels.chunks) as held:
                    ages.append(None if held is None else held.age)
        return tuple(ages)

    def picture(self, texels: ViewTexels, shot: Shot) -> tuple[Reading, Framebuffer]:
        """Return the reading of the texels of a ``shot``, and the picture of their light."""
        reading, lit = self.lit(texels, shot)
        return reading, self._carry(texels, reading, lit, shot)

    def lit(self, texels: ViewTexels, shot: Shot) -> tuple[Reading, np.ndarray]:
        """Return the reading of the texels of a ``shot``, and their light (texels, LIGHT_NUMBERS).

        Grainy light of global illumination is filtered. Texels without light then take that of
        their neighbours, and are CONVERGING in the reading. Raises the errors of ``Loader.ensure``.
        """
        # Read the light of each level, and mix it.
        found = [self._lit_by(each.caches, texels, shot) for each in self.levels]
        reading, lit = mixed(self.levels, found)
        if not self._is_filtered(shot.view, reading):
            return reading, lit
        view = shot.view
        # Filtering takes long. Its result is kept while the version of the reading, and thus the
        # light of the texels, stays the same. The key does not keep the texels in memory.
        key = (
            FilteredLight,
            weakref.ref(texels),
            view.light,
            view.albedo,
            view.glow,
            view.moving,
            reading.goal,
            reading.version,
        )

        def make() -> FilteredLight:
            with shot.watch.stage("normals"):
                about = self._texel_normals(texels, reading, shot)
            with shot.watch.stage("filter"):
                after, smooth = filter_texel_light(
                    texels, reading, lit, about, shot.light, shot.tiles
                )
            return FilteredLight(after.grade != reading.grade, smooth)

        filtered = self._kept.get(key, make)
        grade = np.where(filtered.borrowed, np.uint8(CONVERGING), reading.grade)
        return replace(reading, grade=grade), filtered.lit

    def _is_filtered(self, view: View, reading: Reading) -> bool:
        """Return True if the texels of a view are to be filtered: global illumination that is
        grainy.
        """
        return self._filters and spec_name(view.shading) == "gi" and bool(reading.grainy.any())

    def _lit_by(self, caches: Caches, texels: ViewTexels, shot: Shot) -> tuple[Reading, np.ndarray]:
        """Return the reading of the texels of a ``shot``, and their light, by the ``caches`` of one
        level.
        """
        # Hold the chunks in memory while their light is read.
        with self._read(caches, texels, shot) as (base, pool, _), ExitStack() as stack:
            with shot.watch.stage("read"):
                reading = stack.enter_context(self._project(caches, texels, base, shot))
            with shot.watch.stage("light"):
                lit = light_sources(reading.sources(pool), shot.light, shot.tiles)
                if self._stand_in is not None:
                    reading, lit = self._stand_in.light(texels, reading, lit, shot)
        return reading, lit

    def _carry(
        self, texels: ViewTexels, reading: Reading, lit: np.ndarray, shot: Shot
    ) -> Framebuffer:
        """Carry the light of texels, ``lit`` (texels, LIGHT_NUMBERS), to the pixels: as
        irradiance ratios, or as it is.
        """
        gbuffer = texels.gbuffer
        light = shot.light
        tiles = shot.tiles
        watch = shot.watch
        records = None
        if carries_irradiance_ratios(self.prepared.scene, light.view.shading, reading.projects):
            with watch.stage("normals"):
                about = self._texel_normals(texels, reading, shot)
            with watch.stage("light"):
                records = fill_texel_records(reading.grade, lit, about, light, tiles)
        # Normals of the pixels are needed for ratios, and for the sky that replaces missing light;
        # else the points stand in for normals, which nothing reads.
        points = SurfacePoints(gbuffer.points, gbuffer.points, gbuffer.pixels)
        if records is not None or not reading.whole:
            with watch.stage("normals"):
                points = gbuffer.shown(tiles)
        with watch.stage("shade"):
            if records is not None:
                return carry_irradiance_ratios(texels, records, points, light, tiles)
            return carry_texel_light(texels, reading, lit, points, light, tiles)

    @contextmanager
    def _read(
        self, caches: Caches, texels: ViewTexels, shot: Shot
    ) -> Iterator[tuple[Reading, PagePool, Held]]:
        """Hold the chunks of a ``shot`` in the pool of ``caches`` while the block runs; yield the
        reading of its texels, the pool, and the chunks held.

        Raises the errors of ``Loader.ensure``.
        """
        loader = caches.of(shot.view.shading)
        goal = shot.goal
        with shot.watch.stage("load"):
            loader.ensure(texels.chunks, shot.tiles.check)
        with loader.pool.hold(texels.chunks) as held:
            with shot.watch.stage("read"):
                # A reading is valid as long as the pool has not changed, which its age tells.
                key = (
                    Reading,
                    surface_key(shot.view),
                    texels.coarse,
                    loader.pool.spec.digest,
                    goal,
                    held.age,
                )
                make = partial(read_texels, texels, held.slots, loader.pool, goal, shot.tiles)
                reading = self._kept.get(key, make)
            yield reading, loader.pool, held

    def _projects(self, texels: ViewTexels, view: View) -> bool:
        """Return True if a view may read projected texels: global illumination at rest, at an
        isovalue for which the scene projects.
        """
        shown = texels.gbuffer.isovalue
        return (
            not view.moving
            and spec_name(view.shading) == "gi"
            and self.prepared.scene.projection.projects(shown)
        )

    @contextmanager
    def _project(
        self, caches: Caches, texels: ViewTexels, base: Reading, shot: Shot
    ) -> Iterator[Reading]:
        """Yield the reading of a ``shot``: of ``base`` texels, with projected ones in place of
        those that are far from the isosurface. Their chunks are held while the block runs.
        """
        if not self._projects(texels, shot.view):
            yield base
            return
        # Look up the projected texels of this isovalue, which have caches of their own, and read
        # each in place of its base where that pays.
        shown = texels.gbuffer.isovalue
        tiles = shot.tiles
        make = partial(find_distances, texels, self.prepared, tiles)
        distances = self._kept.get((Distances, surface_key(shot.view)), make)
        loader = caches.projected(shown)
        with held_chunks(loader, texels.chunks) as held:
            if held is None:
                yield base
            else:
                projected = read_texels(texels, held.slots, loader.pool, base.goal, tiles)
                yield join_readings(base, projected, distances, loader.pool)

    def _texel_normals(self, texels: ViewTexels, reading: Reading, shot: Shot) -> np.ndarray:
        """Return the normals that the texels of a ``shot`` are lit about; if none of them has
        light, normals of nearby surface points do.
        """
        tiles = shot.tiles
        if reading.unbaked:
            return nearby_normals(texels, tiles)
        make = partial(find_texel_normals, texels, self.normals, self.prepared, tiles)
        normals = self._kept.get((TexelNormals, surface_key(shot.view), texels.coarse), make)
        return normals.select(reading.on_surface, texels, self.prepared, tiles)
