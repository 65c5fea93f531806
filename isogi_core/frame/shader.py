"""Shading: the light that leaves each surface point of a view, by the model that the view asks for."""

import hashlib
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from isogi_core.bake.noise import good_enough
from isogi_core.bake.recipe import Recipe, to_luminance
from isogi_core.cache.loader import Loader
from isogi_core.cache.pages import PagePool
from isogi_core.frame.gbuffer import POINTS, GBuffer
from isogi_core.frame.stopwatch import Stopwatch
from isogi_core.frame.surroundings import Turned
from isogi_core.frame.texels import Demand, ViewTexels
from isogi_core.frame.tiles import Piece, Tiles
from isogi_core.kernels.lattice import CONVERGING, FINAL, UNLIT, VOID_ROW, carry_light, light_texels
from isogi_core.kernels.shading import shade_local, trace_points
from isogi_core.model.sky import LUMINANCE
from isogi_core.model.view import View

PATH_POINTS = 256
"""Surface points of a tile when each of them sends paths."""


@dataclass(frozen=True, eq=False)
class Shaded:
    """Light of the surface points, (m, …), and what it was made of; see ``Frame`` for the planes."""

    radiance: np.ndarray
    state: np.ndarray
    error: np.ndarray
    chunks_needed: int = 0
    chunks_final: int = 0
    demands: tuple[Demand, ...] = ()
    version: bytes = b""


@dataclass(frozen=True, eq=False)
class Shader:
    """Shades one view: its surface points are in ``gbuffer``, and ``find_texels`` tells which texels those read."""

    recipe: Recipe
    loader: Loader
    tiles: Tiles
    view: View
    gbuffer: GBuffer
    find_texels: Callable[[], ViewTexels]
    watch: Stopwatch
    cancelled: threading.Event | None

    @cached_property
    def turned(self) -> Turned:
        """The environment turned for the view."""
        return Turned(self.recipe, self.view)

    def shade(self, target: float) -> Shaded:
        """Shade by the view's own model; light is final at the relative error ``target``."""
        if self.view.shading in ("gi", "vicinity"):
            return self._from_cache(target)
        if self.view.shading == "path_traced":
            return self._path_traced(target)
        return self._local()

    def _run(self, piece: Piece, total: int, size: int = POINTS) -> None:
        self.tiles.run(piece, total, size, self.cancelled)

    def _normals(self) -> np.ndarray:
        with self.watch.stage("normals"):
            return self.gbuffer.normals(self.recipe, self.tiles, self.cancelled)

    def _local(self) -> Shaded:
        """Lambert and Phong, with or without shadow and fog."""
        normals, points = self._normals(), self.gbuffer.points
        model = self.turned.local_model(self.view.shading, self._depths())
        radiance = np.empty_like(points)

        surface, eye = (self.recipe.field, self.gbuffer.isovalue), self.gbuffer.eye
        with self.watch.stage("shade"):
            self._run(
                lambda a, b: shade_local(*surface, points[a:b], normals[a:b], eye, model, radiance[a:b]), len(points)
            )
        return Shaded(radiance, np.full(len(points), FINAL, np.uint8), np.zeros(len(points), np.float32))

    def _depths(self) -> tuple[float, float]:
        """World distances from the eye between which fog thickens: the volume's own nearest and farthest."""
        volume = self.recipe.scene.volume
        middle = float(np.linalg.norm(np.subtract(self.view.camera.eye, volume.centre)))
        return max(middle - volume.radius, 0.0), middle + volume.radius

    def _path_traced(self, target: float) -> Shaded:
        """The reference: paths from every pixel. Its error is told from two independent halves."""
        normals, points = self._normals(), self.gbuffer.points
        albedo = self.turned.albedo
        weights = np.ascontiguousarray(albedo[None] ** (1 + np.arange(self.recipe.scene.bounces + 1)[:, None]))
        sums = np.zeros((len(points), 2, 3))
        half = max(self.view.samples // 2, 1)

        surface, light = (self.recipe.field, self.gbuffer.isovalue), self.turned.surroundings

        def _piece(a: int, b: int) -> None:
            seeds = self.gbuffer.pixels[a:b]
            trace_points(*surface, points[a:b], normals[a:b], seeds, light, weights, 0, half, sums[a:b])

        with self.watch.stage("paths"):
            self._run(_piece, len(points), PATH_POINTS)
        means = sums / half
        radiance = means.mean(axis=1)
        noise = np.abs((means[:, 0] - means[:, 1]) @ LUMINANCE) / 2.0
        error = np.clip(noise / np.maximum(radiance @ LUMINANCE, 1e-30), 0.0, 1.0)
        state = np.where(error <= target, FINAL, CONVERGING).astype(np.uint8)
        return Shaded(radiance.astype(np.float32), state, error.astype(np.float32))

    def _from_cache(self, target: float) -> Shaded:
        """Global illumination, or vicinity shading, out of the illumination cache (S1, section 4.2)."""
        pool = self.loader.pool
        with self.watch.stage("texels"):
            texels = self.find_texels()
        with self.watch.stage("load"):
            self.loader.ensure(texels.chunks)
        with pool.hold(texels.chunks) as slots:
            with self.watch.stage("light"):
                rows = rows_of(texels, slots, pool)
                grade = grade_rows(rows, pool, target)
                lit = self._light_texels(rows, pool)
            with self.watch.stage("shade"):
                radiance, state, error = self._carry(texels, rows, grade, lit)
            version = version_of(rows, pool)
        needed, done, demands = sort_demands(texels, rows, grade)
        return Shaded(radiance, state, error, needed, done, demands, version)

    def _light_texels(self, rows: np.ndarray, pool: PagePool) -> np.ndarray:
        """Linear RGB and standard error of each texel's light, (texels, 4)."""
        transfer, light, noise_light = self._light(pool)
        lit = np.zeros((len(rows), 4), np.float32)

        self._run(lambda a, b: light_texels(rows[a:b], transfer, pool.spread, light, noise_light, lit[a:b]), len(rows))
        return lit

    def _light(self, pool: PagePool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Which transfer is lit, by which light, and the light that its noise is judged by."""
        channels, n = pool.spread.shape[1:]
        if self.view.shading == "vicinity":
            light = (self.turned.albedo * self.turned.light[:, 0])[:, None]
            noise = np.zeros((channels, n))
            noise[:, 0] = LUMINANCE @ light[:, 0] / channels
            return pool.vicinity, as_kernel(light), as_kernel(noise)
        noise = to_luminance(self.turned.light, self.recipe.scene.albedo, channels)
        return pool.transfer, as_kernel(self.turned.reflected), as_kernel(noise)

    def _carry(
        self, texels: ViewTexels, rows: np.ndarray, grade: np.ndarray, lit: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Texels' light at the pixels: radiance, state and relative error of each point."""
        points = self.gbuffer.points
        normals = self._normals() if (rows < 0).any() else np.zeros_like(points)
        radiance = np.empty_like(points)
        state, error = np.empty(len(points), np.uint8), np.empty(len(points), np.float32)

        lattice, sky = self.recipe.lattice, self.turned.sky

        def _piece(a: int, b: int) -> None:
            out = (radiance[a:b], state[a:b], error[a:b])
            carry_light(lattice, points[a:b], texels.corners[a:b], rows, grade, lit, normals[a:b], sky, *out)

        self._run(_piece, len(points))
        return radiance, state, error


def as_kernel(light: np.ndarray) -> np.ndarray:
    """Coefficients as the kernels take them: float32, C-contiguous."""
    return np.ascontiguousarray(light, np.float32)


def rows_of(texels: ViewTexels, slots: np.ndarray, pool: PagePool) -> np.ndarray:
    """The pool's row of each texel of a view, UNLIT or VOID_ROW where it has none; (texels,) int32."""
    slot = slots[texels.chunk]
    return np.where(slot >= 0, pool.table[slot, texels.offset], np.int32(UNLIT))


def grade_rows(rows: np.ndarray, pool: PagePool, target: float) -> np.ndarray:
    """FINAL or CONVERGING for each row; void texels are final, unlit ones 0. (texels,) uint8."""
    done = good_enough(pool.error[rows], pool.samples[rows], target)
    grade = np.where(done, FINAL, CONVERGING)
    grade[rows == VOID_ROW] = FINAL
    grade[rows == UNLIT] = 0
    return grade.astype(np.uint8)


def version_of(rows: np.ndarray, pool: PagePool) -> bytes:
    """Digest of how far each texel of a view is baked: a texel's light follows from its number of samples."""
    samples = np.where(rows >= 0, pool.samples[rows], rows.astype(np.float32))
    return hashlib.blake2b(samples.tobytes(), digest_size=16).digest()


def sort_demands(texels: ViewTexels, rows: np.ndarray, grade: np.ndarray) -> tuple[int, int, tuple[Demand, ...]]:
    """Chunks that a view needs, how many are final, and the demands of the rest."""
    short = np.bincount(texels.chunk, grade < FINAL, minlength=len(texels.chunks)) > 0
    demands = tuple(d for d, missing in zip(texels.demands, short, strict=True) if missing)
    return len(texels.chunks), len(texels.chunks) - len(demands), demands
