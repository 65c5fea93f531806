"""Projection of lat-long images against exact quadrature, closed forms and the rotation of harmonics."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from isogi_core.kernels.transport.harmonics import MAX_ORDER, cosine_lobe_factors
from isogi_core.model.environment import pixel_directions
from isogi_core.model.lights import ConstantLight, SkyLight
from isogi_core.plan.bands import project_environment, project_image
from isogi_core.plan.lighting import assemble_environment
from tests.kernels.transport.harmonic_bases import basis, rotation_matrix

COUNT = MAX_ORDER * MAX_ORDER
WHITE = math.sqrt(4.0 * math.pi)


def project(image: np.ndarray, order: int = MAX_ORDER) -> np.ndarray:
    """Coefficients (3, order²) of an image of float32, as environments keep it."""
    return project_image(np.asarray(image, np.float32), order)


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (5, 1), (16, 32), (33, 65)])
def test_a_constant_is_one_number(shape: tuple[int, int]) -> None:
    radiance = np.array([1.0, 0.5, 1e6])
    expected = np.outer(radiance, np.eye(COUNT)[0]) * WHITE
    np.testing.assert_allclose(project(np.broadcast_to(radiance, (*shape, 3))), expected, rtol=1e-13, atol=1e-8)
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
        area = np.outer(weights, weights) / 4.0 * sine * (math.pi / height) * (2.0 * math.pi / width)
        integral = area.ravel() @ basis(MAX_ORDER, directions.reshape(-1, 3))
        expected += image[i, j].astype(float)[:, None] * integral
    np.testing.assert_allclose(project(image), expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize("order", range(1, MAX_ORDER + 1))
def test_a_lower_order_is_the_beginning_of_a_higher(order: int) -> None:
    image = np.random.default_rng(11).random((6, 9, 3))
    np.testing.assert_allclose(project(image, order), project(image)[:, : order**2], rtol=0, atol=1e-14)


def test_projection_finds_the_coefficients_of_an_image() -> None:
    """A band-limited image comes back, up to the pixels' size, channel by channel."""
    coefficients = np.random.default_rng(9).normal(size=(3, 25))
    image = basis(5, pixel_directions(128, 256).reshape(-1, 3)) @ coefficients.T
    np.testing.assert_allclose(project(image.reshape(128, 256, 3), 5), coefficients, rtol=0, atol=2e-3)


@pytest.mark.parametrize("axis", [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (0.6, -0.64, 0.48)])
def test_projection_of_a_cosine_lobe(axis: tuple[float, float, float]) -> None:
    """max(ω·n, 0) has the coefficients A_l Y_lm(n)."""
    lobe = np.maximum(pixel_directions(128, 256) @ np.array(axis), 0.0)
    degrees = np.repeat(np.arange(5), 2 * np.arange(5) + 1)
    expected = cosine_lobe_factors(5)[degrees] * basis(5, np.array([axis]))[0]
    np.testing.assert_allclose(project(lobe[..., None].repeat(3, axis=2), 5)[1], expected, rtol=0, atol=1e-3)


def test_projection_of_one_pixel_of_a_million() -> None:
    """A filament in the dark: every coefficient is its energy times Y_i, and dark pixels add nothing."""
    image = np.zeros((64, 128, 3))
    image[20, 90] = 1e6
    edges = np.cos(np.array([20, 21]) * math.pi / 64)
    energy = 1e6 * (edges[0] - edges[1]) * 2.0 * math.pi / 128
    direction = pixel_directions(64, 128)[20, 90]
    np.testing.assert_allclose(project(image, 3)[2], energy * basis(3, direction[None])[0], rtol=5e-3)


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
    np.testing.assert_allclose(project_environment(light, 1)[:, 0], WHITE * light.mean(), rtol=1e-12)


def test_a_constant_environment_is_exact() -> None:
    light = assemble_environment([ConstantLight((1.0, 0.5, 0.1))])
    expected = np.outer([1.0, 0.5, 0.1], np.eye(9)[0]) * WHITE
    assert (project_environment(light, 3) == expected).all()
