"""The isosurface that a view shows, as rays meet it: its isovalue is normalised, once and for all steps of a frame."""

from dataclasses import dataclass

from isogi_core.kernels.tracing.active_cells import ActiveCells
from isogi_core.kernels.tracing.cast import TracedSurface
from isogi_core.kernels.tracing.field import Field
from isogi_core.model.volume import Isovalue
from isogi_core.prepared.active_cell_maps import ActiveCellMaps
from isogi_core.runs import Run, serially


@dataclass(frozen=True, eq=False)
class Surface:
    """The isosurface of a ``field`` at a normalised ``isovalue``; ``maps`` are the field's active-cell maps.

    ``PreparedScene.surface`` makes it from an isovalue in the units of the volume's file.
    """

    isovalue: Isovalue
    field: Field
    maps: ActiveCellMaps

    def cells(self, run: Run = serially) -> ActiveCells:
        """The cells that may hold the surface; made when first needed, by means of ``run``, and kept by ``maps``."""
        return self.maps.at(self.isovalue, run)

    def traced(self, run: Run = serially) -> TracedSurface:
        """The surface as kernels that cast rays take it: the field, the cells and the isovalue."""
        return TracedSurface(self.field, self.cells(run), float(self.isovalue))
