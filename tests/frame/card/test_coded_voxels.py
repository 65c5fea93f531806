"""Voxels of published pages in few bytes, beside a reader that goes voxel by voxel."""

import gzip

import numpy as np
import pytest

from isogi_core.frame.card.coded_voxels import voxels_file
from tests.published import voxels_in

RNG = np.random.default_rng(11)
SHAPE = (11, 7, 9)


def smooth(shape: tuple[int, int, int], length: float = 1.0) -> np.ndarray:
    """A field with a little noise, about 0, which changes over 3 to 5 voxels times a length."""
    z, y, x = np.indices(shape) / length
    return np.sin(x / 3) + np.cos(y / 4) * np.sin(z / 5) + RNG.normal(0.0, 0.03, shape)


def flattened(codes: np.ndarray, low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    """Codes of which those below and above a range are alike, and the ones that are needed: those
    in the range and around these.
    """
    needed = (codes > low) & (codes <= high)
    for axis in range(3):
        needed |= np.roll(needed, 1, axis) | np.roll(needed, -1, axis)
    ends = codes[codes <= low].max(), codes[codes > high].min()
    return np.where(needed, codes, np.where(codes <= low, *ends)).astype(codes.dtype), needed


@pytest.mark.parametrize(
    ("kind", "scale", "offset"),
    [("<u1", 50.0, 128.0), ("<u2", 9000.0, 30000.0), ("<f4", 1.0, 0.0)],
)
def test_a_reader_gets_all_voxels_again(kind: str, scale: float, offset: float) -> None:
    codes = (scale * smooth(SHAPE) + offset).astype(kind)
    low, high = np.percentile(codes, [45, 55])
    given, needed = flattened(codes, low, high)
    np.testing.assert_array_equal(voxels_in(voxels_file(given, needed), kind, SHAPE), given)


@pytest.mark.parametrize("kind", ["<u1", "<u2", "<f4"])
@pytest.mark.parametrize("share", [0.0, 0.3, 1.0], ids=["none", "some", "all"])
def test_no_mark_makes_a_voxel_wrong(kind: str, share: float) -> None:
    """Whatever is said to be needed, extreme values and holes among it."""
    codes = RNG.integers(0, 256, SHAPE).astype(np.uint8)
    if kind != "<u1":
        codes = np.frombuffer(RNG.bytes(codes.size * int(kind[2])), kind).reshape(SHAPE)
    if kind == "<f4":
        codes = np.nan_to_num(codes)
    needed = RNG.random(SHAPE) < share
    np.testing.assert_array_equal(voxels_in(voxels_file(codes, needed), kind, SHAPE), codes)


def test_idle_voxels_take_hardly_any_bytes() -> None:
    codes = (30.0 * smooth((32, 40, 40), 3.0) + 128.0).astype("<u1")
    given, needed = flattened(codes, 126.0, 130.0)
    size = len(gzip.compress(voxels_file(given, needed), 9))
    assert size < 0.75 * len(gzip.compress(given.tobytes(), 9))
    assert size < needed.sum(), "less than a byte for each needed voxel"


def test_a_constant_volume_is_told_by_its_value() -> None:
    codes = np.full(SHAPE, 7, "<u1")
    data = voxels_file(codes, np.zeros(SHAPE, bool))
    np.testing.assert_array_equal(voxels_in(data, "<u1", SHAPE), codes)
    assert len(data) == 2 + 2 * 7 * 9, "its ends, and marks without a voxel"
