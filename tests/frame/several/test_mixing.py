"""Light of two levels as one reading."""

from typing import Any, cast

import numpy as np
import pytest

from isogi_core.cache.scene_caches import Caches
from isogi_core.frame.texel_reading import Level, MixedReading, Reading, mixed
from isogi_core.kernels.shading.framebuffer import CONVERGING, FINAL
from isogi_core.kernels.shading.lattice import BURIED_GRADE, LIGHT_NUMBERS, PARTIAL_GRADE, UNBAKED_GRADE, VOID_GRADE
from isogi_core.model.scene_plan import MAX_SAMPLES

ONE, OTHER = cast(Caches, "one"), cast(Caches, "other")
LEVELS = (Level(ONE, 0.75), Level(OTHER, 0.25))


def reading(grades: list[int], error: float) -> Reading:
    grade = np.array(grades, np.uint8)
    rows = np.where(np.isin(grade, (UNBAKED_GRADE, BURIED_GRADE, VOID_GRADE)), -1, 0).astype(np.int32)
    samples, errors = np.full(len(grade), 64, np.int32), np.full(len(grade), error, np.float32)
    short = np.array([(grade < FINAL).any()])
    return Reading(rows, grade, bytes(grades), samples, errors, np.array([0, len(grade)]), short, 0.02, MAX_SAMPLES)


def mix(one: list[int], other: list[int]) -> tuple[Reading, np.ndarray]:
    """What two levels are together where all texels have light 1 and 3, and noise 0.1 and 0.2."""
    lights = [np.full((len(one), LIGHT_NUMBERS), light, np.float32) for light in (1.0, 3.0)]
    for light, noise in zip(lights, (0.1, 0.2), strict=True):
        light[:, 3] = noise
    return mixed(LEVELS, [(reading(one, 0.01), lights[0]), (reading(other, 0.04), lights[1])])


def test_light_is_mixed_by_shares_and_noise_as_independent() -> None:
    found, lit = mix([FINAL], [CONVERGING])
    np.testing.assert_allclose(lit[0, [0, 1, 2, 4, 5, 6]], 1.5)
    assert lit[0, 3] == pytest.approx(np.hypot(0.075, 0.05))
    assert found.error[0] == pytest.approx(np.hypot(0.0075, 0.01))
    assert found.grade.tolist() == [CONVERGING] and found.short.all() and found.whole


@pytest.mark.parametrize(
    ("one", "other", "grade", "light"),
    [
        (FINAL, UNBAKED_GRADE, PARTIAL_GRADE, 1.0),
        (BURIED_GRADE, FINAL, FINAL, 3.0),
        (BURIED_GRADE, CONVERGING, CONVERGING, 3.0),
        (BURIED_GRADE, BURIED_GRADE, BURIED_GRADE, 0.0),
        (UNBAKED_GRADE, BURIED_GRADE, UNBAKED_GRADE, 0.0),
        (VOID_GRADE, VOID_GRADE, VOID_GRADE, 1.5),
    ],
)
def test_where_a_level_holds_nothing_the_other_stands_in(one: int, other: int, grade: int, light: float) -> None:
    found, lit = mix([one], [other])
    assert found.grade.tolist() == [grade]
    assert lit[0, 0] == pytest.approx(light)


def test_each_level_is_baked_by_its_own_caches() -> None:
    found, _ = mix([CONVERGING], [FINAL])
    assert isinstance(found, MixedReading)

    class Nothing:
        """A picture that lacks what is asked of it."""

        def of(self, reading: Reading, *_: Any) -> tuple[Reading]:
            return (reading,)

    stages = found.stages(cast(Any, Nothing()))
    assert [stage.caches for stage in stages] == [ONE, OTHER]


def test_one_level_is_read_as_it_is() -> None:
    single = reading([FINAL], 0.01), np.zeros((1, LIGHT_NUMBERS), np.float32)
    assert mixed(LEVELS[:1], [single]) is single
