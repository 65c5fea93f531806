"""Light that converges, filtered over the texels of a view, against plain NumPy."""

import numpy as np
import pytest

from isogi_core.kernels.shading.filtering import (
    PATHS_COLUMN,
    VARIANCE_COLUMN,
    Numbering,
    filter_texels,
    take_filtered,
)
from isogi_core.kernels.shading.framebuffer import CONVERGING, FINAL
from isogi_core.kernels.shading.irradiance_ratio import (
    DIRECT_COLUMN,
    GRADE_COLUMN,
    NOISE_COLUMN,
    NORMAL_COLUMN,
    RECORD_LENGTH,
    REFLECTED_COLUMN,
    UNSHADOWED_COLUMN,
)
from isogi_core.kernels.shading.lattice import LIGHT_NUMBERS, UNBAKED_GRADE
from isogi_core.model.environment import LUMINANCE_WEIGHTS

BITS = 2
CHUNKS = (2, 3, 2)

SHARED = 1.5**3
"""By how much more variance that neighbours share counts in pixels: trilinear weights average
independent noise out.
"""


def numbered(positions):
    """The `Numbering` of texels at positions (m, 3; z, y, x), and the positions in its order."""
    chunks = np.unique(positions >> BITS, axis=0)
    slots = np.full(CHUNKS, -1, np.int32)
    slots[tuple(chunks.T)] = np.arange(len(chunks))
    side = 1 << BITS
    inside = positions & (side - 1)
    rows = slots[tuple((positions >> BITS).T)] * side**2 + inside[:, 0] * side + inside[:, 1]
    order = np.lexsort((inside[:, 2], rows))
    read = np.zeros(len(chunks) * side**2, np.uint32)
    np.bitwise_or.at(read, rows, np.uint32(1) << inside[:, 2].astype(np.uint32))
    first = np.zeros(len(read) + 1, np.uint32)
    np.cumsum(np.bitwise_count(read), out=first[1:])
    return Numbering(slots, read, first), np.ascontiguousarray(positions[order], np.int32)


def scattered(count, seed):
    """So many texels anywhere in the chunks."""
    shape = tuple(n << BITS for n in CHUNKS)
    chosen = np.random.default_rng(seed).choice(np.prod(shape), count, replace=False)
    return numbered(np.stack(np.unravel_index(chosen, shape), axis=-1))


def random_records(count, seed):
    """Light of all kinds, with normals that look upwards more or less."""
    rng = np.random.default_rng(seed)
    records = rng.uniform(0.2, 1.0, (count, RECORD_LENGTH)).astype(np.float32)
    normals = rng.normal(size=(count, 3)) * 0.3 + np.array([0.0, 0.0, 1.0])
    records[:, NORMAL_COLUMN : NORMAL_COLUMN + 3] = normals / np.linalg.norm(
        normals, axis=1, keepdims=True
    )
    records[:, GRADE_COLUMN] = rng.choice([UNBAKED_GRADE, CONVERGING, CONVERGING, FINAL], count)
    records[:, PATHS_COLUMN] = rng.choice([16, 64], count)
    records[:, VARIANCE_COLUMN] = rng.uniform(0.0, 0.1, count)
    return records


def filtered(numbering, positions, records, step=1):
    """`filter_texels`."""
    found = np.full_like(records, np.nan)
    half = len(records) // 2
    for a, b in ((0, half), (half, len(records))):
        filter_texels(numbering, BITS, positions[a:b], a, step, records, found)
    return found


def one_by_one(positions, records, step):
    """The same, texel by texel, in double precision."""
    found = records.astype(float)
    kept = records.astype(float)
    for t in np.flatnonzero(np.isin(records[:, GRADE_COLUMN], (CONVERGING, UNBAKED_GRADE))):
        unlit = records[t, GRADE_COLUMN] == UNBAKED_GRADE
        apart = positions - positions[t]
        near = (np.abs(apart) <= step).all(axis=1) & (apart % step == 0).all(axis=1)
        near &= np.isin(records[:, GRADE_COLUMN], (CONVERGING, FINAL))
        cosine = (
            kept[near, NORMAL_COLUMN : NORMAL_COLUMN + 3]
            @ kept[t, NORMAL_COLUMN : NORMAL_COLUMN + 3]
        )
        weights = (
            np.exp(((apart[near] / step) ** 2).sum(axis=1) / -2.0) * np.maximum(cosine, 0.0) ** 16
        )
        around = kept[near][weights > 0.0]
        weights = weights[weights > 0.0]
        if len(weights) < 2 or (unlit and weights.sum() < 1e-4):
            continue
        counts = weights * around[:, PATHS_COLUMN]
        ratio = (
            counts @ around[:, :3] / (counts @ around[:, UNSHADOWED_COLUMN : UNSHADOWED_COLUMN + 3])
        )
        reflected = counts @ around[:, REFLECTED_COLUMN : REFLECTED_COLUMN + 3] / counts.sum()
        variance = counts**2 @ around[:, VARIANCE_COLUMN] / counts.sum() ** 2
        differences = (
            around[:, :3]
            + around[:, REFLECTED_COLUMN : REFLECTED_COLUMN + 3]
            - ratio * around[:, UNSHADOWED_COLUMN : UNSHADOWED_COLUMN + 3]
            - reflected
        )
        noise = weights @ around[:, VARIANCE_COLUMN] / weights.sum()
        signal = max(weights @ (differences @ LUMINANCE_WEIGHTS) ** 2 / weights.sum() - noise, 0.0)
        if unlit:
            own = 0.0
        else:
            own = signal / (signal + noise)
        found[t, :3] = (
            own * kept[t, :3]
            + (1 - own) * ratio * kept[t, UNSHADOWED_COLUMN : UNSHADOWED_COLUMN + 3]
        )
        found[t, REFLECTED_COLUMN : REFLECTED_COLUMN + 3] = (
            own * kept[t, REFLECTED_COLUMN : REFLECTED_COLUMN + 3] + (1 - own) * reflected
        )
        left = signal if unlit else own * noise
        shared = (1 - own) ** 2 * variance
        found[t, GRADE_COLUMN] = CONVERGING
        if unlit:
            found[t, PATHS_COLUMN] = weights @ around[:, PATHS_COLUMN] / weights.sum()
        else:
            found[t, PATHS_COLUMN] = kept[t, PATHS_COLUMN]
        found[t, VARIANCE_COLUMN] = left + shared
        found[t, NOISE_COLUMN] = np.sqrt(left + SHARED * shared)
    return found


@pytest.mark.parametrize("step", [1, 2])
def test_a_pass_is_that_of_plain_numpy(step):
    (numbering, positions) = scattered(300, 1)
    records = random_records(300, 2)
    found = filtered(numbering, positions, records, step)
    np.testing.assert_allclose(found, one_by_one(positions, records, step), rtol=2e-4, atol=2e-5)
    assert (found != records).any(axis=1).sum() > 100


def test_what_is_final_or_alone_stays_as_it_is():
    (numbering, positions) = scattered(60, 3)
    records = random_records(60, 4)
    records[:30, GRADE_COLUMN] = FINAL
    found = filtered(numbering, positions, records)
    still = records[:, GRADE_COLUMN] == FINAL
    np.testing.assert_array_equal(found[still], records[still])
    lone, place = numbered(np.array([[1, 1, 1], [3, 6, 7]]))
    alone = random_records(2, 5)
    alone[:, GRADE_COLUMN] = CONVERGING, UNBAKED_GRADE
    np.testing.assert_array_equal(filtered(lone, place, alone), alone)


def sheet(edge):
    """A flat sheet of texels whose light is 1, and 3 beyond an ``edge`` along x, with noise of 0.1;
    its x too.
    """
    positions = np.stack(
        np.meshgrid([3], np.arange(12), np.arange(8), indexing="ij"), axis=-1
    ).reshape(-1, 3)
    numbering, positions = numbered(positions)
    records = np.zeros((len(positions), RECORD_LENGTH), np.float32)
    records[:, NORMAL_COLUMN + 2] = 1.0
    records[:, GRADE_COLUMN] = CONVERGING
    records[:, PATHS_COLUMN] = 16
    records[:, UNSHADOWED_COLUMN : UNSHADOWED_COLUMN + 3] = 4.0
    records[:, VARIANCE_COLUMN] = 0.01
    noise = 0.1 * np.random.default_rng(6).normal(size=len(positions))
    records[:, :3] = (np.where(positions[:, 2] < edge, 1.0, 3.0) + noise)[:, None]
    return numbering, positions, records


def test_even_light_loses_its_noise_and_says_how_much():
    numbering, positions, records = sheet(edge=99)
    for step in (1, 2):
        records = filtered(numbering, positions, records, step)
    errors = records[:, 1] - 1.0
    assert errors.std() < 0.06
    assert 0.5 < np.sqrt((records[:, NOISE_COLUMN] ** 2).mean() / SHARED) / errors.std() < 1.5


def test_the_edge_of_a_shadow_stays():
    numbering, positions, records = sheet(edge=4)
    for step in (1, 2):
        records = filtered(numbering, positions, records, step)
    truth = np.where(positions[:, 2] < 4, 1.0, 3.0)
    assert np.abs(records[:, 1] - truth).max() < 0.4


def test_texels_without_light_have_that_of_their_neighbours():
    """Of those whose indices are all odd, in even light and beside the edge of a shadow: and tell
    how far they err.
    """
    for edge, most in ((99, 0.15), (4, 1.1)):
        numbering, positions, records = sheet(edge)
        unlit = (positions % 2 == 0).any(axis=1)
        records[unlit, :3] = 4.0
        records[unlit, GRADE_COLUMN] = UNBAKED_GRADE
        records[unlit, PATHS_COLUMN] = 0
        for step in (1, 2):
            records = filtered(numbering, positions, records, step)
        assert unlit.mean() > 0.7 and (records[:, GRADE_COLUMN] == CONVERGING).all()
        errors = np.abs(records[unlit, 1] - np.where(positions[unlit, 2] < edge, 1.0, 3.0))
        assert errors.max() < most and (records[unlit, NOISE_COLUMN] > 0.3 * errors).mean() > 0.9


def test_neighbours_that_face_away_lend_no_light():
    """However faint: nothing that is told is without a number."""
    numbering, positions, records = sheet(edge=99)
    unlit = (positions % 2 == 0).any(axis=1)
    records[unlit, GRADE_COLUMN] = UNBAKED_GRADE
    records[unlit, NORMAL_COLUMN] = 1.0
    records[unlit, NORMAL_COLUMN + 2] = 0.0
    records[~unlit, NORMAL_COLUMN] = 1e-2
    found = filtered(numbering, positions, records)
    np.testing.assert_array_equal(found[unlit], records[unlit])
    assert np.isfinite(found).all()


def test_filtered_light_replaces_noisy_and_missing_light():
    records = random_records(200, 7)
    rng = np.random.default_rng(8)
    grade = rng.choice([UNBAKED_GRADE, CONVERGING, FINAL], 200).astype(np.uint8)
    noisy = rng.random(200) < 0.5
    lit = rng.random((200, LIGHT_NUMBERS), np.float32)
    graded = np.empty(200, np.uint8)
    found = np.empty_like(lit)
    take_filtered(records, noisy, grade, lit, graded, found)
    new = (grade == UNBAKED_GRADE) & (records[:, GRADE_COLUMN] == CONVERGING)
    taken = noisy | new
    reflected = records[:, REFLECTED_COLUMN : REFLECTED_COLUMN + 3]
    expected = np.column_stack(
        [
            records[:, DIRECT_COLUMN : DIRECT_COLUMN + 3] + reflected,
            records[:, NOISE_COLUMN],
            reflected,
        ]
    )
    np.testing.assert_array_equal(found, np.where(taken[:, None], expected, lit))
    np.testing.assert_array_equal(graded, np.where(new, CONVERGING, grade))
    assert new.any() and (~taken).any()
