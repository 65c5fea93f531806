"""Shading: the light that leaves each surface point of a view, by the model that the view asks for."""

import threading
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from isogi_core.bake.look import Look
from isogi_core.bake.noise import DARKEST
from isogi_core.bake.recipe import Recipe
from isogi_core.cache.loader import Loader
from isogi_core.cache.pages import Held, PagePool
from isogi_core.frame.calm import scatter_at, weights_between
from isogi_core.frame.facings import shares_light
from isogi_core.frame.gbuffer import POINTS, GBuffer
from isogi_core.frame.lobes import LobeLight
from isogi_core.frame.paths import Paths, pooled_variance, replicas_for, variance_of_mean
from isogi_core.frame.reading import Reading
from isogi_core.frame.sharpening import Sharpened, Sharpness
from isogi_core.frame.stopwatch import Stopwatch
from isogi_core.frame.surroundings import Turned
from isogi_core.frame.texels import Demand, ViewTexels
from isogi_core.frame.tiles import Piece, Tiles
from isogi_core.frame.wide import COARSENESS, Cells, WideCells
from isogi_core.kernels.bricks import Bricks
from isogi_core.kernels.field import Field
from isogi_core.kernels.lattice import carry_light, light_texels
from isogi_core.kernels.lobes import add_lobes
from isogi_core.kernels.planes import CONVERGING, FINAL, Planes
from isogi_core.kernels.shading import find_shadows, shade_local
from isogi_core.kernels.shares import RECORD, carry_shares, share_texels
from isogi_core.kernels.wide import spread_light, spread_shares
from isogi_core.model.sky import LUMINANCE
from isogi_core.model.view import View


@dataclass(frozen=True, eq=False)
class Shaded:
    """The planes of a picture and what its light was made of; see ``Frame``."""

    planes: Planes
    chunks_needed: int = 0
    chunks_final: int = 0
    lacks: Callable[[], tuple[Demand, ...]] = tuple
    version: bytes = b""
    sharpness: Sharpness | None = None


@dataclass(frozen=True, eq=False)
class Shader:
    """Shades one view.

    Its surface points are in ``gbuffer``; ``loader`` opens the cache of its look; ``find_texels`` tells which
    texels those read, ``read`` what a pool has of them at a target error, ``sharpen`` what is read besides, and
    ``find_facing`` the normals that they are lit about.
    """

    look: Look
    loader: Callable[[], Loader]
    tiles: Tiles
    view: View
    gbuffer: GBuffer
    find_texels: Callable[[], ViewTexels]
    read: Callable[[ViewTexels, PagePool, Held, float], Reading]
    find_lobes: Callable[[Turned], LobeLight]
    sharpen: Callable[[ViewTexels, Reading], AbstractContextManager[Reading]]
    find_facing: Callable[[ViewTexels, Reading], np.ndarray]
    watch: Stopwatch
    cancelled: threading.Event | None

    @cached_property
    def turned(self) -> Turned:
        """The lights turned for the view."""
        return Turned(self.look, self.view)

    @property
    def recipe(self) -> Recipe:
        """Where texels and surfaces lie."""
        return self.look.recipe

    def shade(self, target: float) -> Shaded:
        """Shade by the view's own model; light is final at the relative error ``target``."""
        if self.view.shading in ("gi", "vicinity"):
            return self._from_cache(target)
        if self.view.shading == "path_traced":
            return self._path_traced(target)
        return self._local()

    @cached_property
    def planes(self) -> Planes:
        """The picture's planes, empty at first."""
        pixels = self.view.width * self.view.height
        return Planes(np.zeros((pixels, 3), np.float32), np.zeros(pixels, np.uint8), np.zeros(pixels, np.float32))

    def _run(self, piece: Piece, total: int, size: int) -> None:
        self.tiles.run(piece, total, size, self.cancelled)

    def _normals(self) -> np.ndarray:
        with self.watch.stage("normals"):
            return self.gbuffer.normals(self.recipe, self.tiles, self.cancelled)

    def _local(self) -> Shaded:
        """Lambert and Phong, with or without shadow and fog."""
        points, pixels, normals = self.gbuffer.points, self.gbuffer.pixels, self._normals()
        model = self.turned.local_model(self.view.shading, self._depths())
        camera, seen = (self.gbuffer.eye, self.recipe.field.spacing), np.empty(len(points), np.bool_)
        surface, planes = self._surface, self.planes

        def _piece(a: int, b: int) -> None:
            if model.shadow:
                find_shadows(*surface, points[a:b], normals[a:b], model.key, seen[a:b])
            shade_local(points[a:b], normals[a:b], seen[a:b], *camera, model, pixels[a:b], planes)

        with self.watch.stage("shade"):
            self._run(_piece, len(points), POINTS)
        return Shaded(planes)

    @property
    def _surface(self) -> tuple[Field, Bricks, float]:
        """What rays meet."""
        isovalue = self.gbuffer.isovalue
        return self.recipe.field, self.recipe.bricks(isovalue, isovalue, self.cancelled), isovalue

    def _depths(self) -> tuple[float, float]:
        """World distances from the eye between which fog thickens: the volume's own nearest and farthest."""
        volume = self.recipe.scene.volume
        middle = float(np.linalg.norm(np.subtract(self.view.camera.eye, volume.centre)))
        return max(middle - volume.radius, 0.0), middle + volume.radius

    def _path_traced(self, target: float) -> Shaded:
        """The reference: paths from every pixel. Its error is told from independent replicas."""
        pixels, replicas = self.gbuffer.pixels, replicas_for(self.view.samples)
        count, sums = max(self.view.samples // replicas, 1), np.zeros((len(pixels), replicas, 3))
        self._normals()
        with self.watch.stage("paths"):
            Paths(self.turned, self.gbuffer, self.tiles).add(sums, 0, 0, count, self.cancelled)
        means = np.minimum(sums / count, np.finfo(np.float32).max)
        radiance, deviation = means.mean(axis=1), np.sqrt(pooled_variance(variance_of_mean(means), self.gbuffer))
        error = np.clip(deviation / np.maximum(radiance @ LUMINANCE, DARKEST * self.look.unit), 0.0, 1.0)
        self.planes.radiance[pixels] = radiance
        self.planes.state[pixels] = np.where(error <= target, FINAL, CONVERGING)
        self.planes.error[pixels] = error
        return Shaded(self.planes)

    def _from_cache(self, target: float) -> Shaded:
        """Global illumination, or vicinity shading, out of the illumination cache (S1, section 4.2)."""
        loader = self.loader()
        pool = loader.pool
        with self.watch.stage("texels"):
            texels = self.find_texels()
        with self.watch.stage("load"):
            loader.ensure(texels.chunks, self.cancelled)
        with pool.hold(texels.chunks) as held, ExitStack() as stack:
            with self.watch.stage("read"):
                reading = stack.enter_context(self.sharpen(texels, self.read(texels, pool, held, target)))
            with self.watch.stage("light"):
                lit = own = self._light_texels(reading.sources(pool))
                if texels.wide is not None and reading.own is not reading:
                    own = self._light_texels(reading.own.sources(pool))
        cells = self._cells(texels, reading)
        carried = self._carried(texels, reading, lit)
        self._carry(cells, reading, carried)
        if texels.wide is not None:
            carried = carried if own is lit else self._carried(texels, reading.own, own)
            split = self._split(texels.wide, reading.own, carried)
            picture = self.gbuffer.pixels, self.planes
            reading = reading.asking(texels.wide.ask(texels.corners, cells, split, picture, self.tiles))
        if self.look.lobes:
            self._add_lobes()
        needed, short = reading.needed, int(reading.short.sum())
        lacks = partial(reading.demands, texels, cells.wide, self.planes)
        sharpness = Sharpness(texels, reading, cells.wide, self.planes) if isinstance(reading, Sharpened) else None
        return Shaded(self.planes, needed, needed - short, lacks, reading.version, sharpness)

    def _cells(self, texels: ViewTexels, reading: Reading) -> Cells:
        """What points are read from."""
        if texels.wide is None:
            return texels.narrow
        with self.watch.stage("cells"):
            return texels.wide.cells(texels.corners, reading.grade, self.tiles)

    @cached_property
    def _sharing(self) -> bool:
        """Whether pixels blend shares of unshadowed light, and not light itself."""
        return shares_light(self.recipe.scene, self.view.shading)

    def _carried(self, texels: ViewTexels, reading: Reading, lit: np.ndarray) -> np.ndarray:
        """What pixels blend of the texels' light ``lit`` (texels, 4): shares of it, or that itself."""
        return self._shares(texels, reading, lit) if self._sharing else lit

    def _carry(self, cells: Cells, reading: Reading, carried: np.ndarray) -> None:
        """Bring what is ``carried`` to the picture."""
        if self._sharing:
            self._carry_shares(cells, carried)
        else:
            self._carry_light(cells, reading, carried)

    def _split(self, wide: WideCells, own: Reading, carried: np.ndarray) -> np.ndarray:
        """Which ``wide`` cells are to be read finer, by what texels on their ``own`` isosurfaces have; (cells,) bool.

        So they are known before there is any sharp light, which prewarms never bring.
        """
        kernel = partial(spread_light, own.grade, carried)
        if self._sharing:
            kernel = partial(spread_shares, own.grade, carried, self.turned.bare)
        with self.watch.stage("cells"):
            edge, mean = 2.0 * float(self.recipe.step.mean()), self.turned.unoccluded / self.look.unit
            return np.asarray(COARSENESS * edge * wide.spread(kernel, self.tiles) > own.target * mean)

    def _light_texels(self, sources: Sequence[tuple[np.ndarray, PagePool]]) -> np.ndarray:
        """Linear RGB and standard error of each texel's light in ``Look.unit``, (texels, 4); undefined where unlit.

        Of each source those rows are read that are not negative.
        """
        lights, texels = self.turned.in_units, len(sources[0][0])
        lit = np.empty((texels, 4), np.float32)

        def _piece(a: int, b: int) -> None:
            for rows, pool in sources:
                light_texels(rows[a:b], pool.transfer, self._scatter(rows[a:b], pool), *lights, lit[a:b])

        self._run(_piece, texels, self.tiles.even(texels))
        return lit

    def _scatter(self, rows: np.ndarray, pool: PagePool) -> np.ndarray:
        """The scatter of a pool's rows at the view's albedo; (all rows,), undefined but for those told."""
        if self._calm is None:
            return pool.scatter
        own, found = rows[rows >= 0], np.empty_like(pool.scatter)
        kept = pool.transfer[own[:, None], 0, self.look.firsts]
        found[own] = scatter_at(self._calm, pool.scatter[own], pool.reflected[own], kept)
        return found

    @cached_property
    def _calm(self) -> np.ndarray | None:
        """What noise of another albedo is weighed with; None where light is of the one that it is told of."""
        other = self.look.plan.nodes and self.turned.seen is not self.look
        return weights_between(self.turned.seen, self.look) if other else None

    def _shares(self, texels: ViewTexels, reading: Reading, lit: np.ndarray) -> np.ndarray:
        """The texels' light as shares of unshadowed light, (texels, RECORD); see ``share_texels``."""
        with self.watch.stage("normals"):
            facing = self.find_facing(texels, reading)
        bare, shares = self.turned.bare, np.empty((len(lit), RECORD), np.float32)

        def _piece(a: int, b: int) -> None:
            share_texels(reading.grade[a:b], lit[a:b], facing[a:b], bare, shares[a:b])

        with self.watch.stage("light"):
            self._run(_piece, len(lit), self.tiles.even(len(lit)))
        return shares

    def _carry_shares(self, cells: Cells, shares: np.ndarray) -> None:
        """Bring the texels' shares to the picture."""
        points, pixels, normals = self.gbuffer.points, self.gbuffer.pixels, self._normals()
        lattice, bare, unit, planes = self.recipe.lattice, self.turned.bare, np.float32(self.look.unit), self.planes

        def _piece(a: int, b: int) -> None:
            place = (lattice, points[a:b], pixels[a:b], *(each[a:b] for each in cells))
            carry_shares(*place, shares, normals[a:b], bare, unit, planes)

        with self.watch.stage("shade"):
            self._run(_piece, len(points), self.tiles.even(len(points)))

    def _carry_light(self, cells: Cells, reading: Reading, lit: np.ndarray) -> None:
        """Bring the texels' light to the picture as it is."""
        points, pixels = self.gbuffer.points, self.gbuffer.pixels
        normals = points if reading.whole else self._normals()
        lattice, sky, unit, planes = self.recipe.lattice, self.turned.sky, np.float32(self.look.unit), self.planes

        def _piece(a: int, b: int) -> None:
            place = (lattice, points[a:b], pixels[a:b], *(each[a:b] for each in cells))
            carry_light(*place, reading.grade, lit, normals[a:b], sky, unit, planes)

        with self.watch.stage("shade"):
            self._run(_piece, len(points), self.tiles.even(len(points)))

    def _add_lobes(self) -> None:
        """Bring what comes straight from lobes to the picture."""
        with self.watch.stage("lobes"):
            lit = self.find_lobes(self.turned).lit
            add_lobes(self.gbuffer.pixels, lit, self.look.unit, self.planes)
