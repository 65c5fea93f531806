"""Bake specs: what paths count, the light that texels are put under, what noise counts in it, and
several albedos.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.bake_spec import SPECS, BakeSpec, band_of, spec_for, spec_name
from isogi_core.bake.noise import deviation, relative_error
from isogi_core.bake.refine import add, locate, sample_transfer
from isogi_core.bake.texel_light import Light, Part
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.model.scene_plan import GlowLayer, Layer, ScenePlan
from isogi_core.prepared.prepared_scene import PreparedScene
from tests.bake.texels import (
    ALBEDO,
    CONSTANT,
    SKY,
    climbed,
    orbital,
    plan_of,
    rotations_of,
    spec_of,
    surface_texels,
)
from tests.loaded import load_scene


def test_bands_of_coefficients() -> None:
    assert band_of(3).tolist() == [0, 1, 1, 1, 2, 2, 2, 2, 2]


# --- what paths count
# -------------------------------------------------------------------------------------------


def test_paths_count_the_albedo_to_the_power_of_bounces() -> None:
    r, g, b = ALBEDO
    spec = spec_of(plan_of(Layer("direct", 5), Layer("indirect", 3, 3)))
    assert spec.shares([Layer("direct", 5)]).tolist() == [[0.0, 1.0]], (
        "paths end where they met a surface"
    )
    expected = [[0.0, 0.0, a, a**2, a**3] for a in (r, g, b)]
    np.testing.assert_allclose(spec.shares([Layer("indirect", 3, 3)]), expected)
    np.testing.assert_allclose(spec.shares([Layer("whole", 1, 3)])[:, 1], 1.0)
    np.testing.assert_allclose(
        spec.shares([Layer("whole", 1, 3)])[:, 2:], np.array(expected)[:, 2:]
    )
    np.testing.assert_allclose(spec.shares([Layer("whole")]), [[0.0, 1.0, r, r**2, r**3]])


def test_direct_and_indirect_light_are_the_whole() -> None:
    spec = spec_of(plan_of(Layer("direct", 5), Layer("indirect", 5)))
    direct = np.pad(spec.shares([Layer("direct")]), ((0, 0), (0, 3)))
    assert np.array_equal(direct + spec.shares([Layer("indirect")]), spec.shares([Layer("whole")]))


def test_a_black_surface_reflects_nothing_and_sees_the_light() -> None:
    spec = spec_of(plan_of(Layer("whole")), albedo=0.0)
    assert spec.shares([Layer("whole")]).tolist() == [[0.0, 1.0, 0.0, 0.0, 0.0]]


# --- the light
# --------------------------------------------------------------------------------------------------


def test_a_larger_layer_is_put_under_the_light_of_its_plan() -> None:
    plain = spec_of(plan_of(Layer("direct", 3)))
    smaller = BakeSpec(plain.prepared, ScenePlan("transfer", plain.plan.layers, 2, 0, 1.0, 4096))
    assert np.array_equal(smaller.light, plain.light[:, :4])
    assert plain.light.shape == (3, 9) and plain.order == 3
    energy = np.add.reduceat(smaller.luminance_light.sum(axis=0) ** 2, [0, 1])
    np.testing.assert_allclose(
        smaller.gains(Layer("direct", 3)), [energy[0] + 0.6 * energy[1], 0.4 * energy[1]]
    )


def test_irradiance_has_met_its_light_already() -> None:
    spec = spec_of(
        plan_of(Layer("irradiance", channels=3), representation="irradiance"), rotating=False
    )
    assert (spec.order, spec.channels) == (1, 3)
    assert spec.light.tolist() == [[1.0]] * 3


@pytest.mark.parametrize("channels", [1, 3])
def test_luminance_light_gives_the_reflected_luminance(channels: int) -> None:
    spec = spec_of(plan_of(Layer("direct", 5), Layer("indirect", 5, channels)))
    transfer = np.random.default_rng(1).normal(size=(channels, 25))
    colour = np.array(ALBEDO) * np.einsum(
        "cn,cn->c", np.broadcast_to(transfer, (3, 25)), spec.light
    )
    assert spec.luminance_light.shape == (channels, 25)
    assert (spec.luminance_light * transfer).sum() == pytest.approx(LUMINANCE_WEIGHTS @ colour)


@pytest.mark.parametrize("lights", [[CONSTANT], [SKY], [CONSTANT, SKY]])
def test_unoccluded_light_is_the_mean_times_the_albedo(lights: list[Any]) -> None:
    spec = spec_of(plan_of(Layer("direct", 3)), lights=lights)
    mean = spec.prepared.scene.lighting.environment.mean()
    assert spec.unoccluded == pytest.approx(LUMINANCE_WEIGHTS @ (np.array(ALBEDO) * mean), rel=1e-3)


# --- terms
# --------------------------------------------------------------------------------------------------


def test_without_lobes_direct_and_reflected_light_meet_the_same() -> None:
    spec = spec_of(plan_of(Layer("direct", 5), Layer("indirect", 3)))
    direct, indirect = spec.terms
    assert (direct.layers, indirect.layers, spec.lobes) == ((0,), (1,), ())
    assert (spec.columns, spec.straight) == (25 + 9, 25)
    assert np.array_equal(direct.light, spec.light) and np.array_equal(
        direct.luminance, spec.luminance_light
    )
    assert np.array_equal(indirect.light, spec.light[:, :9])
    assert np.array_equal(spec.beside, spec.prepared.around)
    (whole,) = (alone := spec_of(plan_of(Layer("whole", 3)))).terms
    assert whole.layers == (0,) and alone.straight == alone.columns == 9


def test_with_lobes_only_direct_light_meets_the_rest() -> None:
    spec = spec_of(replace(plan_of(Layer("direct", 3), Layer("indirect", 5)), lobes=1))
    direct, indirect = spec.terms
    assert (direct.layers, direct.order, indirect.layers, indirect.order, spec.columns) == (
        (0,),
        3,
        (1,),
        5,
        34,
    )
    assert np.array_equal(indirect.light, spec.light)
    (sun,) = spec.lobes
    np.testing.assert_allclose(
        (spec.light[:, :9] - direct.light)[:, 0] * math.sqrt(4.0 * math.pi), sun.flux
    )
    assert [spec.term_of(layer) for layer in spec.plan.layers] == [direct, indirect]
    np.testing.assert_allclose(
        (spec.prepared.around - spec.beside)[:, 0] * math.sqrt(4.0 * math.pi), sun.flux
    )
    assert (
        spec.gains(spec.plan.layers[0])
        < spec_of(plan_of(Layer("direct", 3))).gains(spec.plan.layers[0])
    ).all()


def test_direct_light_alone_is_a_term_beside_lobes() -> None:
    spec = spec_of(replace(plan_of(Layer("direct", 3)), lobes=1))
    (term,) = spec.terms
    assert term.layers == (0,) and not np.allclose(term.light, spec.light)


def test_columns_are_those_of_the_terms_side_by_side() -> None:
    spec = spec_of(replace(plan_of(Layer("direct", 3), Layer("indirect", 4, 3)), lobes=1))
    light = Light.dark(spec.plan, 5)
    for part in light.parts:
        part.coefficients[:] = np.random.default_rng(2).normal(size=part.coefficients.shape)
    columns = light.columns(spec.terms)
    assert columns.shape == (5, 3, 9 + 16)
    assert np.array_equal(columns[:, :, :9], np.repeat(light.parts[0].coefficients, 3, axis=1))
    assert np.array_equal(columns[:, :, 9:], light.parts[1].coefficients)


# --- what noise counts
# ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "layer", [Layer("direct", 5), Layer("indirect", 3), Layer("indirect", 5, 3)]
)
def test_gains_are_the_deviation_over_random_rotations(layer: Layer) -> None:
    """Errors whose variance grows from band 0 on as l², those of the channels being those of one
    path.
    """
    spec = spec_of(plan_of(Layer("direct", 5), layer))
    rng = np.random.default_rng(3)
    variance = 0.09 + 0.03 * np.arange(layer.order) ** 2
    noise = np.sqrt([variance[0], variance[1:].mean()])
    wrong = np.zeros((500, 25))
    wrong[:, : layer.order**2] = rng.normal(size=(500, layer.order**2)) * np.sqrt(
        variance[band_of(layer.order)]
    )
    lights = rotations_of(spec.luminance_light, 400)
    seen = np.sqrt(((lights.sum(axis=1) @ wrong.T) ** 2).mean())
    estimated = np.sqrt(noise**2 @ spec.gains(layer))
    assert estimated == pytest.approx(seen, rel=0.05)


def test_constant_light_ignores_noise_above_band_0() -> None:
    spec = spec_of(
        plan_of(Layer("direct", 5), representation="transfer"), lights=[CONSTANT], albedo=1.0
    )
    np.testing.assert_allclose(spec.gains(Layer("direct", 5)), [4.0 * np.pi, 0.0], atol=1e-12)


def gain_of_glows(*radiances: float) -> float:
    """The weight of the squared noise of glows of these radiances in that of a texel."""
    glows = [{"sphere": [20, 20, 20, 5], "radiance": each} for each in radiances]
    spec = spec_for(PreparedScene(load_scene("demo:orbital", glow=glows)), "gi")
    (layer,) = (each for each in spec.plan.layers if isinstance(each, GlowLayer))
    assert layer.glows == len(radiances)
    return float(spec.gains(layer).item())


def test_glows_err_together_as_much_as_the_brightest() -> None:
    """The same paths gather all of them."""
    assert gain_of_glows(1.0, 1.0) == pytest.approx(gain_of_glows(2.0))
    assert gain_of_glows(1.0, 3.0) == pytest.approx(gain_of_glows(6.0))


def test_one_noise_has_one_gain() -> None:
    spec = orbital(sky=False)
    assert spec.plan.representation == "constant"
    assert spec.gains(spec.plan.layers[0]).tolist() == pytest.approx([0.49 * 4.0 * np.pi])


LAMP = {"type": "directional", "azimuth": 100.0, "elevation": 30.0}


@pytest.mark.parametrize(
    "colour", [(0.0, 0.0, 3.0), (0.0, 3.0, 0.0), (1.0, 2.0, 3.0)], ids=["blue", "green", "mixed"]
)
@pytest.mark.parametrize("albedo", [list(ALBEDO), 0.0], ids=["coloured", "black"])
def test_noise_of_irradiance_is_the_error_of_its_luminance(
    colour: tuple[float, ...], albedo: Any
) -> None:
    """Sums of two randomisations whose colours err apart: the estimate is half the difference of
    their luminance.
    """
    layer = Layer("irradiance", channels=3)
    count = 32
    lamp = {**LAMP, "irradiance": list(colour)}
    spec = spec_of(
        plan_of(layer, representation="irradiance"), lights=[lamp], albedo=albedo, rotating=False
    )
    halves = np.random.default_rng(4).random((50, 2, 3, 1)) * np.array(colour)[:, None] * count / 2
    part = Part.dark(layer, 50)
    add(part, np.arange(50), halves, np.zeros(50), count, spec)
    luminance = (halves[..., 0] / (count / 2)) @ (
        LUMINANCE_WEIGHTS * np.array(spec.prepared.scene.surfaces.albedo)
    )
    np.testing.assert_allclose(
        deviation(part, spec), abs(luminance[:, 0] - luminance[:, 1]) / 2, rtol=0.05
    )


def test_colours_are_judged_by_their_luminance() -> None:
    spec = spec_of(plan_of(Layer("direct", 5), Layer("indirect", 5, 3)))
    halves = np.random.default_rng(5).normal(size=(10, 2, 3, 25))
    mix = LUMINANCE_WEIGHTS * np.array(ALBEDO)
    expected = (halves * (mix / mix.sum())[:, None]).sum(axis=2)
    np.testing.assert_allclose(spec.luminance_sums(halves, Layer("indirect", 5, 3)), expected)
    assert np.array_equal(
        spec.luminance_sums(halves[:, :, :1], Layer("direct", 5)), halves[:, :, 0]
    )


# --- which spec
# -------------------------------------------------------------------------------------------------


def test_only_vicinity_shading_has_a_spec_of_its_own() -> None:
    assert [spec_name(shading) for shading in ("gi", "vicinity", "path_traced", "phong")] == [
        "gi",
        "vicinity",
        "gi",
        "gi",
    ]
    assert [spec_name(name) for name in SPECS] == list(SPECS)


def test_vicinity_of_a_transfer_scene_is_band_0_of_direct_light() -> None:
    gi = orbital()
    vicinity = orbital(shading="vicinity")
    assert gi.plan.representation == "transfer"
    assert vicinity.plan.layers == gi.plan.layers[:1]
    assert (vicinity.order, vicinity.channels, vicinity.plan.bounces) == (1, 1, 0)
    np.testing.assert_allclose(vicinity.light, gi.light[:, :1])
    np.testing.assert_allclose(
        vicinity.gains(vicinity.plan.layers[0]), [gi.luminance_light[0, 0] ** 2, 0.0]
    )


def test_vicinity_is_under_the_mean_of_all_light() -> None:
    """A lamp of irradiance E is as much light as a constant radiance of E / 4π."""
    prepared = PreparedScene(
        load_scene("demo:orbital", lights=[{**LAMP, "irradiance": 3.0}, CONSTANT])
    )
    radiance = spec_for(prepared, "vicinity").light[:, 0] / math.sqrt(4.0 * math.pi)
    np.testing.assert_allclose(radiance, 1.0 + 3.0 / (4.0 * math.pi))
    constant = orbital(sky=False, shading="vicinity")
    np.testing.assert_allclose(constant.light, np.full((3, 1), math.sqrt(4.0 * math.pi)))


def test_vicinity_of_a_constant_scene_has_a_layer_of_its_own() -> None:
    gi = orbital(sky=False)
    vicinity = orbital(sky=False, shading="vicinity")
    assert [layer.kind for layer in gi.plan.layers] == ["whole"]
    assert vicinity.plan.layers == (Layer("direct"),)
    assert len({spec.digest for spec in (gi, vicinity)}) == 2


def test_digests_of_specs_hold_layers_and_not_light() -> None:
    """Where the scene settles its plan, as another light may choose another order."""
    settled = {"order": 5, "indirect_order": 2, "precision": "half", "bounces": 3}
    prepared, other = (
        PreparedScene(load_scene("demo:orbital", lights=lights, **settled))
        for lights in ([SKY], [SKY, CONSTANT])
    )
    specs = [spec_for(prepared, name) for name in SPECS]
    assert len({spec.digest for spec in specs}) == 2
    assert [spec_for(other, name).digest for name in SPECS] == [spec.digest for spec in specs]
    assert not np.array_equal(spec_for(other, "gi").light, specs[0].light)


# --- several albedos
# --------------------------------------------------------------------------------------------------


PATHS = 64
EXACT = {"precision": "single", "albedos": (0.0, 0.9)}


@pytest.fixture(scope="module")
def live() -> BakeSpec:
    """The orbital under a sky at albedo 0.3, of which views may ask for up to 0.9; three bounces,
    single floats.
    """
    return orbital(0.3, **EXACT)


def of_one_albedo(albedo: float, live: BakeSpec) -> BakeSpec:
    """The orbital of an albedo, with the orders and the survival of paths of a spec of several."""
    fixed = orbital(albedo, precision="single")
    orders = [layer.order for layer in live.plan.layers]
    layers = tuple(
        replace(layer, order=order) for layer, order in zip(fixed.plan.layers, orders, strict=True)
    )
    return BakeSpec(fixed.prepared, replace(fixed.plan, layers=layers, survival=live.plan.survival))


def test_each_node_is_the_bake_of_its_albedo(live: BakeSpec) -> None:
    texels = surface_texels(live, 30)
    direct, indirect = climbed(live, texels, PATHS).parts
    for channel, node in enumerate(live.plan.nodes):
        alone = climbed(of_one_albedo(node, live), texels, PATHS).parts
        assert np.array_equal(alone[0].coefficients, direct.coefficients)
        assert np.array_equal(alone[1].coefficients[:, 0], indirect.coefficients[:, channel])


def test_light_of_any_albedo_is_that_of_its_bounces() -> None:
    """Σ R^k τ_k, of the same paths: mixed light comes to it within its share of the target
    error.
    """
    live = orbital(0.3, sky=False, **EXACT)
    texels = surface_texels(live, 200)
    place, void = locate(texels, live.prepared)
    direct, indirect = live.plan.layers
    halves = [sums for sums, _ in sample_transfer((direct, indirect), place, void, live, 0, PATHS)]
    straight, kept = (each.sum(axis=1)[~void, :, 0] / PATHS for each in halves)
    alone = [Layer("indirect", channels=1, nodes=(node,)) for node in (0.2, 0.45, 0.8)]
    for layer, (sums, _) in zip(
        alone, sample_transfer(alone, place, void, live, 0, PATHS), strict=True
    ):
        true = sums.sum(axis=1)[~void, 0, 0] / PATHS
        mixed = kept @ live.of_albedo((layer.nodes[0], 0.5, 0.1)).mixing[0]
        error = np.sqrt(((mixed - true) ** 2).mean()) / (straight[:, 0] + true).mean()
        assert 0.0 < error <= 0.25 * live.prepared.scene.target_error


def test_three_bounces_and_three_nodes_leave_no_error() -> None:
    """As many nodes as bounces: light is a polynomial of the albedo, and what is mixed of it the
    same.
    """
    live = orbital(0.3, sky=False, target_error=1e-4, **EXACT)
    assert len(live.plan.nodes) == live.plan.bounces == 3
    place, void = locate(surface_texels(live, 50), live.prepared)
    layers = (live.plan.layers[1], Layer("indirect", nodes=(0.55,)))
    kept, true = (sums for sums, _ in sample_transfer(layers, place, void, live, 0, PATHS))
    mixed = np.einsum("mhjn,j->mhn", kept, live.of_albedo((0.55,) * 3).mixing[0])
    np.testing.assert_allclose(mixed, true[:, :, 0], atol=1e-6 * np.abs(true).max())


def test_a_spec_of_another_albedo_names_the_same_stored_light(live: BakeSpec) -> None:
    seen = live.of_albedo((0.9, 0.5, 0.1))
    assert seen.albedo == (0.9, 0.5, 0.1) and seen.digest == live.digest and seen.unit == live.unit
    assert live.of_albedo(live.albedo) is live and live.of_albedo((0.3,) * 3) is live.of_albedo(
        (0.3,) * 3
    )


def test_terms_are_the_light_times_what_each_node_counts(live: BakeSpec) -> None:
    seen = live.of_albedo((0.9, 0.5, 0.1))
    direct, *nodes = seen.terms
    assert direct.node is None and [term.node for term in nodes] == list(
        range(len(live.plan.nodes))
    )
    for term, counts in zip(nodes, seen.mixing.T, strict=True):
        np.testing.assert_allclose(term.light, counts[:, None] * live.light[:, : term.order**2])
    last = np.array([term.light for term in live.terms[1:]])
    np.testing.assert_allclose(last[-1], live.light[:, : live.terms[-1].order ** 2], atol=1e-9)
    np.testing.assert_allclose(last[:-1], 0.0, atol=1e-6 * np.abs(live.light).max())


def test_errors_are_the_most_noise_over_the_least_light() -> None:
    """The error at no albedo of the range is above that which decides when a texel is final."""
    live = orbital(0.3, **EXACT)
    texels = surface_texels(live, 100)
    judged = relative_error(climbed(live, texels, PATHS), live)
    for albedo in (0.9, 0.5, 0.1):
        spec = of_one_albedo(albedo, live)
        assert (relative_error(climbed(spec, texels, PATHS), spec) <= judged * (1.0 + 1e-6)).all()
