"""Analytic clear sky after Preetham, Shirley and Smits, "A Practical Analytic Model for Daylight", 1999.

Luminances are in kcd/m² as in the paper until the whole image is scaled.
"""

import math

import numpy as np

from isogi_core.model.lights import SkyLight

SUN_RADIUS = math.radians(0.2665)
SUN_ILLUMINANCE = 128.0
"""Of the sun outside the atmosphere, klx."""

LUMINANCE_WEIGHTS = np.array([0.2126, 0.7152, 0.0722])
"""Weights of linear sRGB in luminance (ITU-R BT.709)."""

_XYZ_TO_RGB = np.array(
    [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]
)  # IEC 61966-2-1

# Rows are A to E of Perez's distribution, columns the weights of (turbidity, 1); the paper's appendix A.2.
_PEREZ_LUMINANCE = np.array(
    [[0.17872, -1.46303], [-0.35540, 0.42749], [-0.02266, 5.32505], [0.12064, -2.57705], [-0.06696, 0.37027]]
)
_PEREZ_X = np.array(
    [
        [-0.01925, -0.25922],
        [-0.06651, 0.00081],
        [-0.00041, 0.21247],
        [-0.06409, -0.89887],
        [-0.00325, 0.04517],
    ]
)
_PEREZ_Y = np.array(
    [
        [-0.01669, -0.26078],
        [-0.09495, 0.00921],
        [-0.00792, 0.21023],
        [-0.04405, -1.65369],
        [-0.01092, 0.05291],
    ]
)
# Zenith chromaticity: rows are powers 2, 1, 0 of turbidity, columns powers 3 to 0 of the sun's zenith angle.
_ZENITH_X = np.array(
    [
        [0.00166, -0.00375, 0.00209, 0.0],
        [-0.02903, 0.06377, -0.03202, 0.00394],
        [0.11693, -0.21196, 0.06052, 0.25886],
    ]
)
_ZENITH_Y = np.array(
    [
        [0.00275, -0.00610, 0.00317, 0.0],
        [-0.04214, 0.08970, -0.04153, 0.00516],
        [0.15346, -0.26756, 0.06670, 0.26688],
    ]
)
_WAVELENGTHS = np.array([0.610, 0.550, 0.465])
"""Micrometres that stand for red, green and blue where the sun's beam is weakened."""


def sky_image(light: SkyLight, directions: np.ndarray, solid_angles: np.ndarray) -> np.ndarray:
    """Radiance (h, w, 3) float64 of sky, sun and ground in unit ``directions`` (h, w, 3), z up.

    ``solid_angles`` (h, w), steradians, say what each direction stands for. The directions of the sun's disc
    together hold exactly its irradiance; the ground reflects what sky and sun send down on it; the mean
    luminance over the sphere is ``light.scale``.
    """
    up = directions[..., 2] > 0.0
    sky = np.zeros(directions.shape)
    sky[up] = _sky_radiance(light, directions[up])
    sky[up] += _sun_disc(light, directions[up], solid_angles[up])
    falling = (directions[..., 2] * solid_angles)[up] @ sky[up]
    sky[~up] = np.multiply(light.ground, falling / np.pi)
    mean = np.sum(solid_angles * (sky @ LUMINANCE_WEIGHTS)) / np.sum(solid_angles)
    return np.asarray(sky * (light.scale / mean))


def sun_direction(light: SkyLight) -> np.ndarray:
    """Unit vector (3,) towards the sun."""
    azimuth, elevation = math.radians(light.sun_azimuth), math.radians(light.sun_elevation)
    level = math.cos(elevation)
    return np.array([level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)])


def _sky_radiance(light: SkyLight, directions: np.ndarray) -> np.ndarray:
    """Linear RGB (n, 3), kcd/m², of the sky without the sun, in ``directions`` (n, 3) above the horizon."""
    turbidity, theta = light.turbidity, math.radians(90.0 - light.sun_elevation)
    cos_gamma = np.clip(directions @ sun_direction(light), -1.0, 1.0)
    chi = (4.0 / 9.0 - turbidity / 120.0) * (math.pi - 2.0 * theta)
    zenith = (4.0453 * turbidity - 4.9710) * math.tan(chi) - 0.2155 * turbidity + 2.4192
    parts = (
        (zenith, _PEREZ_LUMINANCE),
        (_chromaticity(_ZENITH_X, turbidity, theta), _PEREZ_X),
        (_chromaticity(_ZENITH_Y, turbidity, theta), _PEREZ_Y),
    )
    luminance, x, y = (
        at_zenith
        * _perez(table, turbidity, directions[:, 2], cos_gamma)
        / _perez(table, turbidity, np.array(1.0), np.array(math.cos(theta)))
        for at_zenith, table in parts
    )
    xyz = np.stack([x / y, np.ones_like(y), (1.0 - x - y) / y], axis=-1) * luminance[:, None]
    return np.asarray(np.maximum(xyz @ _XYZ_TO_RGB.T, 0.0))


def _chromaticity(table: np.ndarray, turbidity: float, theta: float) -> float:
    """CIE x or y of the zenith, for the sun at zenith angle ``theta``."""
    return float(np.array([turbidity**2, turbidity, 1.0]) @ table @ np.array([theta**3, theta**2, theta, 1.0]))


def _perez(table: np.ndarray, turbidity: float, cos_theta: np.ndarray, cos_gamma: np.ndarray) -> np.ndarray:
    """Perez's distribution at zenith angle θ and angle γ from the sun: eq. 3 of the paper."""
    a, b, c, d, e = table @ np.array([turbidity, 1.0])
    gradation = 1.0 + a * np.exp(b / cos_theta)
    return np.asarray(gradation * (1.0 + c * np.exp(d * np.arccos(cos_gamma)) + e * cos_gamma**2))


def _sun_disc(light: SkyLight, directions: np.ndarray, solid_angles: np.ndarray) -> np.ndarray:
    """Radiance (n, 3) of the sun, spread evenly over the directions within its disc, or the nearest ones.

    The beam is weakened by Rayleigh and aerosol scattering over the relative optical mass of the air (the
    paper's appendix A.1; ozone, gases and water vapour weaken it little and are left out).
    """
    zenith = 90.0 - light.sun_elevation
    mass = 1.0 / (math.cos(math.radians(zenith)) + 0.15 * (93.885 - zenith) ** -1.253)
    beta = 0.04608 * light.turbidity - 0.04586
    depth = 0.008735 * _WAVELENGTHS**-4.08 + beta * _WAVELENGTHS**-1.3
    irradiance = SUN_ILLUMINANCE * np.exp(-mass * depth)
    away = np.linalg.norm(directions - sun_direction(light), axis=-1)
    disc = away <= max(SUN_RADIUS, 1.5 * float(away.min()))
    return np.where(disc[:, None], irradiance / np.sum(solid_angles[disc]), 0.0)
