"""Voxel codes: the smallest numbers that hold a volume's voxels exactly."""

from typing import Any

import numpy as np
import pytest

from isogi_core.model.volume import make_volume
from isogi_core.prepared.active_cell_maps import HOLE_CODE, SLAB_CODE_BYTES, VoxelCodes, find_codes

RNG = np.random.default_rng(3)


def numbers(low: int, high: int, kind: Any) -> np.ndarray:
    return RNG.integers(low, high, (6, 7, 9), endpoint=True).astype(kind)


@pytest.mark.parametrize("solid", ["above", "below"])
@pytest.mark.parametrize(
    ("array", "kind"),
    [
        (numbers(0, 255, np.uint8), "uint8"),
        (numbers(40, 90, np.uint8), "uint8"),
        (numbers(-128, 127, np.int8), "uint8"),
        (numbers(-1024, 3071, np.int16), "uint16"),
        (numbers(7_000_000, 7_000_200, np.int32), "uint8"),
        (numbers(0, 1 << 20, np.int32), "float32"),
        (RNG.normal(size=(6, 7, 9)).astype(np.float32), "float32"),
        (numbers(0, 255, np.uint8).astype(np.float32), "float32"),
    ],
)
def test_codes_are_voxels_exactly(array: np.ndarray, kind: str, solid: str) -> None:
    volume = make_volume(array, solid=solid)
    codes = find_codes(volume)
    found = codes.code(volume.voxels)
    assert (codes.kind, found.dtype) == (kind, np.dtype(kind))
    assert np.array_equal((codes.base + codes.gain * found.astype(np.float64)).astype(np.float32), volume.voxels)
    assert codes.gain > 0.0 and np.log2(codes.gain) % 1.0 == 0.0
    assert codes.nbytes == found.nbytes


def test_codes_keep_the_side_of_an_isovalue() -> None:
    """Also of isovalues that are voxels themselves, and where what is below is solid."""
    array = numbers(3, 250, np.uint8)
    for solid in ("above", "below"):
        volume = make_volume(array, solid=solid)
        codes = find_codes(volume)
        for isovalue in (3.0, 70.0, 70.5, 250.0):
            level = float(volume.normalise_isovalue(isovalue))
            inside = codes.code(volume.voxels) > (level - codes.base) / codes.gain
            assert np.array_equal(inside, volume.voxels > level)


def test_holes_are_a_number_below_all_others() -> None:
    array = RNG.normal(size=(6, 7, 9)).astype(np.float32)
    array[2, 3, 4] = np.nan
    volume = make_volume(array)
    codes = find_codes(volume)
    found = codes.code(volume.voxels)
    assert codes.hole == HOLE_CODE and found[2, 3, 4] == np.float32(HOLE_CODE)
    assert np.isfinite(found).all() and (found == np.float32(HOLE_CODE)).sum() == 1


def test_holes_among_whole_numbers_stay_apart() -> None:
    array = numbers(0, 250, np.uint8)
    array[1, 2, 3] = 7
    volume = make_volume(array, missing=[7.0])
    codes = find_codes(volume)
    assert codes.kind == "float32" and (codes.code(volume.voxels) == np.float32(HOLE_CODE)).sum() == volume.holes > 0


def test_slabs_are_all_layers_once() -> None:
    for shape in ((128, 256, 256), (7, 3000, 3000), (1000, 4, 4)):
        codes = VoxelCodes("uint8", 1.0, 0.0, None, shape)
        assert [z for a, b in codes.slabs for z in range(a, b)] == list(range(shape[0]))
        assert all((b - a) * shape[1] * shape[2] <= max(SLAB_CODE_BYTES, shape[1] * shape[2]) for a, b in codes.slabs)
