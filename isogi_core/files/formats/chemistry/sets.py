"""Several data sets in one file, and fields whose first index is the slowest one."""

import math

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.formats.chemistry.text import Text
from isogi_core.files.formats.source import Source


def pick_set(source: Source, names: tuple[str, ...], what: str) -> tuple[int, tuple[str, ...]]:
    """Which of the data sets of a file is chosen, by its name as ``part`` or its place as
    ``channel``, the first by default; and a note if nothing is chosen among several.

    Raises VolumeError for one that is not there.
    """
    listed = ", ".join(names[:MOST_LISTED]) + (" …" if len(names) > MOST_LISTED else "")
    part = source.chosen.get("part")
    channel = source.count("channel")
    if part is not None:
        matching = [place for place, name in enumerate(names) if name == part]
        if not matching:
            raise VolumeError(f"'{source.name}' has no '{part}': choose one of {listed}.")
        return matching[0], ()
    if channel is not None:
        if channel >= len(names):
            raise VolumeError(
                f"channel = {channel} is not in '{source.name}', which has 0 to {len(names) - 1}: "
                f"{listed}."
            )
        return channel, ()
    if len(names) == 1:
        return 0, ()
    other = f"#{names[1]} after the file's name, or channel = 1, chooses the second"
    return 0, (f"The file holds {len(names)} {what}, {listed}: {names[0]} is shown, and {other}.",)


MOST_LISTED = 12
"""Most names of data sets that a message lists."""


def read_z_fastest(
    text: Text, shape: tuple[int, int, int], field: int = 0, fields: int = 1
) -> np.ndarray:
    """Read one data set from the next numbers of a ``text``, in which z varies fastest: an array
    (nz, ny, nx) float64, for a ``shape`` of nx, ny and nz voxels.

    If each voxel has numbers of several ``fields`` side by side, those of number ``field`` are
    taken, counted from 0.
    """
    nx, ny, nz = shape
    found = np.empty((nx, ny, nz))
    flat = found.reshape(-1)
    at = 0
    for block in text.numbers(math.prod(shape) * fields):
        # Blocks end anywhere: find the first number of the field in this one, and its voxel.
        first = -(at - field) % fields
        kept = block[first::fields]
        place = (at + first) // fields
        flat[place : place + len(kept)] = kept
        at += len(block)
    return found.transpose(2, 1, 0)
