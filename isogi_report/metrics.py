"""Scores: the distance of a picture from its reference, corrected for the reference's noise."""

import importlib
import math
from dataclasses import dataclass

import numpy as np

from isogi_core.frame.film import BACKGROUND, HATCHING_COLOUR, tone_table
from isogi_core.kernels.shading.framebuffer import develop_rows
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.reference import Reference
from isogi_report.sections import Cell, Column

WORST_PERCENTILE = 99.0
"""Percentile of errors that stands for the worst pixels,
as the single worst pixel would depend on chance.
"""


SCORE_COLUMNS = (
    Column("relative RMSE", "share"),
    Column("99th percentile", "share"),
    Column("bias", "share"),
    Column("FLIP", "number"),
)
"""The columns of a score."""


@dataclass(frozen=True)
class Spread:
    """Errors of pixels relative to the reference's mean: the root mean square without known noise,
    and the signed mean.

    99 % of the errors stay below ``p99``, noise included.
    """

    rmse: float
    bias: float
    p99: float


@dataclass(frozen=True)
class Score:
    """Errors of a picture's luminance over surface pixels, relative to the reference's mean
    luminance.

    - ``rmse``: root mean square, without the reference's noise.
    - ``p99``: 99 % of the pixels stay below it; ``bias``: signed mean; both include the noise.
    - ``noise``: relative error of the reference.
    - ``flip``: mean of FLIP over surface pixels, 0 … 1, of both pictures as a screen shows them;
      None if FLIP is not installed.

    Source of FLIP: Andersson et al., Proceedings of the ACM in Computer Graphics 3(2), 2020.
    """

    rmse: float
    p99: float
    bias: float
    noise: float
    flip: float | None


def score(radiance: np.ndarray, best: Reference, exposure: float) -> Score:
    """Return the score of a picture, ``radiance`` (h, w, 3) linear RGB,
    that shows the same surface as the reference ``best``.
    """
    light = luminance_of(best.mean[best.on])
    wrong = luminance_of(radiance[best.on]) - light
    mean = mean_of(light)
    # The reference's own noise is in the differences: ``spread_of`` takes it off.
    noise = best.variance[best.on].astype(np.float64)
    spread = spread_of(wrong, noise, mean)
    return Score(
        rmse=spread.rmse,
        p99=spread.p99,
        bias=spread.bias,
        noise=math.sqrt(noise.mean()) / mean if len(noise) else 0.0,
        flip=flip(radiance, best, exposure),
    )


def spread_of(wrong: np.ndarray, noise: np.ndarray | float, mean: float) -> Spread:
    """Return the spread of pixels' errors ``wrong`` (m,) around 0, relative to ``mean``.

    ``noise`` (m,) is the variance in them that is not part of the error; it is subtracted from the
    mean square.
    """
    if not len(wrong):
        return Spread(0.0, 0.0, 0.0)
    # Noise and error are independent, so their mean squares add up.
    square = max(float((wrong**2).mean()) - float(np.mean(noise)), 0.0)
    return Spread(
        math.sqrt(square) / mean,
        float(wrong.mean()) / mean,
        float(np.percentile(np.abs(wrong), WORST_PERCENTILE)) / mean,
    )


def luminance_of(radiance: np.ndarray) -> np.ndarray:
    """Return the luminance (…) float64 of linear RGB (…, 3)."""
    return np.asarray(radiance.astype(np.float64) @ LUMINANCE_WEIGHTS)


def mean_of(light: np.ndarray) -> float:
    """Return the mean luminance that errors are relative to:
    tiny if all is black, 1 without pixels.
    """
    if len(light):
        return max(float(light.mean()), 1e-30)
    return 1.0


def error_map(radiance: np.ndarray, best: Reference) -> np.ndarray:
    """Return signed errors of the luminance relative to the reference's mean;
    (h, w) float32, NaN off the surface.
    """
    light = luminance_of(best.mean[best.on])
    return map_of(luminance_of(radiance[best.on]) - light, best.on, mean_of(light))


def map_of(wrong: np.ndarray, on: np.ndarray, mean: float) -> np.ndarray:
    """Return errors ``wrong`` (m,) of the pixels in the mask ``on`` (h, w),
    relative to ``mean``, as a picture; (h, w) float32, NaN elsewhere.
    """
    errors = np.full(on.shape, np.nan, np.float32)
    errors[on] = wrong / mean
    return errors


def flip(radiance: np.ndarray, best: Reference, exposure: float) -> float | None:
    """Return the mean of FLIP over surface pixels, between the reference ``best`` and the picture
    ``radiance`` (h, w, 3), both through the film's tone curve at this ``exposure``. Return None if
    FLIP is not installed, 0 without surface pixels.
    """
    # FLIP is not among isogi's requirements.
    try:
        evaluator = importlib.import_module("flip_evaluator")
    except ImportError:
        return None
    shown = [
        shown_as(each, best.on, exposure).astype(np.float32) / 255.0
        for each in (best.mean, radiance)
    ]
    errors, _, _ = evaluator.evaluate(*shown, "LDR", applyMagma=False, computeMeanError=False)
    # Leave the background out of the mean: it is the same in both pictures.
    surface_errors = np.asarray(errors)[..., 0][best.on]
    return float(surface_errors.mean()) if len(surface_errors) else 0.0


def shown_as(radiance: np.ndarray, on: np.ndarray, exposure: float) -> np.ndarray:
    """Return the picture as a screen shows it, by the tone curve of frames;
    ``on`` (h, w) is the mask of the surface; sRGB (h, w, 3) uint8.
    """
    picture = np.empty(radiance.shape, np.uint8)
    colours = np.array([BACKGROUND, HATCHING_COLOUR], np.float32)
    light = np.ascontiguousarray(radiance, np.float32)
    # Use the kernel of frames, so that colours are exactly theirs.
    develop_rows(
        light,
        np.ascontiguousarray(on, np.uint8),
        0,
        exposure,
        colours,
        False,
        tone_table(),
        picture,
    )
    return picture


def score_cells(score: Score) -> tuple[Cell, ...]:
    """Return the cells of a score under SCORE_COLUMNS."""
    return score.rmse, score.p99, score.bias, score.flip
