"""Light that is kept for several albedos, against bakes of one albedo and against light bounce by bounce."""

from dataclasses import replace

import numpy as np
import pytest

from isogi_core.bake.bake_spec import BakeSpec
from isogi_core.bake.noise import relative_error
from isogi_core.bake.refine import locate, sample_transfer
from isogi_core.model.scene_plan import Layer
from isogi_core.plan.budget import MIXING
from tests.bake.texels import climbed, orbital, surface_texels

PATHS = 64
EXACT = {"precision": "single", "albedos": (0.0, 0.9)}


@pytest.fixture(scope="module")
def live() -> BakeSpec:
    """The orbital under a sky at albedo 0.3, of which views may ask for up to 0.9; three bounces, single floats."""
    return orbital(0.3, **EXACT)


def test_each_node_is_the_bake_of_its_albedo(live: BakeSpec) -> None:
    texels = surface_texels(live, 30)
    direct, indirect = climbed(live, texels, PATHS).parts
    for channel, node in enumerate(live.plan.nodes):
        fixed = orbital(node, precision="single")
        layers = tuple(
            replace(layer, order=own.order) for layer, own in zip(fixed.plan.layers, live.plan.layers, strict=True)
        )
        plan = replace(fixed.plan, layers=layers, survival=live.plan.survival)
        alone = climbed(BakeSpec(fixed.prepared, plan), texels, PATHS).parts
        assert np.array_equal(alone[0].coefficients, direct.coefficients)
        assert np.array_equal(alone[1].coefficients[:, 0], indirect.coefficients[:, channel])


def test_light_of_any_albedo_is_that_of_its_bounces() -> None:
    """Σ R^k τ_k, of the same paths: mixed light comes to it within its share of the target error."""
    live = orbital(0.3, sky=False, **EXACT)
    texels = surface_texels(live, 200)
    place, void = locate(texels, live.prepared)
    direct, indirect = live.plan.layers
    halves = [sums for sums, _ in sample_transfer((direct, indirect), place, void, live, 0, PATHS)]
    straight, kept = (each.sum(axis=1)[~void, :, 0] / PATHS for each in halves)
    alone = [Layer("indirect", channels=1, nodes=(node,)) for node in (0.2, 0.45, 0.8)]
    for layer, (sums, _) in zip(alone, sample_transfer(alone, place, void, live, 0, PATHS), strict=True):
        true = sums.sum(axis=1)[~void, 0, 0] / PATHS
        mixed = kept @ live.of_albedo((layer.nodes[0], 0.5, 0.1)).mixing[0]
        error = np.sqrt(((mixed - true) ** 2).mean()) / (straight[:, 0] + true).mean()
        assert 0.0 < error <= MIXING * live.prepared.scene.target_error


def test_three_bounces_and_three_nodes_leave_no_error() -> None:
    """As many nodes as bounces: light is a polynomial of the albedo, and what is mixed of it the same."""
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
    assert live.of_albedo(live.albedo) is live and live.of_albedo((0.3,) * 3) is live.of_albedo((0.3,) * 3)


def test_terms_are_the_light_times_what_each_node_counts(live: BakeSpec) -> None:
    seen = live.of_albedo((0.9, 0.5, 0.1))
    direct, *nodes = seen.terms
    assert direct.node is None and [term.node for term in nodes] == list(range(len(live.plan.nodes)))
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
        fixed = orbital(albedo, precision="single")
        layers = tuple(
            replace(layer, order=own.order) for layer, own in zip(fixed.plan.layers, live.plan.layers, strict=True)
        )
        plan = replace(fixed.plan, layers=layers, survival=live.plan.survival)
        spec = BakeSpec(fixed.prepared, plan)
        assert (relative_error(climbed(spec, texels, PATHS), spec) <= judged * (1.0 + 1e-6)).all()
