"""Mix the light of texels at several levels, for pinned surfaces while another one slides."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from isogi_core.cache.scene_caches import Caches
from isogi_core.frame.texel_reading import Lacking, Reading, Stage
from isogi_core.kernels.shading.lattice import BURIED_GRADE, PARTIAL_GRADE, UNBAKED_GRADE, UNLIT_ROW

NOISE = 3
"""Column of the standard error among the LIGHT_NUMBERS of a texel."""


@dataclass(frozen=True, eq=False)
class Level:
    """The ``caches`` of light at a level, and its ``share`` in the light that is shown."""

    caches: Caches
    share: float = 1.0


@dataclass(frozen=True, eq=False)
class MixedReading(Reading):
    """A reading of the same texels at several levels, ``parts``, as one; each with the caches of
    its light.

    ``rows`` are 0 for texels that hold light at some level, and UNLIT_ROW for all others.
    """

    parts: tuple[tuple[Reading, Caches], ...] = ()

    @property
    def on_surface(self) -> np.ndarray:
        """Mark texels that are read on the isosurface of the view at all levels; (texels,) bool."""
        return np.logical_and.reduce([reading.on_surface for reading, _ in self.parts])

    @property
    def projects(self) -> bool:
        """True if texels are projected at some level."""
        return any(reading.projects for reading, _ in self.parts)

    def stages(self, lacking: Lacking) -> tuple[Stage, ...]:
        """Return the light that a picture lacks at each level, level after level."""
        return tuple(
            replace(stage, caches=caches)
            for reading, caches in self.parts
            for stage in reading.stages(lacking)
        )


def mixed(
    levels: Sequence[Level], found: Sequence[tuple[Reading, np.ndarray]]
) -> tuple[Reading, np.ndarray]:
    """Mix the readings of texels, and their light (texels, LIGHT_NUMBERS), that were ``found`` at
    several levels.

    A texel has the grade of ``worst_of``. If it holds no light at some level, the others stand
    in: with their share alone while it is to be baked, with all of the light if it is buried there.
    """
    if len(found) == 1:
        return found[0]
    readings, lights = zip(*found, strict=True)
    grades = np.stack([reading.grade for reading in readings])
    empty = (grades == BURIED_GRADE) | (grades == UNBAKED_GRADE)
    # Distribute the shares of levels without light over the others.
    kept = np.where(empty, 0.0, np.array([[level.share] for level in levels])).astype(np.float32)
    shares = kept / np.maximum(kept.sum(axis=0), np.float32(1e-6))
    # Light is a weighted mean; its errors are independent, so their squares add up.
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
        goal=readings[0].goal,
        rough=any(reading.rough for reading in readings),
        parts=tuple(
            (reading, level.caches) for reading, level in zip(readings, levels, strict=True)
        ),
    )
    return reading, np.ascontiguousarray(light, np.float32)


def worst_of(grades: np.ndarray) -> np.ndarray:
    """Return the worst grade of each texel at any level, by its ``grades`` (levels, texels);
    (texels,) uint8.

    A texel that is unbaked at some level and has light at another one is partly lit. Levels at
    which it is buried count only if it is buried at all of them. Void texels are so by their
    position, and thus at all levels.
    """
    # Grades ascend from UNBAKED_GRADE over those of light to BURIED_GRADE.
    worst = grades.min(axis=0)
    lit = ((grades != UNBAKED_GRADE) & (grades != BURIED_GRADE)).any(axis=0)
    worst[lit & (worst == UNBAKED_GRADE)] = PARTIAL_GRADE
    return np.asarray(worst, np.uint8)
