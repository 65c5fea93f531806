import numpy as np

from isogi_core.bake.texel_light import VOID, Light, Part
from isogi_core.model.scene_plan import Layer, ScenePlan
from tests.bake.texels import same

PLAN = ScenePlan("transfer", (Layer("direct", 3), Layer("indirect", 2, 3)), 3, 2, 1.0, 4096)


def some_light(texels: int, seed: int = 1) -> Light:
    """Light of random numbers, 16 samples each."""
    rng = np.random.default_rng(seed)
    light = Light.dark(PLAN, texels)
    for part in light.parts:
        part.samples[:] = 16
        part.noise[:] = rng.random(part.noise.shape)
        part.coefficients[:] = rng.normal(size=part.coefficients.shape)
    return light


def test_dark_texels_have_a_row_in_each_layer() -> None:
    light = Light.dark(PLAN, 7)
    assert len(light) == 7
    assert [part.coefficients.shape for part in light.parts] == [(7, 1, 9), (7, 3, 4)]
    assert [part.noise.shape for part in light.parts] == [(7, 2), (7, 2)]
    assert not light.samples.any() and not light.void.any() and not light.transfer.any()
    assert Part.dark(Layer("whole"), 2).noise.shape == (2, 1)


def test_rows_are_copies_and_are_put_back_where_they_were() -> None:
    light, before = some_light(9), some_light(9)
    which = np.array([7, 0, 4])
    rows = light.rows(which)
    for part in rows.parts:
        part.coefficients[:] += 1.0
    assert same(light, before), "a copy"
    light.put(which, rows)
    assert same(light.rows(which), rows)
    others = np.setdiff1d(np.arange(9), which)
    assert same(light.rows(others), before.rows(others))


def test_a_texel_has_the_samples_of_its_least_sampled_layer() -> None:
    light = some_light(4)
    light.parts[0].samples[:] = [64, 16, VOID, VOID]
    light.parts[1].samples[:] = [16, 0, VOID, 0]
    assert light.samples.tolist() == [16, 0, VOID, VOID]
    assert light.void.tolist() == [False, False, True, True]


def test_layers_add_up_over_their_orders_and_channels() -> None:
    light = some_light(5)
    direct, indirect = (part.coefficients for part in light.parts)
    assert light.transfer.shape == (5, 3, 9)
    for channel in range(3):
        np.testing.assert_array_equal(light.transfer[:, channel, :4], direct[:, 0, :4] + indirect[:, channel])
        np.testing.assert_array_equal(light.transfer[:, channel, 4:], direct[:, 0, 4:])


def test_a_texel_void_in_one_layer_is_made_void_in_all() -> None:
    """As when one layer is read before, and the other after, somebody else has written both."""
    light = some_light(9)
    light.parts[0].samples[5] = VOID
    light.agree_on_void()
    assert [part.samples.tolist() for part in light.parts] == [[16] * 5 + [VOID] + [16] * 3] * 2
