"""The record of a chunk: what one object of the store holds, plane after plane, and whose it is.

A reader of the plain Zarr array needs no isogi: ``numpy.frombuffer`` with the type that the array's
attributes name gives the planes.
"""

from collections.abc import Sequence
from functools import cache

import numpy as np

from isogi_core.bake.light import Part
from isogi_core.bake.precision import (
    FIRST_RUNG,
    LIGHT_OF,
    NOISE_OF,
    SAMPLES_OF,
    VOID_CODE,
    light_codes,
    light_floats,
    noise_codes,
    rung_codes,
)
from isogi_core.bake.recipe import Index
from isogi_core.kernels.codes import Numbers, Texels, unpack_texels
from isogi_core.model.plan import MOST, Layer

HIGHEST_RUNG = 1 + (MOST // FIRST_RUNG).bit_length() - 1
"""The code of the most samples that a texel takes."""

NUMBERS = Numbers(SAMPLES_OF, NOISE_OF, LIGHT_OF)
"""What the bytes of a record stand for."""


@cache
def record_type(layer: Layer, texels: int) -> np.dtype[np.void]:
    """The NumPy type of the record of a chunk of so many ``texels``, packed.

    ``bake`` is the layer's digest and ``index`` (z, y, x) the chunk's place; ``scale`` what the numbers in
    ``light`` (channels, coefficients, texels) are multiples of, and those in ``high``, the coefficients of the
    higher bands as bytes; ``high``, ``rung`` and ``noise`` are codes: see ``bake.precision``. Of texels z is slowest.
    """
    return np.dtype(
        [
            ("bake", "S20"),
            ("index", "<i4", (3,)),
            ("scale", "<f4"),
            ("rung", "u1", (texels,)),
            ("noise", "u1", (layer.noises, texels)),
            ("light", "<f2" if layer.half else "<f4", (layer.channels, layer.floats, texels)),
            ("high", "u1", (layer.channels, layer.order**2 - layer.floats, texels)),
        ]
    )


def pack(part: Part, offsets: np.ndarray, texels: int, bake: str, index: Index) -> np.ndarray:
    """The record, (bytes,) uint8, of a part's texels at ``offsets`` of the chunk ``index``; those not lit are left.

    A whole chunk has so many ``texels``.
    """
    layer = part.layer
    record = np.zeros((), record_type(layer, texels))
    record["bake"], record["index"], record["scale"] = bake.encode(), index, layer.scale
    lit = part.samples != 0
    rows = part.rows(lit)
    record["rung"][offsets[lit]] = rung_codes(rows.samples)
    record["noise"][:, offsets[lit]] = noise_codes(rows.noise, layer.scale).T
    light = np.moveaxis(rows.coefficients / np.float32(layer.scale), 0, -1)
    record["light"][:, :, offsets[lit]] = light_floats(light[:, : layer.floats], layer)
    record["high"][:, :, offsets[lit]] = light_codes(light[:, layer.floats :])
    return record.reshape(1).view(np.uint8)


def unpack(data: np.ndarray, layer: Layer, texels: int, bake: str, index: Index) -> tuple[np.ndarray, Part] | None:
    """Offsets of the texels in a record, ascending, and their part; None where it is of another bake or place."""
    records = data.reshape(1, -1)
    return unpack_all(records, layer, texels) if at_home(records, layer, texels, bake, [index]).all() else None


def at_home(records: np.ndarray, layer: Layer, texels: int, bake: str, indices: Sequence[Index]) -> np.ndarray:
    """Whether each of the ``records`` (k, bytes) uint8 is of this ``bake`` and the chunk of ``indices``; (k,) bool."""
    found = fields(records, layer, texels)
    here = (found["index"] == np.array(indices).reshape(-1, 3)).all(axis=1)
    return np.asarray(here & (found["bake"] == bake.encode()))


def unpack_all(records: np.ndarray, layer: Layer, texels: int) -> tuple[np.ndarray, Part]:
    """Places of the texels in ``records`` (k, bytes) uint8, ascending, and their part.

    A place is the record's number times ``texels`` plus the offset in its chunk; (m,) int32.
    """
    found = fields(records, layer, texels)
    places = np.flatnonzero(found["rung"] != 0).astype(np.int32)
    bounds = np.searchsorted(places, np.arange(len(records) + 1, dtype=np.int32) * np.int32(texels))
    part = Part.undefined(layer, len(places))
    planes = (found["scale"], found["rung"], found["noise"], *planes_of(found, layer))
    filled = Texels(part.samples, part.noise, part.coefficients)
    unpack_texels(places % np.int32(texels), bounds, *planes, NUMBERS, filled)
    return places, part


def fields(records: np.ndarray, layer: Layer, texels: int) -> np.ndarray:
    """The ``records`` (k, bytes) uint8 as NumPy's records, (k,)."""
    return records.view(record_type(layer, texels))[:, 0]


def planes_of(found: np.ndarray, layer: Layer) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The light in NumPy's records, in planes: half floats' bits, single floats, and bytes. Floats are of one kind."""
    light, none = found["light"], found["light"][:, :, :0]
    if layer.half:
        return light.view(np.uint16), none.astype(np.float32), found["high"]
    return none.astype(np.uint16), light, found["high"]


def oddity(data: np.ndarray, layer: Layer, texels: int) -> str:
    """What ``pack`` never writes but is in a record, (bytes,) uint8, the first found; empty if all is well."""
    record = data.view(record_type(layer, texels))[0]
    rung, light = record["rung"], record["light"]
    dark = rung == 0
    oddities = {
        "it was packed to another scale": record["scale"] != np.float32(layer.scale),
        "a texel took a number of samples that none takes": ((rung > HIGHEST_RUNG) & (rung != VOID_CODE)).any(),
        "its light is not finite": not np.isfinite(light).all(),
        "texels without samples have light": any(record[name][..., dark].any() for name in ("light", "high", "noise")),
    }
    return next((what for what, found in oddities.items() if found), "")
