"""Pictures of a report as PNG: radiance through the film's tone curve, errors in colours that part at nothing."""

import io
import math
from collections.abc import Iterable

import matplotlib as mpl
import numpy as np
from PIL import Image

from isogi_core.frame.film import BACKGROUND, tone_table
from isogi_core.kernels.film import develop_rows
from isogi_core.report.sections import Picture

COLOURS = "RdBu_r"
"""matplotlib's name of the colours of errors: blue too dark, white right, red too bright."""

STEPS = (1.0, 2.0, 5.0, 10.0)
"""First digits of an error map's scale."""

MOST = 99.0
"""Percentile of the absolute errors that the scale of their maps reaches."""


def scale_of(pictures: Iterable[Picture]) -> float | None:
    """The error at the ends of the colours, the same for all maps of a section; None where it has none.

    One, two or five times a power of ten, and at least what MOST percent of the pixels stay below.
    """
    maps = [picture.pixels[np.isfinite(picture.pixels)] for picture in pictures if picture.kind == "error"]
    if not maps:
        return None
    errors = np.abs(np.concatenate(maps))
    most = float(np.percentile(errors, MOST)) if errors.size else 0.0
    if most <= 0.0:
        return 0.01
    power = 10.0 ** math.floor(math.log10(most))
    return next(step * power for step in STEPS if step * power >= most * (1.0 - 1e-9))


def print_picture(picture: Picture, exposure: float, scale: float | None) -> bytes:
    """The picture's PNG; ``scale`` is the error at the ends of an error map's colours."""
    shown = error_colours(picture.pixels, scale or 1.0) if picture.kind == "error" else develop(picture, exposure)
    file = io.BytesIO()
    Image.fromarray(shown).save(file, "png", optimize=True)
    return file.getvalue()


def develop(picture: Picture, exposure: float) -> np.ndarray:
    """Radiance as (h, w, 3) uint8 sRGB, by the curve that frames have."""
    radiance = np.ascontiguousarray(picture.pixels, np.float32)
    on = (radiance != 0.0).any(axis=-1).astype(np.uint8)
    shown = np.empty(radiance.shape, np.uint8)
    develop_rows(radiance, on, 0, exposure, np.array([BACKGROUND] * 2, np.float32), False, tone_table(), shown)
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
