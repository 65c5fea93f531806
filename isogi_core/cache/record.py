"""The record of a chunk: what one object of the store holds, plane after plane, and whose it is.

A reader of the plain Zarr array needs no isogi: ``numpy.frombuffer`` with the type that the array's
attributes name gives the planes.
"""

import numpy as np

from isogi_core.bake.light import Part
from isogi_core.bake.precision import light_codes, light_floats, light_of, noise_codes, noise_of, rung_codes, samples_of
from isogi_core.bake.recipe import Index
from isogi_core.kernels.lattice import CHUNK
from isogi_core.model.plan import Layer

TEXELS = CHUNK**3
"""Texels of a whole chunk."""


def record_type(layer: Layer) -> np.dtype[np.void]:
    """The NumPy type of a chunk's record, packed.

    ``bake`` is the layer's digest and ``index`` (z, y, x) the chunk's place; ``scale`` what the numbers in
    ``light`` (channels, coefficients, texels) are multiples of, and those in ``high``, the coefficients of the
    higher bands as bytes; ``high``, ``rung`` and ``noise`` are codes: see ``bake.precision``. Of texels z is slowest.
    """
    return np.dtype(
        [
            ("bake", "S20"),
            ("index", "<i4", (3,)),
            ("scale", "<f4"),
            ("rung", "u1", (TEXELS,)),
            ("noise", "u1", (layer.noises, TEXELS)),
            ("light", "<f2" if layer.half else "<f4", (layer.channels, layer.floats, TEXELS)),
            ("high", "u1", (layer.channels, layer.order**2 - layer.floats, TEXELS)),
        ]
    )


def pack(part: Part, offsets: np.ndarray, bake: str, index: Index) -> np.ndarray:
    """The record, (bytes,) uint8, of a part's texels at ``offsets`` of the chunk ``index``; those not lit are left."""
    layer = part.layer
    record = np.zeros((), record_type(layer))
    record["bake"], record["index"], record["scale"] = bake.encode(), index, layer.scale
    lit = part.samples != 0
    rows = part.rows(lit)
    record["rung"][offsets[lit]] = rung_codes(rows.samples)
    record["noise"][:, offsets[lit]] = noise_codes(rows.noise, layer.scale).T
    light = np.moveaxis(rows.coefficients / np.float32(layer.scale), 0, -1)
    record["light"][:, :, offsets[lit]] = light_floats(light[:, : layer.floats], layer)
    record["high"][:, :, offsets[lit]] = light_codes(light[:, layer.floats :])
    return record.reshape(1).view(np.uint8)


def unpack(data: np.ndarray, layer: Layer, bake: str, index: Index) -> tuple[np.ndarray, Part] | None:
    """Offsets of the texels in a record, ascending, and their part; None where it is of another bake or place."""
    record = data.view(record_type(layer))[0]
    if record["bake"] != bake.encode() or record["index"].tolist() != list(index):
        return None
    offsets = np.flatnonzero(record["rung"]).astype(np.int32)
    planes = record["light"][:, :, offsets].astype(np.float32), light_of(record["high"][:, :, offsets])
    light = np.moveaxis(np.concatenate(planes, axis=1), -1, 0) * record["scale"]
    noise = noise_of(record["noise"][:, offsets].T, float(record["scale"]))
    return offsets, Part(layer, samples_of(record["rung"][offsets]), noise, np.ascontiguousarray(light))
