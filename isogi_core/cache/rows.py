"""Rows of light as frames read it, and how they are made of the parts that texels keep."""

from itertools import product

import numpy as np

from isogi_core.bake.light import Light
from isogi_core.bake.look import Look
from isogi_core.bake.moments import powers
from isogi_core.bake.noise import DARKEST, deviations, least_level, white
from isogi_core.bake.precision import samples_of
from isogi_core.kernels.rows import Judge, Role, Rows, Sums, add_part, judge_rows
from isogi_core.model.plan import FEWEST, Layer

RUNGS = 32
"""More than the rungs of the ladder of sample counts."""

CHECKSUMS = 509
"""Checksums of light that is only shown: with the rungs of three parts, all that single floats count exactly."""


def new_rows(look: Look, count: int) -> Rows:
    """So many rows for what frames of a ``look`` read and no more; memory is taken as they fill."""
    columns = (np.empty(count, np.float32) for _ in range(3))
    return Rows(np.empty((count, look.channels, look.columns), np.float32), *columns)


def fill_rows(rows: Rows, numbers: np.ndarray, light: Light, look: Look) -> np.ndarray:
    """Put texels' ``light`` into the rows of these ``numbers`` (m,) int32, and tell where each is to be looked up.

    That is its row; BURIED_ROW where no path of any part ever left, VOID_ROW, or UNLIT where there is no light that can
    be shown: reflected light alone is none. Scatter is what ``bake.moments`` says. A stamp tells how far a texel is
    baked: RUNGS^p times the rung of each part p, summed, and above these a checksum of what is shown without samples,
    for an earlier plan's light may grow too.
    """
    sums = Sums(*(np.zeros(len(numbers), kind) for kind in (np.float64, np.float64, np.int64, np.int64, np.uint8)))
    for at, term in enumerate(look.terms):
        for number in term.layers:
            part = light.parts[number] if term.node is None else light.parts[number].channel(term.node)
            own, role = np.ascontiguousarray(part.coefficients), role_of(number, part.layer, at, look)
            add_part(part.samples, part.noise, own, own.view(np.int32), role, numbers, rows, sums)
    places = np.empty_like(numbers)
    judge_rows(numbers, rows, sums, judge_of(len(light.parts), look), places)
    return places


def reflected_share(light: Light, look: Look) -> np.ndarray:
    """The share of texels' variance that is of reflected light; (m,) float32."""
    variances = deviations(light, look) ** 2
    reflected = variances[[part.layer.kind == "indirect" for part in light.parts]].sum(axis=0)
    return np.asarray(reflected / np.maximum(variances.sum(axis=0), 1e-30), np.float32)


def role_of(number: int, layer: Layer, at: int, look: Look) -> Role:
    """What a ``layer`` is to a look, as part ``number`` and in the term number ``at``.

    Irradiance that is dark may be so by its light alone. What is kept for several albedos is of the same paths: the
    last alone tells of their noise and number.
    """
    term, weights = look.terms[at], white(layer, look)
    last = term.node in (None, layer.channels - 1)
    return Role(
        gains=look.gains(layer) if last else np.zeros(layer.noises),
        weights=weights if term.node is None else weights[term.node : term.node + 1],
        column=int(look.firsts[at]),
        width=term.order**2,
        first=number == min(term.layers),
        rung=RUNGS**number if last else 0,
        straight=layer.kind != "indirect",
        telling=layer.kind != "irradiance",
        fewest=FEWEST,
    )


def judge_of(parts: int, look: Look) -> Judge:
    """What the lights of a look are to texels of so many ``parts``."""
    return Judge(
        firsts=look.firsts,
        widths=np.array([term.order**2 for term in look.terms]),
        squares=np.array([term.square[0] for term in look.terms]),
        powers=powers_of(look),
        unit=look.unit,
        level=least_level(look),
        darkest=DARKEST * look.unit,
        beyond=RUNGS**parts,
        checksums=CHECKSUMS,
    )


def powers_of(look: Look) -> np.ndarray:
    """``powers`` of each two terms' lights, 0 beyond the lower order; (terms, terms, channels, channels, most n²)."""
    most, count = max(term.order for term in look.terms) ** 2, len(look.terms)
    found = np.zeros((count, count, look.channels, look.channels, most))
    for (a, one), (b, other) in product(enumerate(look.terms), repeat=2):
        each = powers(one.luminance / look.unit, other.luminance / look.unit)
        found[a, b, :, :, : each.shape[2]] = each
    return found


def fewest_samples(stamps: np.ndarray, parts: int) -> np.ndarray:
    """The fewest samples of any part of texels with these ``stamps``, 0 where one is not baked; (texels,) int32."""
    rungs = np.maximum(stamps, 0).astype(np.int64)[None] // RUNGS ** np.arange(parts)[:, None] % RUNGS
    return samples_of(rungs.min(axis=0).astype(np.uint8))
