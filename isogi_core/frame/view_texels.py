"""The texels under a view: which chunks it touches, which texels it reads, and the normals they are
lit about.
"""

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from isogi_core.bake.bake_spec import spec_name
from isogi_core.bake.noise import Effort
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.chunks import (
    add_footprints,
    find_coarse_corners,
    find_corners,
    find_places,
    mark_texels,
    touch_chunks,
    weigh_chunks,
)
from isogi_core.kernels.shading.filtering import Numbering
from isogi_core.kernels.shading.framebuffer import Framebuffer
from isogi_core.kernels.shading.lattice import Lattice
from isogi_core.kernels.shading.texel_normals import (
    fill_texel_normals,
    keep_normals,
    look_up_normals,
)
from isogi_core.model.view import View
from isogi_core.model.volume import Isovalue
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import Index, PreparedScene

LEAST_SEEN = 1 / 16
"""Share of the mean footprint that every texel counts as at least."""


@dataclass(frozen=True, eq=False)
class Demand:
    """What a view wants of one chunk: the texels at ``offsets``, whose light is to become final.

    ``weight`` is the squared visible error of the pixels that read it (centre ones count more),
    ``effort`` what its texels have taken and will, and ``footprints`` how much of each is seen, see
    ``ViewTexels.footprints``. Where an isosurface is ``shown``, the texels are projected onto it. A
    chunk has 1 << ``bits`` texels a side; 0 where all of them are to have their first light
    together, see ``first_texels``.
    """

    index: Index
    offsets: np.ndarray
    weight: float
    effort: Effort
    footprints: np.ndarray
    shown: Isovalue | None = None
    bits: int = 0

    def joined(self, other: "Demand") -> "Demand":
        """What this and ``other`` want of the chunk; texels of both are taken to be as those of
        one.
        """
        offsets = np.union1d(self.offsets, other.offsets)
        each = len(offsets) / (len(self.offsets) + len(other.offsets))
        sums = (
            each * (mine + theirs) for mine, theirs in zip(self.effort, other.effort, strict=True)
        )
        unlit, *rest = sums
        seen = most_seen(
            offsets, (self.offsets, self.footprints), (other.offsets, other.footprints)
        )
        effort = Effort(math.ceil(unlit), *rest)
        return Demand(
            self.index, offsets, self.weight + other.weight, effort, seen, self.shown, self.bits
        )


def first_texels(offsets: np.ndarray, bits: int) -> np.ndarray:
    """Which texels at ``offsets`` have light first: those whose indices z, y, x are all even or all
    odd; (m,) bool.

    Of the corners of each cell that is one each, so that all others have neighbours in light: a
    body-centred lattice.
    """
    z, y, x = (offsets >> bits * axis & 1 for axis in (2, 1, 0))
    return np.asarray((z == y) & (y == x))


READ = 3.0
EACH = 16
"""Texels that a view reads for each square of a lattice's texels on a surface; and every so many
pairs of points are looked at to tell how large a share of such a square a pixel has.
"""

PAIRED = 17.0 / 8.0
"""How much more the variance of a texel counts in the pixels of a view that is ``coarse``, in the
mean.

Two texels then stand for the eight of a cell, whose trilinear weights they add up: over a cell the
squares of these sums are 17/27 in the mean, where those of the weights themselves are (2/3)³.
"""


@dataclass(frozen=True, eq=False)
class ViewTexels:
    """The texels of a ``lattice`` that a G-buffer reads, numbered 0 … m - 1, chunk by chunk.

    ``chunks`` lists the chunks touched; texel t is at ``places[t]`` = i · texels of a chunk +
    offset, those of chunk i are ``bounds[i]`` … ``bounds[i + 1]``; ``corners`` (points, 8) numbers
    the texels around each point, and ``numbering`` finds those around a texel. Where a view is
    ``coarse`` its ``first_texels`` stand for all.
    """

    gbuffer: GBuffer
    lattice: Lattice
    chunks: tuple[Index, ...]
    places: np.ndarray
    bounds: np.ndarray
    corners: np.ndarray
    numbering: Numbering
    coarse: bool = False

    @property
    def nbytes(self) -> int:
        """Bytes that it takes, without its G-buffer; what is found when it is first asked for is
        counted before.
        """
        numbering = sum(each.nbytes for each in self.numbering)
        return 6 * self.places.nbytes + self.bounds.nbytes + self.corners.nbytes + numbering

    def numbers(self, places: np.ndarray) -> np.ndarray:
        """The numbers in the whole lattice of texels at some of the ``places`` (k,), in their
        order; (k,) uint64.
        """
        bits = 3 * self.lattice.bits
        chunks = np.array(self.chunks, np.int64).reshape(-1, 3)
        first = np.asarray(np.ravel_multi_index(tuple(chunks.T), self.lattice.chunks)) << bits
        return (first[places >> bits] + places % self.lattice.texels).astype(np.uint64)

    @cached_property
    def positions(self) -> np.ndarray:
        """Lattice indices (m, 3; z, y, x) int32 of the texels."""
        return self.positions_of(self.places)

    def positions_of(self, places: np.ndarray) -> np.ndarray:
        """Lattice indices (k, 3; z, y, x) int32 of the texels at some of the ``places`` (k,)."""
        chunks = np.array(self.chunks, np.int32).reshape(-1, 3) * self.lattice.chunk
        bits = self.lattice.bits
        side = self.lattice.chunk - 1
        inside = np.stack([places >> bits * axis & side for axis in (2, 1, 0)], axis=-1).astype(
            np.int32
        )
        return chunks[places >> 3 * bits] + inside

    @cached_property
    def offsets(self) -> tuple[np.ndarray, ...]:
        """Where in its chunk each texel is, chunk by chunk; (m,) int32 each."""
        offsets = (self.places % self.lattice.texels).astype(np.int32)
        return tuple(offsets[a:b] for a, b in pairwise(self.bounds.tolist()))

    @cached_property
    def footprints(self) -> tuple[np.ndarray, ...]:
        """What each texel's variance counts in the sum of the pixels', chunk by chunk; (m,) float32
        each.

        It is the sum of the squares of a texel's weights in them, see ``add_footprints``. One that
        is hardly seen counts as LEAST_SEEN of the mean, for it is to become final too.
        """
        seen = np.zeros(len(self.places))
        add_footprints(self.lattice, self.gbuffer.points, self.corners, seen)
        seen = np.maximum(seen, LEAST_SEEN * seen.mean()).astype(np.float32)
        return tuple(seen[a:b] for a, b in pairwise(self.bounds.tolist()))

    def weights(self, framebuffer: Framebuffer) -> np.ndarray:
        """The squared visible error that the pixels of a picture have left in each chunk, see
        ``weigh_chunks``.
        """
        weight = np.zeros(len(self.chunks))
        height, width = self.gbuffer.shape
        weigh_chunks(
            self.lattice,
            self.corners,
            self.places,
            self.gbuffer.pixels,
            width,
            height,
            framebuffer,
            weight,
        )
        return weight


def reads_coarsely(view: View, gbuffer: GBuffer, lattice: Lattice) -> bool:
    """Whether a ``view`` moves and would read more texels than it has points: some READ for each
    square of the lattice.

    By the median distance of points in pixels side by side.
    """
    if not view.moving:
        return False
    here = gbuffer.pixels[:-1:EACH]
    beside = gbuffer.pixels[1::EACH]
    steps = gbuffer.points[1::EACH] - gbuffer.points[:-1:EACH]
    squares = ((steps * np.array(lattice.density, np.float32)) ** 2).sum(axis=1)[beside - here == 1]
    return len(squares) > 0 and READ * float(np.median(squares)) > 1.0


def find_texels(
    gbuffer: GBuffer, prepared: PreparedScene, tiles: Tiles, coarse: bool = False
) -> ViewTexels:
    """Collect the texels around every surface point of ``gbuffer``, or ``coarse`` ones alone.
    Raises Cancelled.
    """
    points = gbuffer.points
    lattice = prepared.lattice
    piece = tiles.even(len(points))
    share = tiles.even(len(points), 1)

    def _over_points(
        kernel: Callable[..., None], size: int, each: Callable[[int, int], tuple[Any, ...]]
    ) -> None:
        tiles.run(lambda a, b: kernel(lattice, points[a:b], *each(a, b)), len(points), size)

    touched = np.zeros(prepared.chunks, np.bool_)
    _over_points(touch_chunks, piece, lambda a, b: (coarse, touched))
    indices = np.argwhere(touched)
    slots = np.full(prepared.chunks, -1, np.int32)
    slots[touched] = np.arange(len(indices))
    marks = np.zeros((-(-len(points) // share), len(indices) * lattice.rows), np.uint32)
    _over_points(mark_texels, share, lambda a, b: (coarse, slots, marks[a // share]))
    read = np.bitwise_or.reduce(marks, axis=0)
    first = np.zeros(len(read) + 1, np.uint32)
    np.cumsum(np.bitwise_count(read), out=first[1:])
    places = np.empty(first[-1], np.uint32)
    tiles.run(
        lambda a, b: find_places(lattice, a, b, read, first, places),
        len(read),
        tiles.even(len(read)),
    )
    corners = np.empty((len(points), 8), np.uint32)
    if coarse:
        find = find_coarse_corners
    else:
        find = find_corners
    _over_points(find, piece, lambda a, b: (slots, read, first, corners[a:b]))
    chunks = tuple((z, y, x) for z, y, x in indices.tolist())
    numbering = Numbering(slots, read, first)
    return ViewTexels(
        gbuffer, lattice, chunks, places, first[:: lattice.rows].copy(), corners, numbering, coarse
    )


def most_seen(offsets: np.ndarray, *views: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """The footprints of the texels at ``offsets`` in that of several views, (offsets, footprints),
    that sees most.
    """
    seen = np.zeros(len(offsets), np.float32)
    for own, footprints in views:
        at = np.searchsorted(offsets, own)
        seen[at] = np.maximum(seen[at], footprints)
    return seen


def carries_irradiance_ratios(scene: Scene, shading: str, projects: bool) -> bool:
    """Whether views of this ``shading`` carry light as ratios to unshadowed irradiance.

    Where light is the same from all sides, and in vicinity shading, the ratios are the light
    itself. Normals' weights alone then help a view that ``projects`` its texels, and no other.
    Light that comes from inside a surface does not follow its normals.
    """
    sided = scene.plan.representation in ("transfer", "irradiance") and not scene.inputs.constant
    return (
        spec_name(shading) == "gi" and (sided or projects) and not scene.surfaces.material.scatters
    )


TEXELS_A_PIECE = 4096
"""Texels whose normals one thread finds in one go."""

MAX_TABLE_TEXELS = 1 << 21
"""Texels that a table has room for at most."""

ENTRY = 20
"""Bytes of a texel in it: its number and its normal."""


class OwnNormals:
    """Outward unit world normals of a lattice's texels at their own points: no isovalue, camera or
    light changes them.

    Safe to use from many threads.
    """

    def __init__(self, budget: int) -> None:
        """Know none yet, in ``budget`` bytes at most; they are taken when the first are asked
        for.
        """
        self._room = min(
            1 << max((budget // ENTRY).bit_length() - 1, 0), MAX_TABLE_TEXELS
        )  # a power of two, as keys are hashed
        self._full = self._room // 2  # fuller tables are slow
        self._held = 0
        self._lock = threading.Lock()

    @property
    def nbytes(self) -> int:
        """Bytes that they take."""
        if "_keys" in vars(self):
            return self._room * ENTRY
        return 0

    @cached_property
    def _keys(self) -> np.ndarray:
        return np.zeros(self._room, np.uint64)

    @cached_property
    def _normals(self) -> np.ndarray:
        return np.empty((self._room, 3), np.float32)

    def of(
        self, numbers: np.ndarray, find: Callable[[np.ndarray], np.ndarray], tiles: Tiles
    ) -> np.ndarray:
        """The normals of the texels ``numbers`` (m,) uint64, each once; (m, 3) float32.

        Those that are not held are found by ``find``, which is given their rows. Raises Cancelled.
        """
        normals = np.empty((len(numbers), 3), np.float32)
        found = np.empty(len(numbers), np.bool_)

        def _piece(a: int, b: int) -> None:
            look_up_normals(numbers[a:b], *table, normals[a:b], found[a:b])

        with self._lock:
            table = self._keys, self._normals
            tiles.run(_piece, len(numbers), TEXELS_A_PIECE)
            new = np.flatnonzero(~found)
            if len(new):
                normals[new] = find(new)
                self._keep(numbers[new[: self._full]], normals[new[: self._full]])
        return normals

    def _keep(self, numbers: np.ndarray, normals: np.ndarray) -> None:
        if self._held + len(numbers) > self._full:
            self._keys[:] = 0
            self._held = 0
        keep_normals(numbers, normals, self._keys, self._normals)
        self._held += len(numbers)


@dataclass(eq=False)
class TexelNormals:
    """Outward unit world normals of a view's texels: ``own`` (texels, 3) float32, at their own
    points.

    Of those that are read on the view's isosurface, normals there are found when they are first
    asked for.
    """

    own: np.ndarray
    _there: np.ndarray = field(repr=False)
    _known: np.ndarray = field(repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        return self.own.nbytes + self._there.nbytes + self._known.nbytes

    def where(
        self, projected: np.ndarray, texels: ViewTexels, prepared: PreparedScene, tiles: Tiles
    ) -> np.ndarray:
        """The normals of the same view's ``texels``, of which those ``projected`` (texels,) lie on
        its isosurface.
        """
        if not projected.any():
            return self.own
        with self._lock:
            new = np.flatnonzero(projected & ~self._known)
            self._there[new] = normals_of(texels, texels.places[new], True, prepared, tiles)
            self._known[new] = True
            return np.where(projected[:, None], self._there, self.own)


def find_texel_normals(
    texels: ViewTexels, known: OwnNormals, prepared: PreparedScene, tiles: Tiles
) -> TexelNormals:
    """Find the normals of a view's texels at their own points, which may be ``known``."""
    own = own_normals(texels, texels.places, known, prepared, tiles)
    return TexelNormals(own, np.zeros_like(own), np.zeros(len(own), np.bool_))


def own_normals(
    texels: ViewTexels, places: np.ndarray, known: OwnNormals, prepared: PreparedScene, tiles: Tiles
) -> np.ndarray:
    """The normals of the texels at some of the ``places`` (k,), which may be ``known``; (k, 3)
    float32.
    """
    numbers = texels.numbers(places)
    return known.of(
        numbers, lambda new: normals_of(texels, places[new], False, prepared, tiles), tiles
    )


def nearby_normals(texels: ViewTexels, tiles: Tiles) -> np.ndarray:
    """For each texel of a view the normal of a surface point that reads it, (texels, 3) float32.

    A picture of unshadowed light is the same about any normals, and these are at hand.
    """
    normals = np.empty((len(texels.places), 3), np.float32)
    normals[texels.corners] = texels.gbuffer.normals(tiles)[:, None]
    return normals


def normals_of(
    texels: ViewTexels, places: np.ndarray, projected: bool, prepared: PreparedScene, tiles: Tiles
) -> np.ndarray:
    """Normals (k, 3) float32 of a view's texels at ``places`` (k,), ``projected`` or as they
    are.
    """
    normals = np.empty((len(places), 3), np.float32)
    level = texels.gbuffer.isovalue
    positions = texels.positions_of(places)

    def _piece(a: int, b: int) -> None:
        fill_texel_normals(
            prepared.field, prepared.step, level, projected, positions[a:b], normals[a:b]
        )

    tiles.run(_piece, len(places), TEXELS_A_PIECE)
    return normals
