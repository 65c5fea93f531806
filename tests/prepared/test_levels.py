"""Levels: even parts of the core, and ranks where nearly all values lie in one of them."""

import numpy as np

from isogi_core.prepared.active_cell_maps import (
    CORE_GROUPS,
    CROWDED_SHARE,
    NEAR_ZERO_LEVEL,
    ActiveCellMaps,
    find_levels,
)

EVEN = np.random.default_rng(1).random((20, 21, 22)).astype(np.float32)
UNIFORM = [-np.inf, 0.0, NEAR_ZERO_LEVEL, *(np.arange(1, CORE_GROUPS + 1) / CORE_GROUPS), np.inf]


def crowd(voxels: np.ndarray) -> float:
    """The largest share of the voxels between two levels that follow each other."""
    return float(np.histogram(voxels, find_levels(voxels)[1:-1])[0].max() / voxels.size)


def test_even_values_have_even_levels() -> None:
    assert find_levels(EVEN).tolist() == UNIFORM


def test_holes_change_no_level() -> None:
    assert find_levels(np.where(EVEN < 0.3, np.float32(np.nan), EVEN)).tolist() == UNIFORM


def test_a_mask_has_even_levels() -> None:
    assert find_levels((EVEN > 0.99).astype(np.float32)).tolist() == UNIFORM


def test_crowded_values_are_parted_by_rank() -> None:
    squeezed = EVEN / 100
    squeezed[0, 0, 0] = 1.0
    assert np.histogram(squeezed, UNIFORM[1:-1])[0].max() > CROWDED_SHARE * squeezed.size
    assert crowd(squeezed) < 1.1 / CORE_GROUPS
    levels = find_levels(squeezed)
    assert (np.diff(levels) > 0).all() and set(UNIFORM) <= set(levels.tolist())


def test_values_beyond_the_core_are_parted_too() -> None:
    assert crowd(EVEN * np.float32(1e30) + 2) < 1.1 / CORE_GROUPS


def test_groups_are_two_levels_wide_and_hold_their_isovalues() -> None:
    for voxels in (EVEN, np.concatenate([EVEN / 100, EVEN[:1] + 1])):
        maps = ActiveCellMaps(voxels)
        isovalues = np.concatenate([voxels.ravel()[::7].astype(np.float64), [-1e36, 0.0, 1.0, 1e36]])
        groups, spans = maps.groups(isovalues)
        assert (spans[groups, 0] <= isovalues).all() and (isovalues < spans[groups, 1]).all()
        assert set(spans.ravel().tolist()) <= set(maps.levels.tolist()) and len(spans) <= len(maps.levels) // 2 + 1


def test_empty_space_at_zero_is_in_no_map_of_isovalues_above() -> None:
    voxels = np.zeros((40, 40, 40), np.float32)
    voxels[18:22, 18:22, 18:22] = 1.0
    maps = ActiveCellMaps(voxels)
    groups, spans = maps.groups(np.array([1e-3, 0.999]))
    wide = maps.covering(np.array([spans[groups[0], 0], spans[groups[1], 1]]))
    assert np.count_nonzero((wide.tops >> 28) == 0) <= 27 < wide.tops.size
