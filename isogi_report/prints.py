"""Pictures of a report as PNG: radiance through the film's tone curve, errors in colours that part at nothing."""

import io
import math
from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from PIL import Image

from isogi_core.frame.film import BACKGROUND, tone_table
from isogi_core.kernels.shading.framebuffer import develop_rows
from isogi_report.journal import Report
from isogi_report.sections import Picture

COLOURS = "RdBu_r"
"""matplotlib's name of the colours of errors: blue too dark, white right, red too bright."""

SCALE_STEPS = (1.0, 2.0, 5.0, 10.0)
"""First digits of an error map's scale."""

SCALE_PERCENTILE = 99.0
"""Percentile of the absolute errors that the scale of their maps reaches."""

MIN_SCALE_SHARE = 0.1
"""Part of a section's scale that a map on it reaches at least."""


def scales_of(pictures: Sequence[Picture]) -> tuple[float | None, ...]:
    """The error at the ends of each map's colours; None for what is no map of errors.

    It is round, the same for all maps of a section, and at least what SCALE_PERCENTILE percent of their pixels stay
    below. A map in which that is less than a MIN_SCALE_SHARE part of it has another scale.
    """
    maps = [each.pixels[np.isfinite(each.pixels)] if each.kind == "error" else None for each in pictures]
    common = round_up(most_of(np.concatenate([np.empty(0), *(errors for errors in maps if errors is not None)])))
    return tuple(None if errors is None else own_scale(most_of(errors), common) for errors in maps)


def own_scale(most: float, common: float) -> float:
    """The scale of a map whose errors reach ``most``, in a section whose scale is the ``common`` one."""
    return round_up(most) if 0.0 < most < MIN_SCALE_SHARE * common else common


def most_of(errors: np.ndarray) -> float:
    """What SCALE_PERCENTILE percent of errors stay below."""
    return float(np.percentile(np.abs(errors), SCALE_PERCENTILE)) if errors.size else 0.0


def round_up(error: float) -> float:
    """The next of one, two or five times a power of ten; a hundredth for nothing."""
    if error <= 0.0:
        return 0.01
    power = 10.0 ** math.floor(math.log10(error))
    return next(step * power for step in SCALE_STEPS if step * power >= error * (1.0 - 1e-9))


def print_picture(picture: Picture, report: Report, scale: float | None) -> bytes:
    """The picture's PNG; ``scale`` is the error at the ends of an error map's colours."""
    shown = develop(picture.pixels, report) if scale is None else error_colours(picture.pixels, scale)
    file = io.BytesIO()
    Image.fromarray(shown).save(file, "png", optimize=True)
    return file.getvalue()


def develop(pixels: np.ndarray, report: Report) -> np.ndarray:
    """Radiance as (h, w, 3) uint8 sRGB, by the curve that frames have."""
    radiance, on = np.ascontiguousarray(pixels, np.float32), report.on.astype(np.uint8)
    shown, colours = np.empty(radiance.shape, np.uint8), np.array([BACKGROUND] * 2, np.float32)
    develop_rows(radiance, on, 0, report.exposure, colours, False, tone_table(), shown)
    return shown


def error_colours(errors: np.ndarray, scale: float) -> np.ndarray:
    """Signed errors as (h, w, 3) uint8 sRGB, ±``scale`` at the ends, the film's background where there are none."""
    on = np.isfinite(errors)
    places = np.where(on, 0.5 + 0.5 * np.clip(np.nan_to_num(errors) / scale, -1.0, 1.0), 0.5)
    shown = mpl.colormaps[COLOURS](places, bytes=True)[..., :3]
    top = len(tone_table()) - 1
    shown[~on] = tone_table()[np.rint(np.array(BACKGROUND) * top).astype(int)]
    return np.ascontiguousarray(shown)


def gradient(steps: int = 11) -> str:
    """The colours of errors as a CSS gradient, from too dark to too bright."""
    colours = mpl.colormaps[COLOURS](np.linspace(0.0, 1.0, steps), bytes=True)[:, :3]
    return f"linear-gradient(to right, {', '.join('#' + bytes(colour).hex() for colour in colours)})"
