"""Lobes: small bright parts of an environment that pixels light by shadow rays. They are found,
chosen, and taken out of the harmonics here.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from isogi_core.kernels.transport.harmonics import MAX_ORDER
from isogi_core.model.environment import LUMINANCE_WEIGHTS, Environment, Lobe, solid_angles
from isogi_core.plan.bands import (
    FAR_BANDS,
    FAR_BANDS_ERROR,
    band_energy,
    evaluate_harmonics,
    truncation_error,
)

FEW_LOBES_SEARCHED = 4
MANY_LOBES_SEARCHED = 64
"""Most lobes that are searched for in any environment, and in one whose harmonics are still too
sharp without the first few.
"""

JUDGED_ORDER = 6
"""Order of the harmonics whose error the lobes are to reduce."""

MAX_GAIN_SHARE = 0.9
"""The search ends if lobes no longer reduce the error to less than this share of its former
value.
"""

LOBES_TOGETHER = 8
"""Number of lobes that must reduce the error together if many are searched for: of sixty lamps
each alone changes almost nothing.
"""

LOBE_ERROR = 0.004
"""Relative error below which no more lobes are taken."""

GAUSS_NODES, GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(MAX_ORDER)


def find_lobes(environment: Environment, light: np.ndarray, target: float) -> tuple[Lobe, ...]:
    """Find the lobes of an ``environment`` whose coefficients are ``light`` (3, MAX_ORDER²),
    brightest first.

    If FEW_LOBES_SEARCHED lobes bring the error of harmonics of order FAR_BANDS below the
    ``target``, or below FAR_BANDS_ERROR, these are returned. Light with more lamps, such as a
    street at night, gets up to MANY_LOBES_SEARCHED.
    """
    few = search(environment, light, FEW_LOBES_SEARCHED, 1)
    if error_beside(light, few, FAR_BANDS) <= max(target, FAR_BANDS_ERROR):
        return few
    return search(environment, light, MANY_LOBES_SEARCHED, LOBES_TOGETHER)


def search(
    environment: Environment, light: np.ndarray, most: int, patience: int
) -> tuple[Lobe, ...]:
    """Take up to ``most`` lobes out of an environment.

    The search ends when the error at JUDGED_ORDER is below LOBE_ERROR, or when the last
    ``patience`` lobes hardly reduced it; these are then put back.
    """
    lobes: list[Lobe] = []
    radiance = environment.image.astype(np.float64)
    errors = [error_beside(light, ())]
    while len(lobes) < most and errors[-1] > LOBE_ERROR:
        # Try each outline of the brightest peak as a lobe, and take the one that leaves the least
        # error.
        found = {error_beside(light, (*lobes, each.lobe)): each for each in outlines(radiance)}
        if not found:
            break
        errors.append(min(found))
        lobes.append(found[errors[-1]].lobe)
        # Flatten the peak, so that the next round finds the next one.
        found[errors[-1]].clear(radiance)
        # Stop if the last lobes hardly helped.
        if len(lobes) >= patience and errors[-1] > MAX_GAIN_SHARE * errors[-1 - patience]:
            return tuple(lobes[:-patience])
    return tuple(lobes)


def error_beside(light: np.ndarray, lobes: Sequence[Lobe], order: int = JUDGED_ORDER) -> float:
    """Return the relative error of harmonics of an ``order`` for a ``light`` (3, MAX_ORDER²)
    without its ``lobes``.
    """
    return truncation_error(energy_beside(light, lobes), order, "direct")


def energy_beside(light: np.ndarray, lobes: Sequence[Lobe]) -> np.ndarray:
    """Return the mean square luminance of each band of a ``light`` (3, n²) without its ``lobes``;
    (n,) float64.

    Band 0 is that of all the light, as errors are relative to it.
    """
    energy = band_energy(light - project_lobes(lobes, math.isqrt(light.shape[1])))
    energy[0] = band_energy(light[:, :1])[0]
    return energy


def project_lobes(lobes: Sequence[Lobe], order: int) -> np.ndarray:
    """Project lobes, discs of even radiance, to SH coefficients: Φ Y_i(d) times the mean of P_l
    over the disc; (3, order²) float64.
    """
    coefficients = np.zeros((3, order**2))
    for lobe in lobes:
        x, y, z = lobe.towards
        theta = np.array([math.atan2(math.hypot(x, y), z)])
        phi = np.array([math.atan2(y, x)])
        bands = np.repeat(disc_means(lobe.cosine, order), 2 * np.arange(order) + 1)
        coefficients += np.outer(lobe.flux, bands * evaluate_harmonics(order, theta, phi)[:, 0])
    return coefficients


def disc_means(cosine: float, order: int) -> np.ndarray:
    """Return the means of the Legendre polynomials P_l, l < ``order``, over heights from ``cosine``
    to 1; (order,).

    They are 1 for a disc without size.
    """
    heights = cosine + (1.0 - cosine) * (GAUSS_NODES + 1.0) / 2.0
    return np.asarray(GAUSS_WEIGHTS / 2.0 @ np.polynomial.legendre.legvander(heights, order - 1))


EDGE_SHARES = (0.5, 0.25, 0.1, 0.05, 0.02, 0.01)
"""Shares of the peak's luminance that are tried as the edge of a lobe."""

MAX_SOLID_ANGLE = 0.1
"""Largest solid angle of a lobe in steradians, about 20° across: harmonics hold wider light
well.
"""

MIN_CONTRAST = 4.0
"""Least luminance of a lobe's peak, over the mean luminance."""

RIM_WIDTH = 2
"""Width in texels of the rim around a lobe in which the radiance of its surroundings is
measured.
"""


@dataclass(frozen=True, eq=False)
class Outline:
    """A candidate for a ``lobe``: the flat indices of the texels in its ``region``, and the
    radiance ``level`` (3,) around it.
    """

    lobe: Lobe
    region: np.ndarray
    level: np.ndarray

    def clear(self, radiance: np.ndarray) -> None:
        """Reduce a lat-long ``radiance`` (h, w, 3) in the region to at most ``level``, in place."""
        flat = radiance.reshape(-1, 3)
        flat[self.region] = np.minimum(flat[self.region], self.level)


def outlines(radiance: np.ndarray) -> Iterator[Outline]:
    """Yield outlines around the brightest texel of a lat-long ``radiance`` (h, w, 3) float64, one
    for each edge of EDGE_SHARES.

    Edges that give the same region give one outline. Nothing is yielded if the peak does not stand
    out from the mean.
    """
    # A peak that hardly exceeds the mean luminance is no lobe.
    seen = radiance @ LUMINANCE_WEIGHTS
    known = {0}
    angles = solid_angles(*seen.shape)
    peak = int(seen.argmax())
    if not seen.flat[peak] > MIN_CONTRAST * float((seen * angles).sum()) / (4.0 * math.pi):
        return
    # Try edges from half of the peak's luminance down, each with the connected region above it.
    for share in EDGE_SHARES:
        region = grow_lobe(seen > share * seen.flat[peak], peak, angles[:, 0])
        if len(region) not in known:
            known.add(len(region))
            level = surround(radiance, region)
            yield Outline(lobe_of(radiance, region, level), region, level)


def grow_lobe(mask: np.ndarray, seed: int, angles: np.ndarray) -> np.ndarray:
    """Return the ascending flat indices of the marked texels that are connected with ``seed``; none
    if they fill more than MAX_SOLID_ANGLE.

    ``mask`` (h, w) bool is a lat-long image whose columns close to a ring and whose rows continue
    beyond the poles; ``angles`` (h,) are the solid angles of a texel by row.
    """
    left = mask.ravel().copy()
    front = np.array([seed])
    found = []
    left[seed] = False
    filled = 0.0
    # Flood fill: each round adds the marked neighbours of the texels that the last round added.
    while len(front):
        found.append(front)
        filled += float(angles[front // mask.shape[1]].sum())
        if filled > MAX_SOLID_ANGLE:
            return np.zeros(0, np.int64)
        around = neighbours(front, mask.shape[0], mask.shape[1], 1)
        front = around[left[around]]
        left[front] = False
    return np.sort(np.concatenate(found))


def neighbours(places: np.ndarray, height: int, width: int, reach: int) -> np.ndarray:
    """Return the flat indices of all texels up to ``reach`` rows and columns from any of
    ``places``, each once.

    Texels lie in a lat-long image of ``height`` × ``width``.
    """
    steps = np.arange(-reach, reach + 1)
    rows = (places // width)[:, None, None] + steps[:, None]
    columns = (places % width)[:, None, None] + steps
    # A row beyond a pole is the row as far on the other side, half a turn around.
    beyond = (rows < 0) | (rows >= height)
    rows = np.clip(
        np.where(rows < 0, -1 - rows, np.where(rows >= height, 2 * height - 1 - rows, rows)),
        0,
        height - 1,
    )
    return np.unique(rows * width + (columns + np.where(beyond, width // 2, 0)) % width)


def surround(radiance: np.ndarray, region: np.ndarray) -> np.ndarray:
    """Return the mean radiance (3,) of the texels within RIM_WIDTH of the ``region``, outside
    of it.
    """
    height, width = radiance.shape[:2]
    rim = np.setdiff1d(neighbours(region, height, width, RIM_WIDTH), region, assume_unique=True)
    if not len(rim):
        return np.zeros(3)
    angles = solid_angles(height, width)[rim // width, 0]
    return np.asarray(angles @ radiance.reshape(-1, 3)[rim] / angles.sum())


def lobe_of(radiance: np.ndarray, region: np.ndarray, level: np.ndarray) -> Lobe:
    """Return the disc with the flux, direction and spread of the radiance above a ``level`` (3,) in
    a ``region``.

    The mean direction of a disc of half angle a has the length (1 + cos a)/2, which gives a.
    """
    moments = moments_of(region, *radiance.shape[:2])
    # Only light above the surroundings belongs to the lobe; its moments give flux and mean
    # direction.
    excess = np.maximum(radiance.reshape(-1, 3)[region] - level, 0.0)
    flux = moments[:, 3] @ excess
    vector = (excess @ LUMINANCE_WEIGHTS) @ moments[:, :3]
    length = float(np.linalg.norm(vector))
    cosine = min(2.0 * length / float(flux @ LUMINANCE_WEIGHTS) - 1.0, 1.0)
    x, y, z = (vector / length).tolist()
    r, g, b = flux.tolist()
    return Lobe((x, y, z), cosine, (r, g, b))


def moments_of(places: np.ndarray, height: int, width: int) -> np.ndarray:
    """Return ∫ ω dω and ∫ dω over texels of a lat-long image, in closed form; (m, 4) float64: x, y,
    z, steradians.

    ``places`` (m,) are flat indices of the texels.
    """
    theta = np.pi / height * (places // width + np.array([[0], [1]]))
    phi = 2.0 * np.pi / width * (places % width + np.array([[0], [1]]))
    # Each component is an integral over θ, of sin²θ or sinθ cosθ, times one over φ.
    up = np.diff(theta / 2.0 - np.sin(2.0 * theta) / 4.0, axis=0)
    x = up * np.diff(np.sin(phi), axis=0)
    y = -up * np.diff(np.cos(phi), axis=0)
    z = np.diff(np.sin(theta) ** 2, axis=0) / 2.0 * np.diff(phi, axis=0)
    whole = -np.diff(np.cos(theta), axis=0) * np.diff(phi, axis=0)
    return np.concatenate([x, y, z, whole]).T
