"""Predicted truncation errors against brute force: turned lights, summed series, baked surfaces, real probes."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from isogi_core.bake.bake_spec import spec_for
from isogi_core.bake.refine import locate, sample_transfer
from isogi_core.kernels.transport.harmonics import MAX_ORDER, rotate
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.model.lights import ProbeLight
from isogi_core.plan.bands import (
    DECAY,
    TRANSFER_DIRECT,
    TRANSFER_INDIRECT,
    Kind,
    band_energy,
    choose_order,
    project_environment,
    truncation_error,
)
from isogi_core.plan.lighting import assemble_environment
from isogi_core.prepared.prepared_scene import PreparedScene
from tests.bake.texels import SKY, surface_texels
from tests.kernels.transport.harmonic_bases import basis, quadrature
from tests.loaded import load_scene
from tests.scale import COMPILED

KINDS: list[Kind] = ["direct", "indirect"]
BANDS = np.arange(MAX_ORDER)
TRANSFER = {"direct": TRANSFER_DIRECT, "indirect": TRANSFER_INDIRECT}
SOFT = (2 * BANDS + 1) * (BANDS + 0.5) ** -3.0
SUN = 2.0 * BANDS + 1.0


def random_light(seed: int, order: int = MAX_ORDER) -> np.ndarray:
    """Coefficients (3, order²) of a coloured light with a mean of its own."""
    light = np.random.default_rng(seed).normal(size=(3, order**2))
    light[:, 0] = 5.0
    return light


def turned(light: np.ndarray, count: int) -> np.ndarray:
    """Luminance of the light under so many random rotations; (count, n²)."""
    order, out = math.isqrt(light.shape[1]), np.empty((count, *light.shape))
    for matrix, place in zip(Rotation.random(count, rng=1).as_matrix(), out, strict=True):
        rotate(order, np.ascontiguousarray(matrix), light, place)
    return LUMINANCE_WEIGHTS @ out


def test_band_energies_are_mean_squares_over_the_sphere() -> None:
    light = random_light(2, 4)
    directions, weights = quadrature(4)
    table = basis(4, directions)
    for l, energy in enumerate(band_energy(light)):
        own = slice(l * l, (l + 1) ** 2)
        seen = table[:, own] @ (LUMINANCE_WEIGHTS @ light)[own]
        assert energy == pytest.approx(weights @ seen**2 / (4.0 * math.pi))


def test_band_energies_do_not_turn_with_the_light() -> None:
    light, out = random_light(3), np.empty((3, MAX_ORDER**2))
    rotate(MAX_ORDER, Rotation.random(rng=4).as_matrix(), light, out)
    np.testing.assert_allclose(band_energy(out), band_energy(light), rtol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("order", [1, 2, 4])
def test_truncation_error_matches_turned_lights_on_a_surface(kind: Kind, order: int) -> None:
    """Texels with the table's power in every band, in random directions: the mean transfer is 1 there."""
    tau = np.random.default_rng(5).normal(size=(300, MAX_ORDER**2))
    for l in BANDS:
        own = tau[:, l * l : (l + 1) ** 2]
        own *= np.sqrt(TRANSFER[kind][l] * (2 * l + 1) / (4.0 * math.pi)) / np.linalg.norm(own, axis=1, keepdims=True)
    light = random_light(6)
    light[:, 49:] = 0.0  # nothing to be extrapolated
    lost = tau[:, order**2 :] @ turned(light, 300)[:, order**2 :].T
    mean = (LUMINANCE_WEIGHTS @ light)[0] / math.sqrt(4.0 * math.pi)
    assert truncation_error(band_energy(light), order, kind) == pytest.approx(
        math.sqrt((lost**2).mean()) / mean, rel=0.03
    )


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("slope", [0.0, -1.0, -2.5])
def test_bands_beyond_the_last_are_summed_by_their_decay(kind: Kind, slope: float) -> None:
    l = np.arange(1_000_000) + 0.5
    energy = 2.0 * l ** (1.0 + slope)
    transfer = TRANSFER[kind][-1] * (l / (MAX_ORDER - 0.5)) ** -DECAY[kind]
    expected = math.sqrt((energy * transfer)[MAX_ORDER:].sum() / energy[0])
    assert truncation_error(energy[:MAX_ORDER], MAX_ORDER, kind) == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("energy", [SOFT, SUN], ids=["soft", "sun"])
def test_more_bands_never_err_more(kind: Kind, energy: np.ndarray) -> None:
    errors = [truncation_error(energy, order, kind) for order in range(1, MAX_ORDER + 1)]
    assert errors == sorted(errors, reverse=True) and errors[-1] > 0.0


def test_only_indirect_light_asks_for_the_albedo() -> None:
    assert truncation_error(SOFT, 3, "indirect", 0.35) == pytest.approx(truncation_error(SOFT, 3, "indirect") / 2)
    assert truncation_error(SOFT, 3, "direct", 0.35) == truncation_error(SOFT, 3, "direct")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("radiance", [0.0, 2.0])
def test_a_constant_light_needs_one_band_and_errs_by_nothing(kind: Kind, radiance: float) -> None:
    assert choose_order(radiance**2 * (BANDS == 0), 1e-4, kind) == (1, 0.0)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("target", [0.5, 0.1, 0.03, 0.01])
def test_the_least_order_within_the_target_is_chosen(kind: Kind, target: float) -> None:
    order, error = choose_order(SOFT, target, kind, most=MAX_ORDER)
    assert error == truncation_error(SOFT, order, kind) <= target
    assert order == 1 or truncation_error(SOFT, order - 1, kind) > target


def test_an_order_out_of_reach_is_the_most_and_says_its_error() -> None:
    assert choose_order(SUN, 0.01, "direct", most=3) == (3, truncation_error(SUN, 3, "direct"))
    assert choose_order(SUN, 0.01, "direct", most=1)[0] == 1


@pytest.mark.parametrize(
    ("probe", "orders"), [("uffizi_256x128", (2, 3)), ("grace_256x128", (3, 4)), ("noon_grass_1024x512", (3, 5))]
)
@pytest.mark.data
def test_orders_of_indirect_light_under_real_probes(shared_data: Path, probe: str, orders: tuple[int, int]) -> None:
    """At 5 % and at 2 % of all light."""
    light = assemble_environment([ProbeLight(shared_data / f"probe_{probe}.hdr")])
    energy = band_energy(project_environment(light, MAX_ORDER))
    assert tuple(choose_order(energy, target, "indirect")[0] for target in (0.05, 0.02)) == orders


@COMPILED
@pytest.mark.parametrize("order", [1, 2, 3])
def test_the_error_is_that_of_a_baked_surface(order: int) -> None:
    """Within 1.4 on a demo, texels counted by how much of them views see; the randomisations part the noise."""
    spec = spec_for(PreparedScene(load_scene("demo:casting", lights=[SKY], order=MAX_ORDER, bounces=0)), "gi")
    place, void = locate(surface_texels(spec, 150), spec.prepared)
    ((sums, _),) = sample_transfer(spec.plan.layers, place, void, spec, 0, 1024)
    one, other = np.moveaxis(sums[:, :, 0], 1, 0) / 512.0
    energy = band_energy(spec.light)
    level = (one + other)[:, 0] / 2.0
    seen = level / level.sum()
    each = np.repeat(energy / (2 * BANDS + 1), 2 * BANDS + 1)
    lost = seen @ (one * other)[:, order**2 :] @ each[order**2 :]
    measured = math.sqrt(lost / energy[0]) / float(seen @ level)
    assert 0.7 < truncation_error(energy, order, "direct") / measured < 1.4
