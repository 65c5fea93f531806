"""The reading of a view: where its texels' light is in the page pool, and how good it is."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from isogi_core.bake.noise import RATE, Effort, Until, efforts, expected_samples, good_enough
from isogi_core.cache.page_pool import PagePool, fewest_samples
from isogi_core.cache.scene_caches import Caches
from isogi_core.frame.demand import Demand
from isogi_core.frame.tiles import Tiles
from isogi_core.frame.view_texels import ViewTexels
from isogi_core.kernels.shading.chunks import Pages, find_rows
from isogi_core.kernels.shading.framebuffer import CONVERGING, FINAL, PROVISIONAL, Framebuffer
from isogi_core.kernels.shading.lattice import (
    BURIED_GRADE,
    BURIED_ROW,
    PARTIAL_GRADE,
    UNBAKED_GRADE,
    UNLIT_ROW,
    VOID_GRADE,
    VOID_ROW,
)
from isogi_core.model.scene_plan import MAX_SAMPLES
from isogi_core.model.volume import Isovalue
from isogi_core.prepared.prepared_scene import Index

GRAIN = 0.01
"""Relative noise of a texel below which no filter is needed: half of it is left in pixels, a step
of eight bits.
"""

TEXELS_A_PIECE = 16384
"""Texels that are looked up, and digested, together; the same on any number of threads."""


@dataclass(frozen=True, eq=False)
class Reading:
    """What a view's texels hold, (texels,) each; it is good until the pool changes.

    ``rows`` int32 are those of the pool, negative where there is no light; ``grade`` uint8 is
    UNBAKED_GRADE, PARTIAL_GRADE, CONVERGING, FINAL, BURIED_GRADE or VOID_GRADE. ``version`` says
    how far each texel is baked: a texel's light follows from its numbers of samples; ``samples``
    int32 are the fewest of any part, ``error`` float32 is relative. Texels of chunk i are
    ``bounds[i]`` … ``bounds[i + 1]``; ``short`` (chunks,) says which chunks have texels that lack
    light for a picture of the relative error ``target``, whose texels need no more samples than are
    ``enough``.
    """

    rows: np.ndarray
    grade: np.ndarray
    version: bytes
    samples: np.ndarray
    error: np.ndarray
    bounds: np.ndarray
    short: np.ndarray
    target: float
    enough: int

    @property
    def nbytes(self) -> int:
        """Bytes that it takes, without the bounds."""
        return sum(
            each.nbytes for each in (self.rows, self.grade, self.samples, self.error, self.short)
        )

    @property
    def unbaked(self) -> bool:
        """Whether no texel holds light."""
        return bool((self.grade == UNBAKED_GRADE).all())

    @property
    def whole(self) -> bool:
        """Whether every texel holds light."""
        return not (self.rows < 0).any()

    @property
    def lit(self) -> np.ndarray:
        """Which texels show light of paths; (texels,) bool."""
        return np.asarray((self.grade == CONVERGING) | (self.grade == FINAL))

    @property
    def noisy(self) -> np.ndarray:
        """Which texels' light is noisier than a picture's target allows each alone; (texels,)
        bool.
        """
        return np.asarray(
            self.lit & (self.samples > 0) & ~good_enough(self.error, self.samples, self.target)
        )

    @property
    def grainy(self) -> np.ndarray:
        """Which texels' light is filtered for its noise, also where it needs no more samples;
        (texels,) bool.
        """
        return np.asarray(self.lit & (self.samples > 0) & (self.error > GRAIN))

    @property
    def rung(self) -> int:
        """The samples that all texels have whose light is noisier than a picture's target allows
        each alone; the most of any where there is none.
        """
        noisy = self.samples[self.noisy]
        return int(noisy.min() if len(noisy) else self.samples.max(initial=0))

    @cached_property
    def effort(self) -> float:
        """Samples by which a texel comes to the relative error 1, at the median: an error e takes 1
        / e^RATE of them.

        Dark texels take many more, and are little of a picture's light. 0 where no texel is lit.
        """
        lit = self.samples > 0
        if lit.any():
            return float(np.median(self.samples[lit] * self.error[lit] ** RATE))
        return 0.0

    @property
    def on_surface(self) -> np.ndarray:
        """Which texels are read on the isosurface that is shown, and not on their own; (texels,)
        bool.
        """
        return np.zeros(len(self.rows), np.bool_)

    @property
    def projects(self) -> bool:
        """Whether texels that are far from the isosurface which is shown are projected onto it."""
        return False

    def sources(self, pool: PagePool) -> tuple[tuple[np.ndarray, PagePool], ...]:
        """Rows of light, and the pools that they are of: all of them of the ``pool`` that was
        read.
        """
        return ((self.rows, pool),)

    def demands(self, lacking: "Lacking") -> tuple[Demand, ...]:
        """The light on texels' own isosurfaces that is not final, for a picture that is ``lacking``
        it.
        """
        return lacking.of(self, self.grade < FINAL)

    def stages(self, lacking: "Lacking") -> tuple["Stage", ...]:
        """What a picture wants, stage after stage."""
        return (Stage(self.demands(lacking), self.target, self.enough),)


def read_texels(
    texels: ViewTexels, slots: np.ndarray, pool: PagePool, until: Until, tiles: Tiles
) -> Reading:
    """Look a view's texels up in the pool; ``slots`` are those of its chunks. They are baked
    ``until`` then.
    """
    places = texels.places
    rows = np.empty(len(places), np.int32)
    grade = np.empty(len(places), np.uint8)
    samples = np.empty(len(places), np.int32)
    error = np.empty(len(places), np.float32)
    digests: dict[int, bytes] = {}
    pages = Pages(pool.table, pool.error, pool.stamp)

    def _piece(a: int, b: int) -> None:
        stamp = np.empty(b - a, np.float32)
        find_rows(texels.lattice, places[a:b], slots, pages, rows[a:b], error[a:b], stamp)
        samples[a:b] = fewest_samples(stamp, len(pool.spec.plan.layers))
        grade[a:b] = grade_rows(rows[a:b], error[a:b], samples[a:b], *until)
        digests[a] = hashlib.sha256(stamp.data).digest()

    tiles.run(_piece, len(places), TEXELS_A_PIECE)
    if len(grade):
        short = np.minimum.reduceat(grade, texels.bounds[:-1]) < FINAL
    else:
        short = np.zeros(0, np.bool_)
    version = b"".join(digests[a] for a in sorted(digests))
    return Reading(rows, grade, version, samples, error, texels.bounds, short, *until)


@dataclass(frozen=True, eq=False)
class Stage:
    """A stage of what a picture wants: ``demands`` of one bake, until a ``target`` error or
    ``enough`` samples.

    Of one of several surfaces' sides, but the outer one of that which slides, the light is that of
    ``caches``.
    """

    demands: tuple[Demand, ...]
    target: float
    enough: int = MAX_SAMPLES
    caches: Caches | None = None

    @property
    def shown(self) -> Isovalue | None:
        """The isosurface that its texels are projected onto; None where they lie on their own."""
        if self.demands:
            return self.demands[0].shown
        return None


@dataclass(frozen=True, eq=False)
class Lacking:
    """What the picture in a ``framebuffer`` still wants of its ``texels``, by their ``reading``."""

    texels: ViewTexels
    reading: Reading
    framebuffer: Framebuffer

    @cached_property
    def demands(self) -> tuple[Demand, ...]:
        """The light on texels' own isosurfaces that was not final, chunk by chunk."""
        return self.reading.demands(self)

    @cached_property
    def stages(self) -> tuple[Stage, ...]:
        """All that is wanted until the picture is final, stage after stage; none is empty."""
        return tuple(stage for stage in self.reading.stages(self) if stage.demands)

    @property
    def dark(self) -> frozenset[Index]:
        """The chunks whose light provisional pixels wait for: where some of these have none at all,
        those alone.
        """
        texels = self.texels
        state = self.framebuffer.state.reshape(-1)
        samples = self.reading.samples
        corners = texels.corners[state[texels.gbuffer.pixels] == PROVISIONAL]
        read = np.unique(texels.places[corners[samples[corners] == 0]] >> 3 * texels.lattice.bits)
        if len(read):
            unlit = read[np.maximum.reduceat(samples, texels.bounds[:-1])[read] == 0]
        else:
            unlit = read
        return frozenset(texels.chunks[i] for i in (unlit if len(unlit) else read).tolist())

    @cached_property
    def _weights(self) -> list[float]:
        """The squared visible error that the picture has left in each chunk."""
        found: list[float] = self.texels.weights(self.framebuffer).tolist()
        return found

    def of(
        self,
        reading: Reading,
        lacking: np.ndarray,
        wanted: np.ndarray | None = None,
        shown: Isovalue | None = None,
        like: "Reading | None" = None,
        enough: int | None = None,
    ) -> tuple[Demand, ...]:
        """The demands of the chunks that have texels ``lacking`` light, by what a ``reading`` says
        of these.

        All texels of such a chunk that are ``wanted`` are demanded. Both are (texels,) bool; None
        stands for all. Texels without light are expected to need what those of a reading that they
        are ``like`` do. With ``enough`` samples, by default those of the reading, a texel needs no
        more.
        """
        until = reading.target, enough or reading.enough
        texels = self.texels
        rows = np.flatnonzero(lacking)
        chunks = np.searchsorted(reading.bounds, rows, side="right") - 1
        touched = np.unique(chunks)
        sums = efforts(
            chunks, len(texels.chunks), reading.error[rows], reading.samples[rows], *until
        )
        if like is not None:
            rows, chunks = (each[reading.samples[rows] == 0] for each in (rows, chunks))
            known = like.error[rows], like.samples[rows]
            sums[:, 3] = expected_samples(chunks, len(texels.chunks), *known, *until)

        def _demand(i: int) -> Demand:
            own = slice(*reading.bounds[i : i + 2].tolist())
            some = slice(None) if wanted is None else wanted[own]
            offsets = texels.offsets[i][some]
            seen = texels.footprints[i][some]
            effort = Effort(*sums[i].tolist())
            bits = texels.lattice.bits
            return Demand(texels.chunks[i], offsets, self._weights[i], effort, seen, shown, bits)

        return tuple(map(_demand, touched.tolist()))


GRADES = {UNLIT_ROW: UNBAKED_GRADE, VOID_ROW: VOID_GRADE, BURIED_ROW: BURIED_GRADE}
"""Grades of texels that have no row of light."""


def grade_rows(
    rows: np.ndarray,
    error: np.ndarray,
    samples: np.ndarray,
    target: float,
    enough: int = MAX_SAMPLES,
) -> np.ndarray:
    """How good the light in each row is, after at least so many ``samples`` in each part; (texels,)
    uint8.
    """
    grade = good_enough(error, samples, target, enough).view(np.uint8)
    grade += CONVERGING
    grade[samples == 0] = PARTIAL_GRADE
    if (rows < 0).any():
        for row, own in GRADES.items():
            grade[rows == row] = own
    return grade


NOISE = 3
"""The number of a texel's light, of LIGHT_NUMBERS, that is its standard error."""


@dataclass(frozen=True, eq=False)
class Level:
    """The ``caches`` of the light at a level, and the ``share`` that it has in what is shown."""

    caches: Caches
    share: float = 1.0


@dataclass(frozen=True, eq=False)
class MixedReading(Reading):
    """The readings of the same texels at some levels as one, ``parts``, each with the caches of its
    light.

    Its ``rows`` say which texels hold light at all levels, and nothing of where.
    """

    parts: tuple[tuple[Reading, Caches], ...] = ()

    @property
    def on_surface(self) -> np.ndarray:
        """Which texels are read on the isosurface that is shown, at all levels."""
        return np.logical_and.reduce([reading.on_surface for reading, _ in self.parts])

    @property
    def projects(self) -> bool:
        """Whether texels are projected."""
        return any(reading.projects for reading, _ in self.parts)

    def stages(self, lacking: Lacking) -> tuple[Stage, ...]:
        """What a picture wants of each level, level after level."""
        return tuple(
            replace(stage, caches=caches)
            for reading, caches in self.parts
            for stage in reading.stages(lacking)
        )


def mixed(
    levels: Sequence[Level], found: Sequence[tuple[Reading, np.ndarray]]
) -> tuple[Reading, np.ndarray]:
    """The reading of texels and their light (texels, LIGHT_NUMBERS), mixed of those ``found`` at
    some levels.

    A texel is as good as at the level where it is worst. Where one holds nothing the others stand
    in, with a part of the light while it is to be baked, with all of it while it is buried there.
    """
    if len(found) == 1:
        return found[0]
    readings, lights = zip(*found, strict=True)
    grades = np.stack([reading.grade for reading in readings])
    empty = (grades == BURIED_GRADE) | (grades == UNBAKED_GRADE)
    own = np.where(empty, 0.0, np.array([[level.share] for level in levels])).astype(np.float32)
    shares = own / np.maximum(own.sum(axis=0), np.float32(1e-6))
    light = np.einsum("lt,ltc->tc", shares, np.stack(lights))
    light[:, NOISE] = np.sqrt(
        np.einsum("lt,lt->t", shares**2, np.stack([lit[:, NOISE] for lit in lights]) ** 2)
    )
    rows = np.where(empty.all(axis=0), UNLIT_ROW, 0).astype(np.int32)
    errors = np.where(
        shares > 0.0, np.stack([reading.error for reading in readings]), np.float32(0.0)
    )
    reading = MixedReading(
        rows=rows,
        grade=worst_of(grades),
        version=b"".join(
            [
                *(reading.version for reading in readings),
                repr([each.share for each in levels]).encode(),
            ]
        ),
        samples=np.minimum.reduce([reading.samples for reading in readings]),
        error=np.sqrt((shares**2 * errors**2).sum(axis=0)).astype(np.float32),
        bounds=readings[0].bounds,
        short=np.logical_or.reduce([reading.short for reading in readings]),
        target=readings[0].target,
        enough=readings[0].enough,
        parts=tuple(
            (reading, level.caches) for reading, level in zip(readings, levels, strict=True)
        ),
    )
    return reading, np.ascontiguousarray(light, np.float32)


def worst_of(grades: np.ndarray) -> np.ndarray:
    """The worst of texels' ``grades`` (levels, texels); partly lit where one alone has no light,
    buried where all are.

    Whether a texel is void follows from its own place, and so at all levels.
    """
    worst = grades.min(axis=0)
    lit = ((grades != UNBAKED_GRADE) & (grades != BURIED_GRADE)).any(axis=0)
    worst[lit & (worst == UNBAKED_GRADE)] = PARTIAL_GRADE
    return np.asarray(worst, np.uint8)
