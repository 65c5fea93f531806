"""MINC 1 and 2, read by nibabel: the files of brains that the Montreal Neurological Institute writes."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.formats.source import Source, library, pick_step, reading
from isogi_core.files.grid import PATIENT_AXES, SINGLE_MOMENT, Affine, Grid, Shape, read_as, slab_layers

MINC1_MAGIC, MINC2_MAGIC, MINC_SUFFIX = b"CDF", b"\x89HDF", ".mnc"
"""How MINC 1 and MINC 2 begin, as other files do, too, and how both are named."""

SCALED_SLICES = "MINC, each slice of a slope of its own,"


def is_minc(head: bytes, suffix: str) -> bool:
    """Whether a file begins as MINC does, and is named so."""
    return suffix == MINC_SUFFIX and head.startswith((MINC1_MAGIC, MINC2_MAGIC))


def open_minc(source: Source) -> Grid:
    """Open a file as a grid: of MINC 2 only its description is read now. Raises VolumeError."""
    source.refuse_others("time")
    with reading(source.name, "MINC"), _image(source) as image:
        shape, stored = tuple(int(n) for n in image.get_data_shape()), np.dtype(image.get_data_dtype())
        names = list(map(str, image._dim_names))
        if not all(name.endswith("space") for name in names[-3:]) or names[:-3] not in ([], ["time"]):
            raise VolumeError(f"'{source.name}' has the axes {', '.join(names)}: save z, y and x alone, or in time.")
        source.check(shape[-3:])
        matrix = image.get_affine()[:3, [2, 1, 0, 3]]
    times = shape[0] if len(shape) > 3 else 1
    time, unchosen = pick_step(source, times)
    picked = (time,) if len(shape) > 3 else ()
    wide = stored.itemsize > 2 and stored.newbyteorder("=") != np.float32
    dtype: np.dtype[Any] = np.dtype(np.float64 if wide else np.float32)
    x, y, z = (float(step) for step in np.linalg.norm(matrix[:, :3], axis=0))
    return Grid(
        shape[-3:],
        dtype,
        (x, y, z),
        partial(_image_slabs, source, picked, shape[-3:], dtype),
        source.stamp,
        Affine.of(matrix, PATIENT_AXES),
        "mm",
        moment=(time, times) if times > 1 else SINGLE_MOMENT,
        unchosen=unchosen,
        read_as=read_as("MINC" if stored.kind == "f" else SCALED_SLICES, stored, "its dimensions"),
    )


@contextmanager
def _image(source: Source) -> Iterator[Any]:
    """What nibabel makes of the file."""
    with source.open() as file:
        begins = file.read(len(MINC1_MAGIC))
        file.seek(0)
        if begins == MINC1_MAGIC:
            classic = library("nibabel.externals.netcdf", "MINC").netcdf_file(file, mmap=False)
            yield library("nibabel.minc1", "MINC").Minc1File(classic)
            return
        kind, h5py = library("nibabel.minc2", "MINC").Minc2File, library("h5py", "MINC")
        with h5py.File(source.path or file, "r", locking=False) as whole:
            yield kind(whole)


def _image_slabs(source: Source, picked: tuple[int, ...], shape: Shape, dtype: np.dtype[Any]) -> Iterator[np.ndarray]:
    """Some layers at a time, scaled to the range that each slice says."""
    with reading(source.name, "MINC"), _image(source) as image:
        step = slab_layers(shape[1] * shape[2] * 8)
        for z in range(0, shape[0], step):
            yield image.get_scaled_data((*picked, slice(z, min(z + step, shape[0])))).astype(dtype)
