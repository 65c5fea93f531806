"""The texels that cells show, all at once."""

import numpy as np

from isogi_core.plan.reachable_texels import shown_blocks


def shown_texels(cells: np.ndarray, shape: tuple[int, int, int], size: int = 3) -> np.ndarray:
    """Whether each texel is shown, found some layers at a time."""
    nz, ny, nx = cells.shape
    return np.concatenate(list(shown_blocks(lambda a, b: cells[a:b], (nz, ny, nx), shape, size)))
