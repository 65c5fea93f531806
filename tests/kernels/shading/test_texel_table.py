"""Planes of codes against NumPy's own conversions, plane after plane."""

import numpy as np
import pytest

from isogi_core.kernels.shading.texel_table import Numbers, Texels, number_of_half, unpack_texels

RNG = np.random.default_rng(5)
TEXELS = 512


@pytest.mark.parametrize("first", range(0, 1 << 16, 1 << 14))
def test_every_half_float_is_the_number_that_numpy_has(first):
    bits = np.arange(first, first + (1 << 14), dtype=np.uint16)
    expected = bits.view(np.float16).astype(np.float32)
    found = [number_of_half(each) for each in bits]
    finite = np.isfinite(expected)
    np.testing.assert_array_equal(
        np.array(found, np.float32)[finite].view(np.uint32), expected[finite].view(np.uint32)
    )
    assert np.isnan(np.array(found)[~finite]).all()


@pytest.mark.parametrize(
    ("halves", "singles", "codes"), [(4, 0, 5), (9, 0, 0), (0, 4, 0), (0, 1, 8), (2, 3, 4)]
)
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("texels", [0, 1, 63, 64, 700])
def test_texels_come_out_of_their_planes(halves, singles, codes, channels, texels):
    records = 3
    noises = 2
    rung = RNG.integers(0, 256, (records, TEXELS), np.uint8)
    hiss = RNG.integers(0, 256, (records, noises, TEXELS), np.uint8)
    half = RNG.normal(size=(records, channels, halves, TEXELS)).astype(np.float16)
    single = RNG.normal(size=(records, channels, singles, TEXELS)).astype(np.float32)
    code = RNG.integers(0, 256, (records, channels, codes, TEXELS), np.uint8)
    places = np.sort(RNG.choice(records * TEXELS, texels, replace=False)).astype(np.int32)
    found = empty(texels, noises, channels, halves + singles + codes)
    numbers = some_numbers()
    scales = np.float32([0.25, 1.0, 8.0])
    record = places // TEXELS
    offset = places % TEXELS
    bounds = np.searchsorted(record, np.arange(records + 1))
    unpack_texels(
        offset, bounds, (scales, rung, hiss, half.view(np.uint16), single, code), numbers, found
    )
    np.testing.assert_array_equal(found.samples, numbers.samples[rung[record, offset]])
    np.testing.assert_array_equal(
        found.noise, numbers.noise[hiss[record, :, offset]] * scales[record, None]
    )
    planes = np.concatenate([half.astype(np.float32), single, numbers.light[code]], axis=2)
    np.testing.assert_array_equal(
        found.light, planes[record, :, :, offset] * scales[record, None, None]
    )


def test_planes_are_read_where_they_lie_in_a_record():
    """They are fields of a record, which may be read-only, and so are neither contiguous nor
    writeable.
    """
    fields = [("rung", "u1", (TEXELS,)), ("noise", "u1", (1, TEXELS)), ("scale", "<f4")]
    kind = np.dtype([*fields, ("light", "<f2", (1, 4, TEXELS)), ("high", "u1", (1, 5, TEXELS))])
    data = RNG.integers(0, 0x7C, (2, kind.itemsize), np.uint8).tobytes()
    read = np.frombuffer(data, kind)
    found = empty(TEXELS, 1, 1, 9)
    numbers = some_numbers()
    planes = (read["light"].view(np.uint16), np.empty((2, 1, 0, TEXELS), np.float32), read["high"])
    offsets = np.arange(TEXELS, dtype=np.int32)
    bounds = np.array([0, 0, TEXELS])
    unpack_texels(
        offsets, bounds, (read["scale"], read["rung"], read["noise"], *planes), numbers, found
    )
    scale = read["scale"][1]
    np.testing.assert_array_equal(found.samples, numbers.samples[read["rung"][1]])
    np.testing.assert_array_equal(found.noise, numbers.noise[read["noise"][1].T] * scale)
    np.testing.assert_array_equal(
        found.light[:, 0, :4], read["light"][1, 0].T.astype(np.float32) * scale
    )
    np.testing.assert_array_equal(
        found.light[:, 0, 4:], numbers.light[read["high"][1, 0].T] * scale
    )


def some_numbers():
    """What bytes may stand for."""
    return Numbers(
        np.arange(256, dtype=np.int32) - 1, *RNG.normal(size=(2, 256)).astype(np.float32)
    )


def empty(texels, noises, channels, coefficients):
    """Texels to be filled."""
    light = np.full((texels, channels, coefficients), np.nan, np.float32)
    return Texels(
        np.full(texels, -9, np.int32), np.full((texels, noises), np.nan, np.float32), light
    )
