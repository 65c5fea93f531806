"""Bands of light: projection against exact quadrature, and predicted truncation errors against
brute force.
"""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from isogi_core.bake.bake_spec import spec_for
from isogi_core.bake.refine import locate, sample_transfer
from isogi_core.kernels.transport.harmonics import MAX_ORDER, cosine_lobe_factors, rotate
from isogi_core.model.environment import LUMINANCE_WEIGHTS, pixel_directions
from isogi_core.model.lights import ConstantLight, ProbeLight, SkyLight
from isogi_core.plan.bands import (
    Kind,
    band_energy,
    choose_order,
    project_environment,
    project_image,
    truncation_error,
)
from isogi_core.plan.lighting import assemble_environment
from isogi_core.prepared.prepared_scene import PreparedScene
from tests.bake.texels import SKY, surface_texels
from tests.kernels.transport.harmonic_bases import basis, quadrature, rotation_matrix
from tests.loaded import load_scene
from tests.scale import COMPILED

COUNT = MAX_ORDER * MAX_ORDER
WHITE = math.sqrt(4.0 * math.pi)


def project(image: np.ndarray, order: int = MAX_ORDER) -> np.ndarray:
    """Coefficients (3, order²) of an image of float32, as environments keep it."""
    return project_image(np.asarray(image, np.float32), order)


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (5, 1), (16, 32), (33, 65)])
def test_a_constant_is_one_number(shape: tuple[int, int]) -> None:
    radiance = np.array([1.0, 0.5, 1e6])
    expected = np.outer(radiance, np.eye(COUNT)[0]) * WHITE
    np.testing.assert_allclose(
        project(np.broadcast_to(radiance, (*shape, 3))), expected, rtol=1e-13, atol=1e-8
    )
    np.testing.assert_allclose(project(np.ones((*shape, 3)))[0], expected[0], rtol=0, atol=2e-14)


@pytest.mark.parametrize("shape", [(1, 1), (1, 3), (4, 1), (3, 5)])
def test_projection_is_the_integral_of_the_pixels(shape: tuple[int, int]) -> None:
    """Against Gauss quadrature of Y_i within every pixel, one by one."""
    height, width = shape
    image = np.random.default_rng(8).random((*shape, 3)).astype(np.float32)
    nodes, weights = np.polynomial.legendre.leggauss(40)
    expected = np.zeros((3, COUNT))
    for i, j in np.ndindex(shape):
        theta = math.pi * (i + (nodes[:, None] + 1.0) / 2.0) / height + 0.0 * nodes
        phi = 2.0 * math.pi * (j + (nodes + 1.0) / 2.0) / width + 0.0 * nodes[:, None]
        sine = np.sin(theta)
        directions = np.stack([sine * np.cos(phi), sine * np.sin(phi), np.cos(theta)], axis=-1)
        area = (
            np.outer(weights, weights) / 4.0 * sine * (math.pi / height) * (2.0 * math.pi / width)
        )
        integral = area.ravel() @ basis(MAX_ORDER, directions.reshape(-1, 3))
        expected += image[i, j].astype(float)[:, None] * integral
    np.testing.assert_allclose(project(image), expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize("order", range(1, MAX_ORDER + 1))
def test_a_lower_order_is_the_beginning_of_a_higher(order: int) -> None:
    image = np.random.default_rng(11).random((6, 9, 3))
    np.testing.assert_allclose(
        project(image, order), project(image)[:, : order**2], rtol=0, atol=1e-14
    )


def test_projection_finds_the_coefficients_of_an_image() -> None:
    """A band-limited image comes back, up to the pixels' size, channel by channel."""
    coefficients = np.random.default_rng(9).normal(size=(3, 25))
    image = basis(5, pixel_directions(128, 256).reshape(-1, 3)) @ coefficients.T
    np.testing.assert_allclose(
        project(image.reshape(128, 256, 3), 5), coefficients, rtol=0, atol=2e-3
    )


@pytest.mark.parametrize("axis", [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (0.6, -0.64, 0.48)])
def test_projection_of_a_cosine_lobe(axis: tuple[float, float, float]) -> None:
    """max(ω·n, 0) has the coefficients A_l Y_lm(n)."""
    lobe = np.maximum(pixel_directions(128, 256) @ np.array(axis), 0.0)
    degrees = np.repeat(np.arange(5), 2 * np.arange(5) + 1)
    expected = cosine_lobe_factors(5)[degrees] * basis(5, np.array([axis]))[0]
    np.testing.assert_allclose(
        project(lobe[..., None].repeat(3, axis=2), 5)[1], expected, rtol=0, atol=1e-3
    )


def test_projection_of_one_pixel_of_a_million() -> None:
    """A filament in the dark: every coefficient is its energy times Y_i, and dark pixels add
    nothing.
    """
    image = np.zeros((64, 128, 3))
    image[20, 90] = 1e6
    edges = np.cos(np.array([20, 21]) * math.pi / 64)
    energy = 1e6 * (edges[0] - edges[1]) * 2.0 * math.pi / 128
    direction = pixel_directions(64, 128)[20, 90]
    np.testing.assert_allclose(
        project(image, 3)[2], energy * basis(3, direction[None])[0], rtol=5e-3
    )


def test_projection_and_rotation_agree() -> None:
    """Turning an image by whole columns is turning its coefficients about z."""
    image = np.random.default_rng(10).random((8, 16, 3))
    turn = Rotation.from_rotvec([0.0, 0.0, 3 * 2.0 * math.pi / 16]).as_matrix()
    turned = project(image) @ rotation_matrix(turn).T
    np.testing.assert_allclose(project(np.roll(image, 3, axis=1)), turned, rtol=0, atol=1e-13)


def test_an_environment_is_its_constant_and_its_image() -> None:
    light = assemble_environment([ConstantLight((1.0, 2.0, 3.0)), SkyLight()])
    expected = project_image(light.image, 4)
    expected[:, 0] += WHITE * np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(project_environment(light, 4), expected, rtol=1e-14)
    np.testing.assert_allclose(
        project_environment(light, 1)[:, 0], WHITE * light.mean(), rtol=1e-12
    )


# --- truncation
# --------------------------------------------------------------------------------------------------


KINDS: list[Kind] = ["direct", "indirect"]
BANDS = np.arange(MAX_ORDER)
SOFT = (2 * BANDS + 1) * (BANDS + 0.5) ** -3.0
SUN = 2.0 * BANDS + 1.0


def random_light(seed: int, order: int = MAX_ORDER) -> np.ndarray:
    """Coefficients (3, order²) of a coloured light with a mean of its own."""
    light = np.random.default_rng(seed).normal(size=(3, order**2))
    light[:, 0] = 5.0
    return light


def turned(light: np.ndarray, count: int) -> np.ndarray:
    """Luminance of the light under so many random rotations; (count, n²)."""
    order = math.isqrt(light.shape[1])
    out = np.empty((count, *light.shape))
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
    light = random_light(3)
    out = np.empty((3, MAX_ORDER**2))
    rotate(MAX_ORDER, Rotation.random(rng=4).as_matrix(), light, out)
    np.testing.assert_allclose(band_energy(out), band_energy(light), rtol=1e-12)


def transferred(kind: Kind, band: int) -> float:
    """The share of a band's power that is expected in the transfer of a surface: what is lost with
    the band of a light that is constant but for it.
    """
    if band == 0:
        return 1.0
    light = 1.0 * (BANDS == 0) + (band == BANDS)
    return (
        truncation_error(light, band, kind) ** 2
        - truncation_error(light, min(band + 1, MAX_ORDER), kind) ** 2
    )


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("order", [1, 2, 4])
def test_truncation_error_matches_turned_lights_on_a_surface(kind: Kind, order: int) -> None:
    """Texels with the power in every band that the plan expects, in random directions: the mean
    transfer is 1 there.
    """
    tau = np.random.default_rng(5).normal(size=(300, MAX_ORDER**2))
    for l in BANDS:
        own = tau[:, l * l : (l + 1) ** 2]
        own *= np.sqrt(transferred(kind, l) * (2 * l + 1) / (4.0 * math.pi)) / np.linalg.norm(
            own, axis=1, keepdims=True
        )
    light = random_light(6)
    light[:, 49:] = 0.0  # nothing to be extrapolated
    lost = tau[:, order**2 :] @ turned(light, 300)[:, order**2 :].T
    mean = (LUMINANCE_WEIGHTS @ light)[0] / math.sqrt(4.0 * math.pi)
    assert truncation_error(band_energy(light), order, kind) == pytest.approx(
        math.sqrt((lost**2).mean()) / mean, rel=0.03
    )


@pytest.mark.parametrize(("kind", "decay"), [("direct", 3.0), ("indirect", 4.0)])
@pytest.mark.parametrize("slope", [0.0, -1.0, -2.5])
def test_bands_beyond_the_last_are_summed(kind: Kind, decay: float, slope: float) -> None:
    """The transfer of edges of shadows falls about as l^-3 from band to band, and that of light
    which a surface has reflected as l^-4.
    """
    l = np.arange(1_000_000) + 0.5
    energy = 2.0 * l ** (1.0 + slope)
    transfer = transferred(kind, MAX_ORDER - 1) * (l / (MAX_ORDER - 0.5)) ** -decay
    expected = math.sqrt((energy * transfer)[MAX_ORDER:].sum() / energy[0])
    assert truncation_error(energy[:MAX_ORDER], MAX_ORDER, kind) == pytest.approx(
        expected, rel=0.15
    )


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("energy", [SOFT, SUN], ids=["soft", "sun"])
def test_more_bands_never_err_more(kind: Kind, energy: np.ndarray) -> None:
    errors = [truncation_error(energy, order, kind) for order in range(1, MAX_ORDER + 1)]
    assert errors == sorted(errors, reverse=True) and errors[-1] > 0.0


def test_only_indirect_light_asks_for_the_albedo() -> None:
    assert truncation_error(SOFT, 3, "indirect", 0.35) == pytest.approx(
        truncation_error(SOFT, 3, "indirect") / 2
    )
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
    ("probe", "orders"),
    [("uffizi_256x128", (2, 3)), ("grace_256x128", (3, 4)), ("noon_grass_1024x512", (3, 5))],
)
@pytest.mark.data
def test_orders_of_indirect_light_under_real_probes(
    shared_data: Path, probe: str, orders: tuple[int, int]
) -> None:
    """At 5 % and at 2 % of all light."""
    light = assemble_environment([ProbeLight(shared_data / f"probe_{probe}.hdr")])
    energy = band_energy(project_environment(light, MAX_ORDER))
    assert tuple(choose_order(energy, target, "indirect")[0] for target in (0.05, 0.02)) == orders


@COMPILED
@pytest.mark.parametrize("order", [1, 2, 3])
def test_the_error_is_that_of_a_baked_surface(order: int) -> None:
    """Within 1.4 on a demo, texels counted by how much of them views see; the randomisations part
    the noise.
    """
    spec = spec_for(
        PreparedScene(load_scene("demo:casting", lights=[SKY], order=MAX_ORDER, bounces=0)), "gi"
    )
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
