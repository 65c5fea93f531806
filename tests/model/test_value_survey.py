"""The core of values: what is taken for an outlier, and what is not."""

import numpy as np
import pytest

from isogi_core.files.grid import Grid
from isogi_core.model import value_survey
from isogi_core.model.value_survey import MAX_SURVEYED_VOXELS, find_core, sample_values, survey
from isogi_core.model.volume import Volume

RAMP = np.linspace(0.0, 1.0, 200)
BYTES = np.arange(256, dtype=np.uint8)


@pytest.mark.parametrize(
    ("values", "core"),
    [
        (RAMP, (0.0, 1.0)),
        ([*RAMP, 1e30], (0.0, 1.0)),
        ([*RAMP, 1e30, 1e300], (0.0, 1.0)),
        ([-1e34, -9999.0, *RAMP, 1e30], (0.0, 1.0)),
        ([*RAMP, 1e6, 3e6], (0.0, 1.0)),
        ([*RAMP, 1000.0], (0.0, 1000.0)),
        (1e9 + RAMP, (1e9, 1e9 + 1)),
        ([-9999.0, *(1e9 + RAMP)], (1e9, 1e9 + 1)),
        (RAMP * 1e-300, (0.0, 1e-300)),
        ((2 * RAMP - 1) * 1.79e308, (-1.79e308, 1.79e308)),
        ([-1.79e308, *RAMP, 1.79e308], (0.0, 1.0)),
        ([0.0, 1.0, 1e30], (0.0, 1.0)),
        ([0.0, 1e30], (0.0, 1e30)),
        ([0.0, 1.0, 1e30, 1e30 + 1e29], (0.0, 1.1e30)),
        ([5.0], (5.0, 5.0)),
        (np.exp(-11.0 * np.arange(60)[::-1]), (np.exp(-649.0), 1.0)),
        (BYTES, (0, 255)),
        (np.array([-128, 127], np.int8), (-128, 127)),
        (np.array([0, *range(2**60, 2**60 + 99)], np.int64), (2**60, 2**60 + 98)),
        (np.array([-(2**63), *range(99)], np.int64), (0, 98)),
        (np.array([*range(99), 2**64 - 1], np.uint64), (0, 98)),
        (np.array([*range(2**63, 2**63 + 99), 2**64 - 1], np.uint64), (2**63, 2**63 + 98)),
    ],
)
def test_core(values: list[float], core: tuple[float, float]) -> None:
    found = find_core(np.asarray(values))
    assert found == core and all(type(end) in (int, float) for end in found)


def test_the_sample_has_every_column_of_a_large_volume() -> None:
    columns = np.broadcast_to(np.arange(512, dtype=np.int16), (64, 128, 512))
    assert columns.size > MAX_SURVEYED_VOXELS
    assert sample_values(columns).tolist() == list(range(512))


def test_the_sample_is_distinct_finite_and_ascending() -> None:
    values = np.array([3.0, np.nan, 1.0, np.inf, 1.0, -np.inf, -2.0, 3.0], ">f4").reshape(2, 2, 2)
    assert sample_values(values).tolist() == [-2.0, 1.0, 3.0]


@pytest.mark.parametrize("kind", ["u1", "<i2", ">i2", "?"])
def test_values_that_are_counted_make_the_same_volume(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = np.random.default_rng(3).integers(-90, 90, (5, 6, 7)).astype(kind)
    drawn[0, 0, 0] = 9999.0 if drawn.dtype.itemsize == 2 else 200
    grid, missing = Grid.of(drawn), (3.0,)
    looked = survey(grid, "below", missing)
    monkeypatch.setattr(value_survey, "MAX_UNSAMPLED_VOXELS", 0)
    counted = survey(grid, "below", missing)
    assert looked.tally is None and counted.tallied()
    voxels = [np.stack(list(each.planes())) for each in (looked, counted)]
    np.testing.assert_array_equal(*voxels)
    assert looked.facts("v", "") == counted.facts("v", "")
    volume = Volume(voxels[0], **looked.facts("v", ""))
    known = [volume.counted(16, tally=each.tallied()) for each in (looked, counted)]
    assert (known[0].counts, known[0].span) == (known[1].counts, known[1].span)
