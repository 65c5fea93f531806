"""Light between two levels of the isovalue that slides: what texels of a pinned surface hold at both is mixed."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from isogi_core.cache.scene_caches import Caches
from isogi_core.frame.texel_reading import Lacking, Reading, Stage
from isogi_core.kernels.shading.lattice import BURIED_GRADE, PARTIAL_GRADE, UNBAKED_GRADE, UNLIT_ROW

NOISE = 3
"""The number of a texel's light, of LIGHT_NUMBERS, that is its standard error."""


@dataclass(frozen=True, eq=False)
class Level:
    """The ``caches`` of the light at a level, and the ``share`` that it has in what is shown."""

    caches: Caches
    share: float = 1.0


@dataclass(frozen=True, eq=False)
class MixedReading(Reading):
    """The readings of the same texels at some levels as one, ``parts``, each with the caches of its light.

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
            replace(stage, caches=caches) for reading, caches in self.parts for stage in reading.stages(lacking)
        )


def mixed(levels: Sequence[Level], found: Sequence[tuple[Reading, np.ndarray]]) -> tuple[Reading, np.ndarray]:
    """The reading of texels and their light (texels, LIGHT_NUMBERS), mixed of those ``found`` at some levels.

    A texel is as good as at the level where it is worst. Where one holds nothing the others stand in, with a part of
    the light while it is to be baked, with all of it while it is buried there.
    """
    if len(found) == 1:
        return found[0]
    readings, lights = zip(*found, strict=True)
    grades = np.stack([reading.grade for reading in readings])
    empty = (grades == BURIED_GRADE) | (grades == UNBAKED_GRADE)
    own = np.where(empty, 0.0, np.array([[level.share] for level in levels])).astype(np.float32)
    shares = own / np.maximum(own.sum(axis=0), np.float32(1e-6))
    light = np.einsum("lt,ltc->tc", shares, np.stack(lights))
    light[:, NOISE] = np.sqrt(np.einsum("lt,lt->t", shares**2, np.stack([lit[:, NOISE] for lit in lights]) ** 2))
    rows = np.where(empty.all(axis=0), UNLIT_ROW, 0).astype(np.int32)
    errors = np.where(shares > 0.0, np.stack([reading.error for reading in readings]), np.float32(0.0))
    reading = MixedReading(
        rows=rows,
        grade=worst_of(grades),
        version=b"".join([*(reading.version for reading in readings), repr([each.share for each in levels]).encode()]),
        samples=np.minimum.reduce([reading.samples for reading in readings]),
        error=np.sqrt((shares**2 * errors**2).sum(axis=0)).astype(np.float32),
        bounds=readings[0].bounds,
        short=np.logical_or.reduce([reading.short for reading in readings]),
        target=readings[0].target,
        enough=readings[0].enough,
        parts=tuple((reading, level.caches) for reading, level in zip(readings, levels, strict=True)),
    )
    return reading, np.ascontiguousarray(light, np.float32)


def worst_of(grades: np.ndarray) -> np.ndarray:
    """The worst of texels' ``grades`` (levels, texels); partly lit where one alone has no light, buried where all are.

    Whether a texel is void follows from its own place, and so at all levels.
    """
    worst = grades.min(axis=0)
    lit = ((grades != UNBAKED_GRADE) & (grades != BURIED_GRADE)).any(axis=0)
    worst[lit & (worst == UNBAKED_GRADE)] = PARTIAL_GRADE
    return np.asarray(worst, np.uint8)
