"""Several surfaces among walls, as the kernels take them."""

import numpy as np

from isogi_core.kernels.tracing.peels import MAX_SURFACES
from isogi_core.kernels.transport.surface_paths import Among, Surfaces
from tests.kernels.fields import cells_of
from tests.kernels.rooms import room_of


def among(field, own, others, albedos, clears, transmissions=None, walls=()):
    """The surfaces of a ``field`` at ``own`` and some ``others``, with an albedo and a share that passes each.

    They are among ``walls``. Albedos and transmissions are numbers or linear RGB.
    """
    maps = [cells_of(field, each) for each in (own, *others)]
    cells = (*maps, *[maps[0]] * (MAX_SURFACES - len(maps)))
    back, through = (
        np.array([np.broadcast_to(each, 3) for each in given], float)
        for given in (albedos, transmissions or [0.0] * len(albedos))
    )
    levels = np.array([own, *others], float)
    surfaces = Surfaces(cells, levels, back, np.array(clears, float), through)
    return Among(field, surfaces, room_of(walls, field.spacing))
