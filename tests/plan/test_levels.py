"""Levels that light of pinned surfaces is kept for, and how views mix them."""

import numpy as np
import pytest

from isogi_core.model.volume import make_volume
from isogi_core.plan.surfaces import find_levels, levels_around
from tests.frame.conftest import ball

LEVELS = (10.0, 20.0, 40.0, 50.0)


def test_a_surface_moves_a_voxel_from_level_to_level() -> None:
    """Of a distance field that is the distance itself, whatever it is multiplied by."""
    slow, fast = ball(), make_volume(7.0 * ball().voxels, (1.0, 1.0, 1.0))
    levels = np.array(find_levels(slow, (-4.0, 8.0), []))
    assert len(levels) == pytest.approx(13, abs=1)
    np.testing.assert_allclose(np.diff(levels), 12.0 / (len(levels) - 1), atol=0.1)
    assert len(find_levels(fast, fast.value_range, [])) == len(find_levels(slow, slow.value_range, []))


def test_steep_parts_of_a_range_have_few_levels() -> None:
    """Where a field is 20 times as steep, levels are 20 times as far apart: surfaces are as near as elsewhere."""
    away = ball().voxels.astype(np.float64) * ball().scale + ball().offset
    steep = make_volume(np.where(away > 2.0, 2.0 + 20.0 * (away - 2.0), away).astype(np.float32), (1.0, 1.0, 1.0))
    levels = np.array(find_levels(steep, (-4.0, 122.0), [62.0]))
    assert 62.0 in levels
    ways = np.where(levels > 2.0, 2.0 + (levels - 2.0) / 20.0, levels)
    np.testing.assert_allclose(np.diff(ways), 12.0 / (len(ways) - 1), atol=0.3)


def test_a_range_of_one_isovalue_has_one_level() -> None:
    assert find_levels(ball(), (2.0, 2.0), [2.0]) == (2.0,)


@pytest.mark.parametrize(
    ("shown", "expected"),
    [(20.0, {20.0: 1.0}), (25.0, {20.0: 0.75, 40.0: 0.25}), (10.0, {10.0: 1.0}), (60.0, {60.0: 1.0})],
)
def test_views_mix_the_levels_around_theirs(shown: float, expected: dict[float, float]) -> None:
    assert dict(levels_around(LEVELS, [], shown)) == expected


def test_light_is_not_mixed_across_a_pinned_surface() -> None:
    assert levels_around(LEVELS, [41.0], 45.0) == ((45.0, 1.0),)
    assert levels_around(LEVELS, [40.0], 39.0) == ((39.0, 1.0),)
    assert len(levels_around(LEVELS, [41.0], 35.0)) == 2
