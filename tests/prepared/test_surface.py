"""Surfaces: an isovalue of the file, normalised, with what rays meet there."""

import numpy as np
import pytest

from isogi_core.model.volume import make_volume
from isogi_core.prepared.prepared_scene import PreparedScene
from tests.frame.conftest import scene_of

VALUES = np.random.default_rng(4).integers(100, 4000, (9, 10, 11))


@pytest.mark.parametrize("solid", ["above", "below"])
def test_a_surface_takes_isovalues_of_the_file(solid: str) -> None:
    volume = make_volume(VALUES, solid=solid)
    prepared = PreparedScene(scene_of(volume, 2000.0))
    surface = prepared.surface(2000.0)
    inside = VALUES > 2000 if solid == "above" else VALUES < 2000
    assert np.array_equal(volume.voxels > surface.isovalue, inside)
    assert surface.field is prepared.field


def test_near_surfaces_share_cells_until_forgotten() -> None:
    prepared = PreparedScene(scene_of(make_volume(VALUES), 2000.0))
    one, other = prepared.surface(2000.0), prepared.surface(2001.0)
    field, cells, isovalue = one.traced()
    assert field is prepared.field and isovalue == one.isovalue
    assert other.cells() is cells
    prepared.maps.forget()
    assert one.cells() is not cells
