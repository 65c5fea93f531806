"""XDMF: XML that describes an even grid whose values are in an HDF5 file. Source: xdmf.org, "XDMF
Model and Format".
"""

from dataclasses import replace
from functools import partial
from typing import Any
from xml.etree import ElementTree

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.formats.hdf5 import open_hdf5
from isogi_core.files.formats.hdf5_dialects import placed
from isogi_core.files.formats.side_headers import data_of
from isogi_core.files.formats.source import Source, reader
from isogi_core.files.grid import Grid, read_as

MOST_XML_BYTES = 1 << 20
"""Bytes of a description, at most: longer ones hold numbers, or many grids."""

EVEN_TOPOLOGY = "3DCORECTMESH"
EVEN_GEOMETRY = "ORIGIN_DXDYDZ"


@reader("XDMF", "part")
def open_xdmf(source: Source) -> Grid:
    """Open the attribute of an even grid that is chosen, the only one by default. Raises
    VolumeError.
    """
    if source.path is None:
        raise VolumeError(
            f"'{source.name}' describes data in other files: send the HDF5 file that it names."
        )
    with source.open() as file:
        text = file.read(MOST_XML_BYTES)
    grids = [
        each
        for each in ElementTree.fromstring(text).iter("Grid")
        if each.find("Topology") is not None
    ]
    if len(grids) != 1 or not _is_even(grids[0]):
        raise VolumeError(
            f"'{source.name}' describes no one even grid (3DCoRectMesh): give the HDF5 file that "
            "it names, with the path inside, or resample it in ParaView and save it as .vti."
        )
    origin, steps = (_three(item) for item in grids[0].findall("Geometry/DataItem"))
    attribute = _attribute(source, grids[0])
    name, _, inside = (attribute.findtext("DataItem") or "").strip().partition(":")
    if not inside:
        raise VolumeError(
            f"'{source.name}' holds its numbers itself or in a raw file: write them as HDF5."
        )
    voxels = data_of(source, name)
    grid = open_hdf5(replace(voxels, chosen={"part": inside}, voxels=source.voxels))
    if attribute.get("Center", "Node").lower() == "cell":
        origin = origin + 0.5 * steps
    place = placed(np.diag(steps), origin)
    return replace(
        grid,
        spacing=place.spacing,
        affine=place.affine,
        stamp=partial(source.stamp, *([voxels.path] if voxels.path else [])),
        read_as=read_as("XDMF", grid.dtype, "its origin and spacing"),
    )


def _kind(element: Any, name: str) -> str:
    """Read the type of a part of a grid, in capital letters, which has two names."""
    return str(element.get(f"{name}Type") or element.get("Type") or "").upper()


def _is_even(grid: Any) -> bool:
    """Return True if a grid is even: described by an origin and steps."""
    topology = _kind(grid.find("Topology"), "Topology")
    geometry = grid.find("Geometry")
    if geometry is None or _kind(geometry, "Geometry") != EVEN_GEOMETRY:
        return False
    return topology == EVEN_TOPOLOGY and len(geometry.findall("DataItem")) == 2


def _three(item: Any) -> np.ndarray:
    """Read three numbers along z, y, x as x, y, z."""
    return np.array([float(word) for word in (item.text or "").split()])[[2, 1, 0]]


def _attribute(source: Source, grid: Any) -> Any:
    """Find the attribute that is chosen by its name, or the only one. Raises VolumeError."""
    found = {each.get("Name", ""): each for each in grid.findall("Attribute")}
    part = source.chosen.get("part") or (next(iter(found)) if len(found) == 1 else None)
    if part not in found:
        listed = ", ".join(f"'{source.name}#{name}'" for name in found)
        raise VolumeError(f"'{source.name}' holds several attributes: choose of {listed}.")
    return found[part]
