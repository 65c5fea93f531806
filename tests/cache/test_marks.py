"""What the page pool notes of each texel: how far it is baked, and whether it is buried or void."""

from itertools import pairwise, product

import numpy as np

from isogi_core.bake.light import Light
from isogi_core.bake.precision import VOID
from isogi_core.cache.pages import fewest_samples, marks_of, stamps_of
from isogi_core.kernels.lattice import BURIED_ROW, UNLIT, VOID_ROW
from isogi_core.model.plan import FEWEST, Layer, ScenePlan
from tests.cache.chunks import PLAN


def light_of(samples: list[list[int]], plan: ScenePlan = PLAN) -> Light:
    """Light with these samples, a list for each part, that is dark all over."""
    light = Light.dark(plan, len(samples[0]))
    for part, own in zip(light.parts, samples, strict=True):
        part.samples[:] = own
    return light


def test_stamps_tell_any_two_states_of_a_texel_apart() -> None:
    ladder = [0, *(16 << rung for rung in range(27))]
    direct, indirect = np.array(list(product(ladder, repeat=2))).T
    stamps = stamps_of(light_of([direct.tolist(), indirect.tolist()]))
    assert stamps.dtype == np.float32 and (stamps >= 0).all()
    assert len(set(stamps.tolist())) == len(ladder) ** 2
    assert np.array_equal(fewest_samples(stamps, 2), np.minimum(direct, indirect))


def test_stamps_change_with_light_that_is_shown_without_samples() -> None:
    """Frames of an earlier plan's light, which may grow, must not pass for the same."""
    light = light_of([[0, 0, 0, 64], [64, 0, 0, 64]])
    dark = stamps_of(light)
    rng, seen = np.random.default_rng(1), [dark[:3]]
    for part in light.parts * 10:
        part.coefficients[:] = rng.normal(size=part.coefficients.shape).astype(np.float16)
        seen.append(stamps_of(light)[:3])
    assert all((one != other).any() for one, other in pairwise(seen)) and len(set(np.ravel(seen).tolist())) > 30
    assert np.array_equal(fewest_samples(seen[-1], 2), [0, 0, 0]) and stamps_of(light)[3] == dark[3]
    assert np.max(seen) < 2**24, "single floats count no further"


def test_texels_without_a_row_have_no_samples() -> None:
    marks = np.array([UNLIT, VOID_ROW, BURIED_ROW], np.float32)
    assert fewest_samples(marks, 2).tolist() == [0, 0, 0]


def test_buried_are_texels_from_which_no_path_of_any_part_left() -> None:
    light = light_of(
        [[FEWEST, FEWEST, FEWEST, FEWEST, 16, VOID, 4 * FEWEST], [FEWEST, FEWEST, FEWEST, 0, FEWEST, 0, FEWEST]]
    )
    light.parts[0].coefficients[1, 0, 0] = 1e-6
    light.parts[1].coefficients[2, 2, 0] = 1e-6
    row = 0
    assert marks_of(light).tolist() == [BURIED_ROW, row, row, row, row, VOID_ROW, BURIED_ROW]
    assert marks_of(light).dtype == np.int32


def test_dark_irradiance_is_not_buried() -> None:
    """Lights that do not move may leave a side of the surface black, which light would reach."""
    plan = ScenePlan("irradiance", (Layer("irradiance"),), 1, 2, 1.0, 4096)
    assert marks_of(light_of([[FEWEST, VOID]], plan)).tolist() == [0, VOID_ROW]


def test_reflected_light_alone_is_not_shown() -> None:
    """Direct light may be known of another layer, and then has no samples here."""
    light = light_of([[0, 0, FEWEST, FEWEST], [FEWEST, FEWEST, 0, FEWEST]])
    for part, lit in zip(light.parts, ([1, 2, 3], [0, 1, 3]), strict=True):
        part.coefficients[lit, 0, 0] = 0.5
    assert marks_of(light).tolist() == [UNLIT, 0, 0, 0]
