"""Volumes: what normalisation keeps of ordinary and extreme ranges, what it refuses, and which
values are outliers.
"""

import dataclasses
from fractions import Fraction

import numpy as np
import pytest

from isogi_core.errors import VolumeError
from isogi_core.files.grid import Grid
from isogi_core.model import value_survey
from isogi_core.model.value_survey import (
    find_core,
    sample_step,
    sample_values,
    survey,
)
from isogi_core.model.volume import Volume, make_volume

SOLIDS = ("above", "below")
UNIT = np.random.default_rng(7).random((4, 5, 6))


def own_units(volume: Volume) -> np.ndarray:
    """Voxels back in the volume's own units, float64 (the range must leave room for it)."""
    return volume.offset + volume.scale * volume.voxels.astype(np.float64)


@pytest.mark.parametrize("solid", SOLIDS)
def test_normalised_voxels_are_float32_in_the_unit_interval(solid: str) -> None:
    volume = make_volume(UNIT * 200.0 - 50.0, solid=solid)
    assert volume.voxels.dtype == np.float32
    assert volume.voxels.flags.c_contiguous and volume.voxels.flags.writeable
    assert volume.voxels.min() == 0.0
    assert 0.5 < volume.voxels.max() <= 1.0
    assert volume.scale == (256.0 if solid == "above" else -256.0)
    np.testing.assert_allclose(own_units(volume), UNIT * 200.0 - 50.0, atol=256 * 2.0**-24)


@pytest.mark.parametrize("axes", [(0, 2, 1), (1, 0, 2), (2, 1, 0)])
def test_an_array_makes_the_same_volume_in_any_memory_order(axes: tuple[int, int, int]) -> None:
    turned = UNIT.transpose(axes)
    volume = make_volume(turned)
    copied = make_volume(turned.copy())
    assert volume.digest == copied.digest
    np.testing.assert_array_equal(volume.voxels, copied.voxels)


@pytest.mark.parametrize("solid", SOLIDS)
def test_voxels_above_the_normalised_isovalue_are_solid(solid: str) -> None:
    values = np.arange(120.0).reshape(4, 5, 6)
    volume = make_volume(values, solid=solid)
    inside = volume.voxels > volume.normalise_isovalue(41.5)
    assert np.array_equal(inside, values > 41.5 if solid == "above" else values < 41.5)


@pytest.mark.parametrize("solid", SOLIDS)
@pytest.mark.parametrize(
    "dtype", ["u1", "i1", "<i2", ">i2", ">u4", "<i8", ">u8", "<f2", ">f4", "<f8", ">f8"]
)
def test_isovalue_equal_to_a_voxel_is_equal_after_normalisation(dtype: str, solid: str) -> None:
    values = np.random.default_rng(3).integers(0, 120, (3, 4, 5)).astype(dtype)
    volume = make_volume(values, solid=solid)
    assert volume.dtype == np.dtype(dtype).name
    for z, y, x in ((0, 0, 0), (1, 2, 3), (2, 3, 4)):
        assert volume.normalise_isovalue(float(values[z, y, x])) == volume.voxels[z, y, x]


@pytest.mark.parametrize("solid", SOLIDS)
@pytest.mark.parametrize(
    ("factor", "offset", "tolerance"),
    [
        (1.0, 1e9, 3e-7),
        (1e-300, 0.0, 2e-7),
        (1e300, 0.0, 2e-7),
        (1.7e308, 0.0, 2e-7),
        (2.0**-1060, 0.0, 1e-4),
    ],
)
def test_extreme_ranges_keep_the_field(
    factor: float, offset: float, tolerance: float, solid: str
) -> None:
    volume = make_volume(UNIT * factor + offset, solid=solid)
    levels = np.array([volume.normalise_isovalue(v * factor + offset) for v in UNIT.ravel()])
    np.testing.assert_array_equal(levels.astype(np.float32), volume.voxels.ravel())
    spread = (UNIT - UNIT.min()) / np.ptp(UNIT)
    seen = volume.voxels / volume.voxels.max()
    np.testing.assert_allclose(seen, spread if solid == "above" else 1.0 - spread, atol=tolerance)


@pytest.mark.parametrize("solid", SOLIDS)
def test_range_wider_than_the_largest_double_stays_finite(solid: str) -> None:
    volume = make_volume((2.0 * UNIT - 1.0) * 1.79e308, solid=solid)
    assert np.isfinite(volume.voxels).all() and np.isfinite(volume.scale)
    assert volume.voxels.min() >= 0.0 and 1.0 < volume.voxels.max() <= 4.0
    counts, edges = volume.histogram(9)
    assert counts.sum() == UNIT.size and np.isfinite(edges).all()


def test_scaling_by_a_power_of_two_changes_no_voxel() -> None:
    plain = make_volume(UNIT)
    for exponent in (-1000, -1, 900):
        np.testing.assert_array_equal(make_volume(np.ldexp(UNIT, exponent)).voxels, plain.voxels)


@pytest.mark.parametrize("solid", SOLIDS)
@pytest.mark.parametrize("dtype", [np.int64, np.uint64])
@pytest.mark.parametrize("start", [2**53 + 1, 2**60 + 100, 2**63 - 800])
def test_integers_beyond_double_precision_are_exact(start: int, dtype: type, solid: str) -> None:
    whole = [start + 97 * i for i in range(8)]
    volume = make_volume(np.array(whole, dtype).reshape(2, 2, 2), solid=solid)
    exact = [(Fraction(v) - Fraction(volume.offset)) / Fraction(volume.scale) for v in whole]
    assert [Fraction(float(v)) for v in volume.voxels.ravel()] == exact
    assert all(0 <= v <= 1 for v in exact)


@pytest.mark.parametrize("solid", SOLIDS)
@pytest.mark.parametrize("dtype", [np.int64, np.uint64])
def test_whole_range_of_64_bits(dtype: type, solid: str) -> None:
    info = np.iinfo(dtype)
    values = np.array([info.min, info.max] * 4, dtype).reshape(2, 2, 2)
    np.testing.assert_array_equal(
        make_volume(values, solid=solid).voxels,
        [[[0, 1]] * 2] * 2 if solid == "above" else [[[1, 0]] * 2] * 2,
    )


def test_booleans_and_long_doubles() -> None:
    mask = UNIT > 0.5
    volume = make_volume(mask)
    assert volume.dtype == "bool" and volume.value_range == (0.0, 1.0)
    np.testing.assert_array_equal(volume.voxels, mask)
    np.testing.assert_array_equal(
        make_volume(UNIT.astype(np.longdouble)).voxels, make_volume(UNIT).voxels
    )


@pytest.mark.parametrize("solid", SOLIDS)
def test_constant_volume_has_unit_scale(solid: str) -> None:
    volume = make_volume(np.full((2, 3, 4), -7, np.int16), solid=solid)
    assert abs(volume.scale) == 1.0 and volume.value_range == (-7.0, -7.0)
    assert not volume.voxels.any() and not np.signbit(volume.voxels).any()
    assert volume.histogram(4)[0].sum() == 24


def test_values_that_are_not_finite_become_holes() -> None:
    values = UNIT.copy()
    values[0, 0, 0] = np.nan
    values[1, 1, 1] = np.inf
    values[2, 2, 2] = -np.inf
    volume = make_volume(values)
    finite = np.isfinite(values)
    assert volume.holes == 3
    assert volume.value_range == (values[finite].min(), values[finite].max())
    np.testing.assert_array_equal(np.isnan(volume.voxels), ~finite)
    assert volume.histogram(5)[0].sum() == UNIT.size - 3


def test_isovalues_far_outside_stay_finite_float32() -> None:
    volume = make_volume(UNIT * 1e-300)
    for value in (1e300, -1e300):
        level = volume.normalise_isovalue(value)
        assert (
            np.isfinite(level) and float(np.float32(level)) == level and (level > 0) == (value > 0)
        )


OUTLIERS = ([1e30], [-1e34], [-9999.0, 1e30, 1e300], [1.7e308], [-1.7e308, 1.7e308])


@pytest.mark.parametrize("solid", SOLIDS)
@pytest.mark.parametrize("outliers", OUTLIERS, ids=str)
def test_outliers_leave_the_others_their_digits(outliers: list[float], solid: str) -> None:
    plain = make_volume(UNIT, solid=solid)
    values = UNIT.copy()
    places = np.unravel_index(1 + np.arange(len(outliers)), UNIT.shape)
    values[places] = outliers
    kept = np.ones(UNIT.shape, bool)
    kept[places] = False
    volume = make_volume(values, solid=solid)
    if (plain.offset, plain.scale) == (volume.offset, volume.scale):
        np.testing.assert_array_equal(volume.voxels[kept], plain.voxels[kept])
    np.testing.assert_allclose(own_units(volume)[kept], UNIT[kept], atol=2.0**-24)
    above = np.array(outliers) > 1.0
    assert ((volume.voxels[places] > 500.0) == (above == (solid == "above"))).all()
    assert np.isfinite(volume.voxels).all() and np.abs(volume.voxels).max() < 1e37
    assert volume.core == (values[kept].min(), values[kept].max())
    assert volume.value_range == (values.min(), values.max())
    counts, edges = volume.histogram(8)
    assert counts.sum() == kept.sum() and (edges[0], edges[-1]) == volume.core


@pytest.mark.parametrize("solid", SOLIDS)
@pytest.mark.parametrize(
    ("start", "outlier", "dtype"),
    [
        (2**60, 0, np.int64),
        (2**62, -(2**63), np.int64),
        (2**64 - 120, 0, np.uint64),
        (0, 2**64 - 1, np.uint64),
    ],
)
def test_whole_numbers_far_from_the_others(
    start: int, outlier: int, dtype: type, solid: str
) -> None:
    whole = [*range(start, start + 119), outlier]
    volume = make_volume(np.array(whole, dtype).reshape(4, 5, 6), solid=solid)
    exact = [(Fraction(v) - Fraction(volume.offset)) / Fraction(volume.scale) for v in whole]
    assert [Fraction(float(v)) for v in volume.voxels.ravel()[:-1]] == exact[:-1]
    assert float(volume.voxels.ravel()[-1]) == pytest.approx(float(exact[-1]), rel=1e-6)


@pytest.mark.parametrize(
    ("missing", "dtype", "holes"),
    [
        ([-9999], np.float32, 2),
        ([-9999, 7], np.int16, 3),
        ([-1e34], np.float32, 1),
        ([0.5, -1e34], np.int16, 0),
        ([2**64 - 1], np.uint64, 1),
        ([np.inf, np.nan], np.int16, 0),
    ],
)
def test_missing_values_are_holes(missing: list[float], dtype: type, holes: int) -> None:
    values = np.arange(120).astype(dtype)
    last = {np.float32: np.float32(-1e34), np.uint64: np.uint64(2**64 - 1)}.get(dtype, dtype(5))
    if dtype is np.uint64:
        values[[3, 50]] = values[60]
    else:
        values[[3, 50]] = dtype(-9999)
    values[-1] = last
    volume = make_volume(values.reshape(4, 5, 6), missing=missing)
    if holes:
        marks = np.isin(values, np.array(missing).astype(dtype))
    else:
        marks = np.zeros(120, bool)
    assert volume.holes == holes and np.array_equal(np.isnan(volume.voxels.ravel()), marks)
    assert volume.value_range == (values[~marks].min(), values[~marks].max())


def test_a_volume_of_nothing_but_missing_values_is_refused() -> None:
    with pytest.raises(VolumeError, match="missing"):
        make_volume(np.full((2, 2, 2), -9999), missing=[-9999])


@pytest.mark.parametrize(
    ("values", "steps"),
    [
        (UNIT > 0.5, 1),
        (UNIT * 0 + 3, 0),
        ((1e9 + UNIT).astype(np.float32), 1),
        ((255 * UNIT).astype(np.uint8), 254),
    ],
)
def test_steps_are_what_the_source_tells_apart(values: np.ndarray, steps: float) -> None:
    assert make_volume(values).steps == pytest.approx(steps, abs=1)


def test_a_double_tells_apart_what_a_single_float_does_not() -> None:
    assert make_volume(1e9 + UNIT).steps > 2**22


@pytest.mark.parametrize("solid", SOLIDS)
def test_histogram_counts_as_numpy_does_on_the_source(solid: str) -> None:
    values = np.random.default_rng(5).integers(0, 256, (8, 9, 10)).astype(np.uint8)
    values[0, 0, :2] = 0, 255
    counts, edges = make_volume(values, solid=solid).histogram(256)
    assert counts.dtype == np.int64
    np.testing.assert_array_equal(counts, np.bincount(values.ravel(), minlength=256))
    np.testing.assert_allclose(edges, np.linspace(0.0, 255.0, 257))


def test_box_in_world_units() -> None:
    volume = make_volume(UNIT, spacing=(1.0, 2.0, 0.5))
    assert volume.shape == (4, 5, 6) and volume.size == (6, 5, 4)
    assert volume.extent == (5.0, 8.0, 1.5)
    assert volume.centre == (2.5, 4.0, 0.75)
    assert volume.radius == pytest.approx(np.sqrt(25 + 64 + 2.25) / 2)


def test_digest_names_field_units_and_side() -> None:
    digest = make_volume(UNIT, name="a").digest
    assert digest == make_volume(UNIT.astype(">f8"), name="b").digest
    changed = UNIT.copy()
    changed[1, 2, 3] += 1e-3
    others = [
        make_volume(changed),
        make_volume(UNIT, spacing=(1, 1, 2)),
        make_volume(UNIT + 1.0),
        make_volume(UNIT * 2.0),
        make_volume(UNIT, solid="below"),
        make_volume(UNIT.reshape(5, 4, 6)),
    ]
    assert len({digest, *(other.digest for other in others)}) == 1 + len(others)


def test_signed_zeros_are_one_zero() -> None:
    zeros = np.zeros((2, 2, 2))
    mixed = np.where(UNIT[:2, :2, :2] > 0.5, 0.0, -0.0)
    assert make_volume(mixed).digest == make_volume(zeros).digest == make_volume(-zeros).digest


def test_a_volume_cannot_be_changed() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        make_volume(UNIT).name = "other"  # type: ignore[misc]


@pytest.mark.parametrize(
    ("array", "options", "word"),
    [
        (UNIT.astype(complex), {}, "complex128"),
        (UNIT.astype(object), {}, "object"),
        (UNIT[0], {}, "2 dimensions"),
        (UNIT[None], {}, "4 dimensions"),
        (UNIT[:1], {}, "6 × 5 × 1"),
        (np.empty((0, 4, 4)), {}, "4 × 4 × 0"),
        (np.full((2, 2, 2), np.nan), {}, "no finite value"),
        (UNIT, {"spacing": (1.0, 0.0, 1.0)}, "1, 0, 1"),
        (UNIT, {"spacing": (1.0, -1.0, 1.0)}, "1, -1, 1"),
        (UNIT, {"spacing": (np.nan, 1.0, 1.0)}, "nan"),
        (UNIT, {"spacing": (np.inf, 1.0, 1.0)}, "inf"),
        (UNIT, {"spacing": (1.0, 1.0)}, "three positive"),
        (UNIT, {"spacing": (1.0, 1e-300, 1.0)}, "1e-300"),
        (UNIT, {"spacing": (1e300, 1.0, 1.0)}, "1e-30 to 1e\\+30"),
        (UNIT, {"solid": "inside"}, "inside"),
    ],
)
def test_refusals_say_what_is_wrong(array: np.ndarray, options: dict, word: str) -> None:
    with pytest.raises(VolumeError, match=word):
        make_volume(array, **options)


@pytest.mark.parametrize("solid", SOLIDS)
def test_a_plane_is_what_lies_between_two_layers(solid: str) -> None:
    array = UNIT * 200.0 - 50.0
    volume = make_volume(array, solid=solid)
    for axis, layers in enumerate((array.transpose(2, 0, 1), array.transpose(1, 0, 2), array)):
        for at, layer in (
            (0.0, layers[0]),
            (1.25, 0.75 * layers[1] + 0.25 * layers[2]),
            (len(layers) - 1, layers[-1]),
        ):
            np.testing.assert_allclose(volume.plane(axis, at), layer[::-1], atol=1e-4)


def test_a_plane_on_a_layer_has_no_holes_of_the_next_one() -> None:
    array = UNIT.copy()
    array[2, 1, 1] = np.nan
    volume = make_volume(array)
    assert np.isfinite(volume.plane(2, 1.0)).all()
    assert np.isnan(volume.plane(2, 1.5)).sum() == np.isnan(volume.plane(2, 2.0)).sum() == 1


# --- the core of values
# -----------------------------------------------------------------------------------------------


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
    assert sample_step(columns.shape) > 1, "not every voxel is read"
    assert sample_values(columns).tolist() == list(range(512))


def test_the_sample_is_distinct_finite_and_ascending() -> None:
    values = np.array([3.0, np.nan, 1.0, np.inf, 1.0, -np.inf, -2.0, 3.0], ">f4").reshape(2, 2, 2)
    assert sample_values(values).tolist() == [-2.0, 1.0, 3.0]


@pytest.mark.parametrize("kind", ["u1", "<i2", ">i2", "?"])
def test_values_that_are_counted_make_the_same_volume(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = np.random.default_rng(3).integers(-90, 90, (5, 6, 7)).astype(kind)
    if drawn.dtype.itemsize == 2:
        drawn[0, 0, 0] = 9999.0
    else:
        drawn[0, 0, 0] = 200
    grid = Grid.of(drawn)
    missing = (3.0,)
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
