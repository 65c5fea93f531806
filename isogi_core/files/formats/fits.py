"""FITS of astronomers, read by astropy: cubes in any extension, also compressed ones."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.coordinates import NOWHERE, SPACING_KEY, Along, Place, place_by
from isogi_core.files.formats.source import Source, library, pick_axes, reader
from isogi_core.files.grid import Grid, Shape, slab_layers
from isogi_core.files.packing import Packing, Scaling, holed, whole_type

FITS_EXTRA = "'isogi[fits]'"

SKY = ("RA", "DEC", "GLON", "GLAT", "ELON", "ELAT")
"""How the types of axes on the sky begin. Source: FITS standard 4.0, section 8.3."""


@reader("FITS", "part", "time", "channel")
def open_fits(source: Source) -> Grid:
    """Open an image of three axes or more as a grid. Raises VolumeError.

    Only headers are read now. Axes of length one are left out. The last three of the others, the
    fastest ones, are z, y, x; ``pick_axes`` chooses along those before.
    """
    with _image(source) as image:
        long = [n for n, length in enumerate(image.shape) if length > 1]
        outer = long[:-3]
        ahead, moment, _ = pick_axes(source, tuple(int(image.shape[n]) for n in long))
        inner = long[-3:]
        key = [0 if n not in inner else slice(None) for n in range(len(image.shape))]
        for axis, element in zip(outer, ahead, strict=True):
            key[axis] = element
        shape = tuple(int(image.shape[n]) for n in inner)
        source.check(shape)
        packing = _packing(image.header)
        place = _place(image.header, [len(image.shape) - n for n in inner[::-1]], shape[::-1])
    known = packing.read_as("FITS", "its axes" if place.said and not place.notes else "")
    return Grid(
        shape,
        packing.dtype,
        place.spacing,
        partial(_slabs, source, tuple(key), inner[0], shape),
        source.stamp,
        place.affine,
        place.unit,
        (*place.notes, *packing.notes),
        moment,
        read_as=known,
    )


def _stored_type(header: Any) -> np.dtype[Any]:
    """Return the type of stored numbers. Whole numbers of 8 bits have no sign, longer ones have
    one. Source: FITS standard 4.0, sections 5.2 and 5.3.
    """
    bits = int(header["BITPIX"])
    if bits < 0:
        letter = "f"
    elif bits == 8:
        letter = "u"
    else:
        letter = "i"
    return np.dtype(f"{letter}{abs(bits) // 8}")


MOVED = {"u1": -(2.0**7), "i2": 2.0**15, "i4": 2.0**31, "i8": 2.0**63}
"""BZERO by which whole numbers of the other sign are stored, by the type of stored numbers. Source:
FITS standard 4.0, section 4.4.2.5, table 11.
"""


def _packing(header: Any) -> Packing:
    """Return how the stored numbers of an image become values: holes (BLANK), then the scaling.

    astropy would mark no hole whose BLANK is 0, nor any in numbers of the other sign.
    """
    stored = _stored_type(header)
    scaling = Scaling(float(header.get("BSCALE", 1.0)), float(header.get("BZERO", 0.0)))
    blank = header.get("BLANK")
    holes = []
    # BLANK is a stored number, and whole numbers alone have one.
    if stored.kind in "iu" and isinstance(blank, int):
        limits = np.iinfo(stored)
        holes = [blank] if limits.min <= blank <= limits.max else []
    if scaling == Scaling(1.0, MOVED.get(stored.str[1:], np.nan)):
        moved = whole_type(stored, unsigned=stored.kind == "i")
        return holed(moved, [each + int(scaling.intercept) for each in holes], "BLANK")
    return replace(holed(stored, holes, "BLANK"), scaling=scaling)


@contextmanager
def _image(source: Source) -> Iterator[Any]:
    """Open the image that is chosen by its number or name; by default the only one that has three
    or more axes longer than one. Raises VolumeError, also if several have the name.
    """
    fits = library("astropy.io.fits", "FITS", FITS_EXTRA)
    with (
        source.unpacked() as file,
        fits.open(file, memmap=False, do_not_scale_image_data=True) as units,
    ):
        part = source.chosen.get("part")
        cubes = {
            str(n): unit
            for n, unit in enumerate(units)
            if sum(length > 1 for length in getattr(unit, "shape", ()) or ()) >= 3
        }
        if not part:
            meant = list(cubes.values())
        elif part in cubes:
            meant = [cubes[part]]
        else:
            meant = [unit for unit in cubes.values() if unit.name.lower() == part.lower()]
        if len(meant) != 1:
            if not cubes:
                raise VolumeError(
                    f"'{source.name}' holds tables or images of two axes alone: give a file with a "
                    "cube."
                )
            listed = ", ".join(f"'{source.name}#{n}' {unit.name}" for n, unit in cubes.items())
            raise VolumeError(f"'{source.name}' holds no one cube: choose of {listed.strip()}.")
        yield meant[0]


def _place(header: Any, numbers: Sequence[int], lengths: Sequence[int]) -> Place:
    """Place voxels by the axes x, y, z of a header; ``numbers`` are those of the three axes there,
    from 1, and ``lengths`` their voxels.

    If an axis is on the sky, or units differ, voxels are taken as cubes, and a note says so.
    """
    steps = [header.get(f"CDELT{n}", header.get(f"CD{n}_{n}")) for n in numbers]
    if any(step is None or not float(step) for step in steps):
        return NOWHERE
    kinds = [str(header.get(f"CTYPE{n}", "")).strip() for n in numbers]
    units = [str(header.get(f"CUNIT{n}", "")).strip() for n in numbers]
    if len(set(units)) > 1 or any(kind.split("-")[0] in SKY for kind in kinds):
        listed = ", ".join(unit or kind or "?" for unit, kind in zip(units, kinds, strict=True))
        note = f"Voxels are taken as cubes, as its axes are {listed}: {SPACING_KEY}."
        return Place(notes=(note,), said=True)
    axes = [
        Along(
            float(header.get(f"CRVAL{n}", 0.0))
            + float(step) * (np.arange(length) + 1.0 - float(header.get(f"CRPIX{n}", 1.0))),
            unit,
        )
        for n, step, length, unit in zip(numbers, steps, lengths, units, strict=True)
    ]
    return place_by(axes)


def _slabs(source: Source, key: tuple[Any, ...], along: int, shape: Shape) -> Iterator[np.ndarray]:
    """Yield some layers at a time, (layers, ny, nx), scaled, NaN where the header marks holes.

    ``key`` chooses the field in the image, and ``along`` is the place of z among its axes.
    """
    with _image(source) as image:
        stored = _stored_type(image.header)
        packing = _packing(image.header)
        step = slab_layers(shape[1] * shape[2] * packing.dtype.itemsize)
        for z in range(0, shape[0], step):
            layers = list(key)
            layers[along] = slice(z, min(z + step, shape[0]))
            numbers = np.asarray(image.section[tuple(layers)]).astype(stored)
            # To move whole numbers to the other sign is to turn their highest bit.
            if packing.stored != stored:
                numbers = numbers ^ stored.type(np.iinfo(stored).min or 1 << 7)
            yield packing.apply(numbers).astype(packing.dtype, copy=False)
