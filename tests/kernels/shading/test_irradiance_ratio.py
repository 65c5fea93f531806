"""Direct light carried as ratios to unshadowed light, against plain NumPy and SciPy's harmonics."""

import numpy as np
import pytest

from isogi_core.frame.lighting import quadric_of
from isogi_core.kernels.shading.framebuffer import (
    CONVERGING,
    FINAL,
    PROVISIONAL,
    Framebuffer,
)
from isogi_core.kernels.shading.irradiance_ratio import (
    RECORD_LENGTH,
    Unshadowed,
    carry_ratios,
    fill_records,
)
from isogi_core.kernels.shading.lattice import (
    BURIED_GRADE,
    LIGHT_NUMBERS,
    PARTIAL_GRADE,
    UNBAKED_GRADE,
    VOID_GRADE,
)
from isogi_core.kernels.shading.surface_points import SurfacePoints
from tests.kernels.shading.lattices import border_points, lattice, lower_texels, view_of
from tests.kernels.transport.harmonic_bases import scipy_basis

RNG = np.random.default_rng(5)
LIGHT = RNG.normal(size=(3, 9)) * 0.3 + np.array([4.0] + [0.0] * 8)
LEASTS = np.array([0.9, 0.7, 0.8], np.float32)
UNSHADOWED = Unshadowed(np.ascontiguousarray(quadric_of(LIGHT), np.float32), LEASTS)
WEIGHTS = np.array([0.2126, 0.7152, 0.0722], np.float32).astype(float)


def unit(vectors):
    """Vectors (n, 3) at length 1, float64."""
    return vectors / np.linalg.norm(vectors.astype(float), axis=1, keepdims=True)


def some_normals(count):
    """Unit normals (count, 3) float32 that look anywhere."""
    return unit(RNG.normal(size=(count, 3))).astype(np.float32)


def unshadowed_of(normals):
    """Unshadowed light (n, 3) about ``normals``."""
    return np.maximum(scipy_basis(3, unit(normals)) @ LIGHT.T, LEASTS)


def records_of(grade, lit, normals, unshadowed=UNSHADOWED, whole=False):
    """`fill_records`: (m, RECORD_LENGTH)."""
    records = np.full((len(grade), RECORD_LENGTH), np.nan, np.float32)
    fill_records(grade, lit, normals, unshadowed, whole, records)
    return records


def carry(points, records, normals, unshadowed=UNSHADOWED, unit=1.0):
    """`carry_ratios`: radiance (n, 3), state (n,), error (n,)."""
    size = 3 * len(points)
    corners = view_of(points)[2]
    planes = Framebuffer(
        np.zeros((size, 3), np.float32), np.zeros(size, np.uint8), np.zeros(size, np.float32)
    )
    pixels = np.arange(1, size, 3, dtype=np.uint32)
    some = SurfacePoints(points, normals, pixels)
    carry_ratios(lattice(), some, corners, records, unshadowed, np.float32(unit), planes)
    assert not planes.state[::3].any() and not planes.radiance[2::3].any(), (
        "other pixels are left alone"
    )
    return tuple(plane[pixels] for plane in planes)


def lit_texels(points, grades=(FINAL,)):
    """Texels of a view of the points, lit at random: grades, light (m, LIGHT_NUMBERS) and normals
    (m, 3).
    """
    count = len(view_of(points)[1])
    lit = (RNG.random((count, LIGHT_NUMBERS)) + 0.1).astype(np.float32)
    lit[:, 4:] *= 0.5 * lit[:, :3]
    return RNG.choice(grades, count).astype(np.uint8), lit, some_normals(count)


def one_by_one(points, grade, lit, towards, normals):
    """Light (n, 3), its standard error (n,) and the least grade (n,), by loops over points and
    their texels.
    """
    corners = view_of(points)[2]
    (_, fractions) = lower_texels(points)
    light = np.zeros((len(points), 3))
    noise = np.zeros(len(points))
    least = np.zeros(len(points), int)
    for m, (own, f) in enumerate(zip(corners, fractions, strict=True)):
        tri = np.prod(np.where(np.array(list(np.ndindex(2, 2, 2))), f, 1.0 - f), axis=1)
        cosines = towards[own].astype(float) @ normals[m]
        agreed = (
            # A half at 16°, and a fifth at 27°.
            np.maximum(cosines, 1e-3) / (1.0 + (1.0 - cosines) / 0.1055)
        ) ** 2
        counts = grade[own] <= FINAL
        over = unshadowed_of(towards[own])
        weights = tri * agreed * counts
        under = unshadowed_of(normals[m : m + 1])[0]
        unbaked = (grade[own] == UNBAKED_GRADE)[:, None]
        reflected = np.where(unbaked, 0.0, lit[own, 4:])
        direct = np.where(unbaked, over, lit[own, :3] - reflected)
        errors = np.where(unbaked[:, 0], 0.0, lit[own, 3])
        least[m] = grade[own].min()
        if weights.sum() > 0.0:
            bare = np.where(counts, weights, 0.0) @ over
            light[m] = weights @ np.where(counts[:, None], direct, 0.0) / bare * under
            light[m] += weights @ np.where(counts[:, None], reflected, 0.0) / weights.sum()
            errors = np.where(counts, errors, 0.0)
            noise[m] = (
                np.sqrt(((weights * errors) ** 2).sum()) * (under @ WEIGHTS) / (bare @ WEIGHTS)
            )
        elif tri[grade[own] == BURIED_GRADE].sum() > 0.0:
            light[m] = 0.0
        else:
            light[m] = under
    return light, noise, least


@pytest.mark.parametrize("order", [1, 2, 3])
def test_the_quadric_is_the_sum_of_harmonics(order):
    normals = some_normals(50)
    light = LIGHT[:, : order**2]
    x, y, z = normals.T.astype(float)
    terms = np.stack([np.ones(50), y, z, x, x * y, y * z, z * z, x * z, x * x - y * y])
    expected = scipy_basis(order, normals.astype(float)) @ light.T
    np.testing.assert_allclose((quadric_of(light) @ terms).T, expected, atol=1e-6)


def test_a_record_holds_direct_unshadowed_and_reflected_light():
    points = border_points()
    grade, lit, towards = lit_texels(
        points, (PARTIAL_GRADE, CONVERGING, FINAL, UNBAKED_GRADE, BURIED_GRADE, VOID_GRADE)
    )
    lit[grade == UNBAKED_GRADE] = lit[grade > FINAL] = np.nan
    records = records_of(grade, lit, towards)
    there = (grade >= PARTIAL_GRADE) & (grade <= FINAL)
    over = unshadowed_of(towards)
    dark = over <= 1.0001 * LEASTS
    assert dark.any() and not dark.all(), "some are as dark as they may be"
    np.testing.assert_allclose(records[there, :3], (lit[:, :3] - lit[:, 4:])[there], rtol=1e-5)
    assert np.array_equal(records[there, 3], lit[there, 3]) and np.array_equal(
        records[there, 8:11], lit[there, 4:]
    )
    np.testing.assert_allclose(records[:, 4:7], over, rtol=1e-5)
    unbaked = grade == UNBAKED_GRADE
    assert np.array_equal(records[unbaked, :3], records[unbaked, 4:7])
    assert not records[~there][:, [3, 8, 9, 10]].any() and not records[grade > FINAL, :3].any()
    assert np.array_equal(records[:, 11:14], towards) and np.array_equal(records[:, 7], grade)


@pytest.mark.parametrize(
    "grades",
    [
        (FINAL,),
        (FINAL, CONVERGING, PARTIAL_GRADE, UNBAKED_GRADE, BURIED_GRADE, VOID_GRADE),
        (BURIED_GRADE, VOID_GRADE),
    ],
)
def test_ratios_are_carried_as_a_loop_over_texels_has_it(grades):
    points = border_points()
    grade, lit, towards = lit_texels(points, grades)
    normals = some_normals(len(points))
    light, noise, least = one_by_one(points, grade, lit, towards, normals)
    radiance, state, error = carry(points, records_of(grade, lit, towards), normals)
    np.testing.assert_allclose(radiance, light, rtol=2e-4, atol=1e-5)
    assert np.array_equal(state, np.clip(least, PROVISIONAL, FINAL))
    expected = np.minimum(noise / np.maximum(light @ WEIGHTS, 1e-30), 1.0)
    np.testing.assert_allclose(
        error, np.where(least <= PARTIAL_GRADE, 1.0, expected), rtol=2e-4, atol=1e-6
    )


def test_where_all_normals_agree_light_is_blended_as_it_is():
    points = border_points()
    grade, lit, _ = lit_texels(points)
    up = np.tile(np.array([0.6, 0.0, 0.8], np.float32), (max(len(grade), len(points)), 1))
    radiance, _, _ = carry(points, records_of(grade, lit, up[: len(grade)]), up[: len(points)])
    corners = view_of(points)[2]
    (_, f) = lower_texels(points)
    tri = np.prod(
        np.where(np.array(list(np.ndindex(2, 2, 2)))[None], f[:, None], 1.0 - f[:, None]), axis=2
    )
    np.testing.assert_allclose(radiance, np.einsum("mk,mkc->mc", tri, lit[corners, :3]), rtol=1e-5)


def test_light_that_follows_the_normals_is_right_for_any_normals():
    """And light that does not stays as it is."""
    points = border_points()
    grade, lit, towards = lit_texels(points)
    lit[:, 4:] = [0.3, 0.2, 0.1]
    lit[:, :3] = unshadowed_of(towards) + lit[:, 4:]
    normals = some_normals(len(points))
    radiance, _, _ = carry(points, records_of(grade, lit, towards), normals)
    np.testing.assert_allclose(radiance, unshadowed_of(normals) + lit[0, 4:], rtol=1e-5)


def test_a_colour_that_the_light_lacks_stays_dark():
    points = border_points()
    grade, lit, towards = lit_texels(points, (FINAL, UNBAKED_GRADE))
    lit[:, [1, 5]] = 0.0
    unshadowed = Unshadowed(*(each.copy() for each in UNSHADOWED))
    for each in unshadowed:
        each[1] = 0.0
    radiance, _, error = carry(
        points, records_of(grade, lit, towards, unshadowed), some_normals(len(points)), unshadowed
    )
    assert not radiance[:, 1].any() and (radiance[:, 0] > 0.0).all() and np.isfinite(error).all()


def test_no_light_at_all_is_black_and_final():
    points = border_points()
    grade, lit, towards = lit_texels(points)
    dark = Unshadowed(*(0.0 * each for each in UNSHADOWED))
    radiance, state, error = carry(
        points, records_of(grade, 0.0 * lit, towards, dark), some_normals(len(points)), dark
    )
    assert not radiance.any() and not error.any() and (state == FINAL).all()


@pytest.mark.parametrize("unit", [2.0**-100, 2.0**100])
def test_ratios_are_carried_in_units(unit):
    points = border_points()
    grade, lit, towards = lit_texels(points, (FINAL, UNBAKED_GRADE, VOID_GRADE))
    records = records_of(grade, lit, towards)
    normals = some_normals(len(points))
    one, other = (carry(points, records, normals, unit=each) for each in (1.0, unit))
    assert np.array_equal(other[0], one[0] * np.float32(unit))
    assert all(np.array_equal(*pair) for pair in zip(one[1:], other[1:], strict=True))


def test_a_point_does_not_depend_on_its_company():
    points = border_points()
    grade, lit, towards = lit_texels(points, (FINAL, UNBAKED_GRADE, VOID_GRADE, BURIED_GRADE))
    records = records_of(grade, lit, towards)
    normals = some_normals(len(points))
    corners = view_of(points)[2]
    whole = carry(points, records, normals)
    for m in range(0, len(points), 37):
        planes = Framebuffer(
            np.zeros((1, 3), np.float32), np.zeros(1, np.uint8), np.zeros(1, np.float32)
        )
        own = slice(m, m + 1)
        some = SurfacePoints(points[own], normals[own], np.zeros(1, np.uint32))
        carry_ratios(lattice(), some, corners[own], records, UNSHADOWED, np.float32(1.0), planes)
        assert all(
            np.array_equal(one[0], all_of[m]) for one, all_of in zip(planes, whole, strict=True)
        )


def test_what_exceeds_the_unshadowed_light_is_reflected():
    """Texels that nothing shadows, and that reflect on each other, are taken apart exactly,
    whichever way they face.
    """
    points = border_points()
    grade, lit, towards = lit_texels(points)
    reflected = 0.3
    lit[:, :3] = unshadowed_of(towards) + reflected
    lit[:, 4:] = 0.0
    records = records_of(grade, lit, towards, whole=True)
    np.testing.assert_allclose(records[:, 8:11], reflected, rtol=1e-4)
    normals = some_normals(len(points))
    light, _, _ = carry(points, records, normals)
    np.testing.assert_allclose(light, unshadowed_of(normals) + reflected, rtol=1e-4)


def test_pixels_do_not_glow_by_texels_that_face_away():
    """Texels that face away from it are lit by what is around alone: as direct light theirs would
    be 40 times it.
    """
    points = border_points()
    quadric = np.zeros((3, 9), np.float32)
    quadric[:, 2] = 1.0
    above = Unshadowed(quadric, np.full(3, 0.05, np.float32))
    grade, lit, towards = lit_texels(points)
    towards[:] = 0.0, 0.0, -1.0
    lit[:, :3] = 2.0
    lit[:, 4:] = 0.0
    normals = np.tile(np.array([0.0, 0.0, 1.0], np.float32), (len(points), 1))
    whole, apart = (
        carry(points, records_of(grade, lit, towards, above, each), normals, above)[0]
        for each in (True, False)
    )
    np.testing.assert_allclose(whole, 1.0 + 2.0 - 0.05, rtol=1e-4)
    np.testing.assert_allclose(apart, 40.0, rtol=1e-4)
