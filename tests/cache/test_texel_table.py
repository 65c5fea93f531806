"""Rows of light against plain NumPy: what frames read of texels, and what they note of each."""

from dataclasses import replace
from itertools import pairwise, product

import numpy as np
import pytest

from isogi_core.bake.bake_spec import BakeSpec
from isogi_core.bake.noise import relative_error, scatter, standard_error
from isogi_core.bake.texel_light import VOID, Light, Part, level_codes
from isogi_core.cache.page_pool import MAX_SAMPLE_LEVELS, SHOWN_CHECKSUMS, fewest_samples, fill_rows, new_rows
from isogi_core.kernels.shading.lattice import BURIED_ROW, UNLIT_ROW, VOID_ROW
from isogi_core.kernels.shading.texel_table import Rows
from isogi_core.model.scene_plan import MIN_SAMPLES, Layer, ScenePlan
from tests.bake.texels import plan_of, spec_of

PLANS = (
    plan_of(Layer("direct", 3), Layer("indirect", 2, 3, half=False)),
    plan_of(Layer("direct", 6, coarse=3), Layer("indirect", 2)),
    plan_of(Layer("indirect", 2), Layer("direct", 4)),
    plan_of(Layer("whole", 2, 3)),
    plan_of(Layer("whole"), representation="constant"),
    plan_of(Layer("irradiance", channels=3), representation="irradiance"),
    ScenePlan("vicinity", (Layer("direct", 3),), 1, 0, 1.0, 4096),
    replace(plan_of(Layer("direct", 3), Layer("indirect", 5)), lobes=1),
    replace(plan_of(Layer("indirect", 2, 3), Layer("direct", 4)), lobes=1),
    plan_of(Layer("direct", 3), Layer("indirect", 2, 3, nodes=(0.4, 0.7, 0.9))),
    replace(plan_of(Layer("direct", 2), Layer("indirect", 4, 2, nodes=(0.5, 0.8))), lobes=1),
)
LOOKS = [spec_of(plan) for plan in PLANS]
SPEC = LOOKS[0]


def light_of(samples: list[list[int]], spec: BakeSpec = SPEC) -> Light:
    """Light with these samples, a list for each part, that is dark all over."""
    light = Light.dark(spec.plan, len(samples[0]))
    for part, own in zip(light.parts, samples, strict=True):
        part.samples[:] = own
    return light


def random_light(spec: BakeSpec, texels: int) -> Light:
    """Light of every kind of texel: void, without samples or with few in any part, and dark in any."""
    rng, light = np.random.default_rng(7), Light.dark(spec.plan, texels)
    for part in light.parts:
        part.samples[:] = rng.choice([VOID, 0, 16, 32, MIN_SAMPLES, 8 * MIN_SAMPLES], texels)
        part.noise[:] = rng.random(part.noise.shape) ** 4
        part.coefficients[:] = rng.normal(size=part.coefficients.shape) * 0.1
        part.coefficients[:, :, 0] = rng.random(part.coefficients.shape[:2])
        part.coefficients[rng.random(texels) < 0.5] = 0.0
    return light


def filled(light: Light, spec: BakeSpec = SPEC) -> tuple[Rows, np.ndarray]:
    """The rows of texels' light, and where each is looked up."""
    rows = new_rows(spec, len(light))
    return rows, fill_rows(rows, np.arange(len(light), dtype=np.int32), light, spec)


def stamps_of(light: Light) -> np.ndarray:
    """How far each texel is baked, in NumPy."""
    weights = MAX_SAMPLE_LEVELS ** np.arange(len(light.parts))
    rungs = weights @ [np.where(part.samples == VOID, 0, level_codes(part.samples)) for part in light.parts]
    shown = sum(shown_bits(part) for part in light.parts)
    return np.asarray(rungs + MAX_SAMPLE_LEVELS ** len(light.parts) * (shown % SHOWN_CHECKSUMS), np.float32)


def shown_bits(part: Part) -> np.ndarray:
    """The bits of coefficients as numbers, summed, of texels that have no samples; 0 of the others."""
    sums = part.coefficients.view(np.int32).sum(axis=(1, 2), dtype=np.int64)
    return np.where(part.samples == 0, sums, 0)


def places_of(light: Light) -> np.ndarray:
    """Where each texel is looked up, in NumPy."""
    none = np.array([~part.coefficients.any(axis=(1, 2)) for part in light.parts])
    straight = np.array([part.layer.kind != "indirect" for part in light.parts])
    unlit = (none & [part.samples == 0 for part in light.parts])[straight].any(axis=0)
    dark = none.all(axis=0) & all(part.layer.kind != "irradiance" for part in light.parts)
    buried = np.where(dark & (light.samples >= MIN_SAMPLES), BURIED_ROW, np.arange(len(light)))
    return np.where(light.void, VOID_ROW, np.where(unlit, UNLIT_ROW, buried))


@pytest.mark.parametrize("spec", LOOKS, ids=[f"{plan.layers}{plan.lobes}" for plan in PLANS])
def test_rows_are_what_numpy_makes_of_the_light(spec: BakeSpec) -> None:
    light = random_light(spec, 2000)
    rows, places = filled(light, spec)
    np.testing.assert_array_equal(rows.transfer, light.columns(spec.terms))
    np.testing.assert_allclose(rows.error, relative_error(light, spec), rtol=1e-6)
    np.testing.assert_allclose(rows.scatter, scatter(standard_error(light, spec), light, spec), rtol=2e-6)
    np.testing.assert_array_equal(rows.stamp, stamps_of(light))
    np.testing.assert_array_equal(places, places_of(light))
    assert {UNLIT_ROW, VOID_ROW} <= {*places.tolist()} and (places >= 0).any()


def test_only_the_given_rows_are_written() -> None:
    light, rows = random_light(SPEC, 50), new_rows(SPEC, 120)
    for column in rows:
        column[:] = -7.0
    numbers = np.random.default_rng(3).permutation(120)[:50].astype(np.int32)
    places = fill_rows(rows, numbers, light, SPEC)
    expected, lit = filled(light)
    others = np.setdiff1d(np.arange(120), numbers)
    for column, own in zip(rows, expected, strict=True):
        np.testing.assert_array_equal(column[numbers], own)
        assert (column[others] == -7.0).all()
    assert np.array_equal(places, np.where(lit >= 0, numbers, lit))


def test_no_texels_are_no_rows() -> None:
    rows, places = filled(Light.dark(SPEC.plan, 0))
    assert len(rows.transfer) == 0 and places.size == 0 and places.dtype == np.int32


# --- stamps -------------------------------------------------------------------------------------------------------


def test_stamps_tell_any_two_states_of_a_texel_apart() -> None:
    ladder = [0, *(16 << level for level in range(27))]
    direct, indirect = np.array(list(product(ladder, repeat=2))).T
    stamps = filled(light_of([direct.tolist(), indirect.tolist()]))[0].stamp
    assert stamps.dtype == np.float32 and (stamps >= 0).all()
    assert len(set(stamps.tolist())) == len(ladder) ** 2
    assert np.array_equal(fewest_samples(stamps, 2), np.minimum(direct, indirect))


def test_stamps_change_with_light_that_is_shown_without_samples() -> None:
    """Frames of an earlier plan's light, which may grow, must not pass for the same."""
    light = light_of([[0, 0, 0, 64], [64, 0, 0, 64]])
    dark = filled(light)[0].stamp
    rng, seen = np.random.default_rng(1), [dark[:3]]
    for part in light.parts * 10:
        part.coefficients[:] = rng.normal(size=part.coefficients.shape).astype(np.float16)
        seen.append(filled(light)[0].stamp[:3])
    assert all((one != other).any() for one, other in pairwise(seen)) and len(set(np.ravel(seen).tolist())) > 30
    assert np.array_equal(fewest_samples(seen[-1], 2), [0, 0, 0]) and filled(light)[0].stamp[3] == dark[3]
    assert np.max(seen) < 2**24, "single floats count no further"


def test_texels_without_a_row_have_no_samples() -> None:
    marks = np.array([UNLIT_ROW, VOID_ROW, BURIED_ROW], np.float32)
    assert fewest_samples(marks, 2).tolist() == [0, 0, 0]


# --- texels without a row -----------------------------------------------------------------------------------------


def test_buried_are_texels_from_which_no_path_of_any_part_left() -> None:
    light = light_of(
        [
            [MIN_SAMPLES, MIN_SAMPLES, MIN_SAMPLES, MIN_SAMPLES, 16, VOID, 4 * MIN_SAMPLES],
            [MIN_SAMPLES, MIN_SAMPLES, MIN_SAMPLES, 0, MIN_SAMPLES, 0, MIN_SAMPLES],
        ]
    )
    light.parts[0].coefficients[1, 0, 0] = 1e-6
    light.parts[1].coefficients[2, 2, 0] = 1e-6
    assert filled(light)[1].tolist() == [BURIED_ROW, 1, 2, 3, 4, VOID_ROW, BURIED_ROW]


def test_dark_irradiance_is_not_buried() -> None:
    """Lights that do not move may leave a side of the surface black, which light would reach."""
    spec = spec_of(plan_of(Layer("irradiance"), representation="irradiance"))
    assert filled(light_of([[MIN_SAMPLES, VOID]], spec), spec)[1].tolist() == [0, VOID_ROW]


def test_reflected_light_alone_is_not_shown() -> None:
    """Direct light may be known of another layer, and then has no samples here."""
    light = light_of([[0, 0, MIN_SAMPLES, MIN_SAMPLES], [MIN_SAMPLES, MIN_SAMPLES, 0, MIN_SAMPLES]])
    for part, lit in zip(light.parts, ([1, 2, 3], [0, 1, 3]), strict=True):
        part.coefficients[lit, 0, 0] = 0.5
    assert filled(light)[1].tolist() == [UNLIT_ROW, 1, 2, 3]
