"""Colours by data as visitors' graphics cards take them: codes of values, or labels, layer by
layer.
"""

import hashlib
from dataclasses import dataclass

import numpy as np

from isogi_core.model.colours import SurfaceColours
from isogi_core.model.volume import Isovalue, Volume
from isogi_core.plan.reachable_texels import surface_cells
from isogi_core.plan.scene import Scene

SLAB_BYTES = 1 << 22
"""Most bytes of a slab, unless one layer takes more."""


@dataclass(frozen=True, eq=False)
class ColourCodes:
    """The ``colours`` of a scene, of which a card needs those at isosurfaces between the ``ends``
    of a range of isovalues, and the ``volume`` whose voxels decide where these lie.
    """

    colours: SurfaceColours
    volume: Volume
    ends: tuple[Isovalue, Isovalue]

    @classmethod
    def of(cls, scene: Scene, span: tuple[float, float] | None = None) -> "ColourCodes | None":
        """Return those of a ``scene`` for isovalues within a ``span`` in the file's units, by
        default all that views may ask for; None if the scene has no colours by data.
        """
        colours = scene.surfaces.colours
        if colours is None:
            return None
        ends = scene.volume.normalise_span(*(span or scene.isovalues))
        return cls(colours, scene.volume, ends)

    @property
    def nbytes(self) -> int:
        """Bytes of all codes."""
        return self.colours.places.nbytes

    @property
    def slabs(self) -> tuple[tuple[int, int], ...]:
        """First layer of each slab along z, and the first after it."""
        depth = len(self.colours.places)
        layers = max(SLAB_BYTES * depth // self.nbytes, 1)
        return tuple((z, min(z + layers, depth)) for z in range(0, depth, layers))

    @property
    def version(self) -> str:
        """Hex digest of everything that the codes depend on."""
        text = f"{self.colours.digest} {self.volume.digest} {self.ends}"
        return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()

    def layers(self, first: int, last: int) -> np.ndarray:
        """Return the layers from ``first`` to before ``last``, uint8: codes (layers, ny, nx), or
        labels (layers, ny, nx, 3).

        Codes that no isosurface in the range shows are 0, so that they compress well. Labels stay:
        faces of windows show those inside of matter, and they compress well by themselves.
        """
        places = self.colours.places
        voxels = self.volume.voxels
        asked = places[first:last]
        if places.shape != voxels.shape:
            return asked
        # Mark the cells that may show a surface, those above and below the layers included, then
        # the corners of these cells.
        a = max(first - 1, 0)
        slab = voxels[a : min(last + 1, len(voxels))]
        shown = np.zeros(slab.shape, np.bool_)
        cells = surface_cells(slab, *self.ends)
        for corner in np.ndindex(2, 2, 2):
            shown[tuple(slice(i, i + n) for i, n in zip(corner, cells.shape, strict=True))] |= cells
        return np.where(shown[first - a : last - a], asked, np.uint8(0))
