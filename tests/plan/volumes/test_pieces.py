"""Small pieces taken out, against the components of every level."""

from collections import deque
from pathlib import Path

import numpy as np
import pytest

from isogi_core.errors import SceneError, VolumeError
from isogi_core.files.grid import Grid
from isogi_core.plan.volumes import pieces
from isogi_core.plan.volumes.pieces import LargestAt, without_small_pieces
from tests.loaded import load_scene


def large_parts(solid: np.ndarray, least: int) -> np.ndarray:
    """The voxels of ``solid`` in components of ``least`` or more, neighbours sharing a corner."""
    left = {tuple(map(int, place)) for place in np.argwhere(solid)}
    kept = np.zeros(solid.shape, bool)
    steps = [tuple(step) for step in np.argwhere(np.ones((3, 3, 3))) - 1]
    while left:
        start = left.pop()
        found, waiting = [start], deque([start])
        while waiting:
            place = waiting.popleft()
            for step in steps:
                beside = tuple(a + b for a, b in zip(place, step, strict=True))
                if beside in left:
                    left.remove(beside)
                    found.append(beside)
                    waiting.append(beside)
        if len(found) >= least:
            kept[tuple(np.array(found).T)] = True
    return kept


@pytest.mark.parametrize("solid", ["above", "below"])
@pytest.mark.parametrize("least", [1, 2, 5, 30])
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_each_level_keeps_its_large_pieces_alone(solid: str, least: int, dtype: type) -> None:
    rng = np.random.default_rng(least)
    values = rng.integers(0, 9, (7, 6, 9)).astype(dtype)
    found = without_small_pieces(Grid.of(values), least, solid).whole()
    assert found.dtype == dtype
    for level in range(9):
        sides = (values > level, found > level)
        before, after = sides if solid == "above" else tuple(~side for side in sides)
        if before.sum() >= least and (~before).any():
            assert (after == large_parts(before, least)).all()


def test_holes_stay_and_part_pieces() -> None:
    values = np.zeros((3, 3, 9), np.float32)
    values[1, 1, 1:8] = 5.0
    values[:, :, 4] = np.nan
    found = without_small_pieces(Grid.of(values), 4, "above").whole()
    assert np.isnan(found[:, :, 4]).all()
    assert (found[:, :, :4] == 0.0).all() and (found[:, :, 5:] == 0.0).all()


def test_a_scene_without_specks_has_other_light(tmp_path: Path) -> None:
    voxels = np.zeros((12, 12, 12), np.uint8)
    voxels[2:8, 2:8, 2:8] = 200
    voxels[10, 10, 10] = 255
    np.save(tmp_path / "v.npy", voxels)
    plain = load_scene(tmp_path / "v.npy", isovalue=100)
    kept = load_scene(f"{tmp_path}/v.npy#pieces=8", isovalue=100)
    assert kept.volume.dtype == "uint8" and kept.bake_digest != plain.bake_digest
    assert kept.volume.value_range == (0.0, 200.0)
    for wrong in (-1, 2.5, "large", "largest"):  # the largest at no isovalue
        with pytest.raises(SceneError, match="pieces"):
            load_scene(tmp_path / "v.npy", pieces=wrong)


@pytest.mark.parametrize("solid", ["above", "below"])
def test_the_largest_piece_is_left_at_its_isovalue(solid: str) -> None:
    rng = np.random.default_rng(5)
    values = rng.random((9, 8, 10)).astype(np.float32)
    isovalue = 0.87 if solid == "above" else 0.13
    inside = values > isovalue if solid == "above" else values < isovalue
    found = without_small_pieces(Grid.of(values), LargestAt(isovalue), solid).whole()
    left = found > isovalue if solid == "above" else found < isovalue
    sizes = [least for least in range(1, 99) if large_parts(inside, least).any()]
    assert (left == large_parts(inside, sizes[-1])).all()
    assert 0 < left.sum() < inside.sum() and left.sum() == sizes[-1]


def test_a_scene_shows_its_largest_piece(tmp_path: Path) -> None:
    voxels = np.zeros((12, 12, 16), np.uint8)
    voxels[2:8, 2:8, 2:8] = 200
    voxels[2:7, 2:8, 10:15] = 250
    np.save(tmp_path / "v.npy", voxels)
    kept = load_scene(tmp_path / "v.npy", isovalue=100, pieces="largest")
    assert kept.volume.value_range == (0.0, 200.0)
    left = np.asarray(kept.volume.voxels) > kept.volume.voxels.min()
    assert left[2:8, 2:8, 2:8].all() and left.sum() == 216
    one = load_scene(tmp_path / "v.npy", isovalue=225, pieces="largest")
    assert one.volume.value_range == (0.0, 250.0), "one piece alone stays"
    voxels[2:8, 2:8, 10:16] = 250
    np.save(tmp_path / "v.npy", voxels)
    with pytest.raises(VolumeError, match="216 voxels each"):
        load_scene(tmp_path / "v.npy", isovalue=100, pieces="largest")


def test_what_does_not_fit_into_memory_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pieces, "BYTES_PER_VOXEL", 1 << 40)
    with pytest.raises(VolumeError, match="too large"):
        without_small_pieces(Grid.of(np.zeros((3, 3, 3), np.uint8)), 2, "above")
