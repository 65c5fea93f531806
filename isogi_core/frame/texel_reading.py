"""The reading of a view: where the light of its texels is in the page pool, how good it is, and
the light that it still lacks.
"""

import hashlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from isogi_core.bake.noise import RATE, Effort, Goal, efforts, expected_samples, good_enough
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
from isogi_core.model.volume import Isovalue
from isogi_core.prepared.prepared_scene import Index

GRAIN = 0.01
"""Relative noise of a texel below which it needs no filter: half of it remains in pixels, a
step of eight bits.
"""


TEXELS_A_PIECE = 16384
"""Texels that are looked up and digested together; the same for any number of threads."""


@dataclass(frozen=True, eq=False)
class Reading:
    """The light that a view's texels hold, (texels,) each; valid until the page pool changes.

    - ``rows`` int32: rows of the pool, negative if the texel holds no light.
    - ``grade`` uint8: UNBAKED_GRADE, PARTIAL_GRADE, CONVERGING, FINAL, BURIED_GRADE or VOID_GRADE.
    - ``version``: a digest of the sample counts, from which the light follows.
    - ``samples`` int32: fewest samples of any part of the light.
    - ``error`` float32: relative error by noise.
    - ``bounds``: texels of chunk i are ``bounds[i]`` … ``bounds[i + 1]``.
    - ``short`` (chunks,) bool: True for chunks with texels that lack light.
    - ``goal``: of the picture; it decides which texels are final.
    - ``rough``: True if the noise of each texel is estimated roughly; see ``BakeSpec.rough``.
    """

    rows: np.ndarray
    grade: np.ndarray
    version: bytes
    samples: np.ndarray
    error: np.ndarray
    bounds: np.ndarray
    short: np.ndarray
    goal: Goal
    rough: bool

    @property
    def nbytes(self) -> int:
        """The size of its arrays in bytes, without the bounds."""
        return sum(
            each.nbytes for each in (self.rows, self.grade, self.samples, self.error, self.short)
        )

    @property
    def unbaked(self) -> bool:
        """True if no texel holds light."""
        return bool((self.grade == UNBAKED_GRADE).all())

    @property
    def whole(self) -> bool:
        """True if every texel holds light."""
        return not (self.rows < 0).any()

    @property
    def lit(self) -> np.ndarray:
        """Mark texels that show light of paths; (texels,) bool."""
        return np.asarray((self.grade == CONVERGING) | (self.grade == FINAL))

    @property
    def noisy(self) -> np.ndarray:
        """Mark lit texels with more noise than the goal allows each of them alone; (texels,)
        bool.
        """
        return np.asarray(
            self.lit
            & (self.samples > 0)
            & ~good_enough(self.error, self.samples, Goal(self.goal.error))
        )

    @property
    def grainy(self) -> np.ndarray:
        """Mark lit texels whose light is filtered for its noise, even if they need no more
        samples; (texels,) bool.

        If noise is estimated roughly, all are: a texel whose noise seems small by chance would
        keep it, and be seen among its filtered neighbours. The filter goes by their mean noise.
        """
        sampled = self.lit & (self.samples > 0)
        if self.rough:
            return np.asarray(sampled)
        return np.asarray(sampled & (self.error > GRAIN))

    @property
    def rung(self) -> int:
        """The fewest samples of any noisy texel; the most samples of any texel if none is noisy."""
        noisy = self.samples[self.noisy]
        return int(noisy.min() if len(noisy) else self.samples.max(initial=0))

    @cached_property
    def effort(self) -> float:
        """The number of samples that bring a texel to the relative error 1, in the median: an error
        e takes 1 / e^RATE of them. 0 if no texel is lit.

        Dark texels take many more, and are little of a picture's light.
        """
        lit = self.samples > 0
        if lit.any():
            return float(np.median(self.samples[lit] * self.error[lit] ** RATE))
        return 0.0

    @property
    def on_surface(self) -> np.ndarray:
        """Mark texels that are read on the isosurface of the view, and not on their own;
        (texels,) bool.
        """
        return np.zeros(len(self.rows), np.bool_)

    @property
    def projects(self) -> bool:
        """True if texels that are far from the isosurface of the view are projected onto it."""
        return False

    def sources(self, pool: PagePool) -> tuple[tuple[np.ndarray, PagePool], ...]:
        """Return rows of light, and the pool that each of these is in; here all are in the
        ``pool`` that was read.
        """
        return ((self.rows, pool),)

    def demands(self, lacking: "Lacking") -> tuple[Demand, ...]:
        """Return the light on texels' own isosurfaces that is not final, for a picture that is
        ``lacking`` it.
        """
        return lacking.of(self, self.grade < FINAL)

    def stages(self, lacking: "Lacking") -> tuple["Stage", ...]:
        """Return the light that a picture is ``lacking``, stage after stage."""
        return (Stage(self.demands(lacking), self.goal),)


def read_texels(
    texels: ViewTexels, slots: np.ndarray, pool: PagePool, goal: Goal, tiles: Tiles
) -> Reading:
    """Look up a view's texels in the ``pool``, at the ``slots`` of its chunks. The ``goal``
    decides which light is final.
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
        grade[a:b] = grade_rows(rows[a:b], error[a:b], samples[a:b], goal)
        digests[a] = hashlib.sha256(stamp.data).digest()

    tiles.run(_piece, len(places), TEXELS_A_PIECE)
    if len(grade):
        # A chunk is short of light if the lowest grade of its texels is.
        short = np.minimum.reduceat(grade, texels.bounds[:-1]) < FINAL
    else:
        short = np.zeros(0, np.bool_)
    # Digests are joined in the order of the texels, whichever thread was first.
    version = b"".join(digests[a] for a in sorted(digests))
    return Reading(
        rows, grade, version, samples, error, texels.bounds, short, goal, pool.spec.rough
    )


@dataclass(frozen=True, eq=False)
class Stage:
    """A stage of the light that a picture lacks: ``demands`` of one bake, and the ``goal`` of
    their texels.

    ``caches`` are those of the light, if it is not that of the outer side of the surface that
    slides.
    """

    demands: tuple[Demand, ...]
    goal: Goal
    caches: Caches | None = None

    @property
    def shown(self) -> Isovalue | None:
        """The isosurface that its texels are projected onto; None if they lie on their own."""
        if self.demands:
            return self.demands[0].shown
        return None


@dataclass(frozen=True, eq=False)
class Lacking:
    """The light that the picture in a ``framebuffer`` still lacks of its ``texels``, by their
    ``reading``.
    """

    texels: ViewTexels
    reading: Reading
    framebuffer: Framebuffer

    @cached_property
    def demands(self) -> tuple[Demand, ...]:
        """The light on texels' own isosurfaces that is not final, chunk by chunk."""
        return self.reading.demands(self)

    @cached_property
    def stages(self) -> tuple[Stage, ...]:
        """All light that must be baked until the picture is final, stage after stage; none is
        empty.
        """
        return tuple(stage for stage in self.reading.stages(self) if stage.demands)

    @property
    def dark(self) -> frozenset[Index]:
        """The chunks whose light provisional pixels wait for; if some of these chunks have no
        light at all, those alone.
        """
        texels = self.texels
        state = self.framebuffer.state.reshape(-1)
        samples = self.reading.samples
        # Find the texels without samples among those that provisional pixels read.
        corners = texels.corners[state[texels.gbuffer.pixels] == PROVISIONAL]
        read = np.unique(texels.places[corners[samples[corners] == 0]] >> 3 * texels.lattice.bits)
        if len(read):
            # Chunks without any light come first.
            unlit = read[np.maximum.reduceat(samples, texels.bounds[:-1])[read] == 0]
            if len(unlit):
                read = unlit
        return frozenset(texels.chunks[i] for i in read.tolist())

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
        samples: int | None = None,
    ) -> tuple[Demand, ...]:
        """Return the demands for the chunks that have texels ``lacking`` light, (texels,) bool.

        - ``wanted`` (texels,) bool: texels that are demanded of such a chunk; by default all.
        - ``shown``: isosurface that texels are projected onto, if they are.
        - ``like``: reading by which the samples of texels without light are predicted.
        - ``samples``: number of samples after which a texel needs no more; by default the goal's.
        """
        goal = reading.goal
        if samples is not None:
            goal = goal._replace(samples=samples)
        texels = self.texels
        rows = np.flatnonzero(lacking)
        chunks = np.searchsorted(reading.bounds, rows, side="right") - 1
        touched = np.unique(chunks)
        # Add up the samples that texels of each chunk have taken and will take.
        sums = efforts(chunks, len(texels.chunks), reading.error[rows], reading.samples[rows], goal)
        # Projected texels without light are expected to need as many samples as the same texels on
        # their own isosurfaces.
        if like is not None:
            rows, chunks = (each[reading.samples[rows] == 0] for each in (rows, chunks))
            known = like.error[rows], like.samples[rows]
            sums[:, 3] = expected_samples(chunks, len(texels.chunks), *known, goal)

        def _demand(i: int) -> Demand:
            some: slice | np.ndarray = slice(None)
            if wanted is not None:
                some = wanted[reading.bounds[i] : reading.bounds[i + 1]]
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
    goal: Goal,
) -> np.ndarray:
    """Return the grade of the light in each row, by its ``error``, its ``samples`` and the ``goal``
    of the picture; (texels,) uint8.
    """
    # A boolean is 0 or 1, so adding CONVERGING makes FINAL of good light. The samples are those of
    # the layer that has the fewest: with none, some layers are not baked yet.
    grade = good_enough(error, samples, goal).view(np.uint8)
    grade += CONVERGING
    grade[samples == 0] = PARTIAL_GRADE
    if (rows < 0).any():
        for row, grade_of_row in GRADES.items():
            grade[rows == row] = grade_of_row
    return grade
