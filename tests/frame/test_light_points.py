"""Light at points that no ray has found is that of pixels at the same points."""

from dataclasses import replace

import numpy as np

from tests.frame.conftest import Workbench


def test_points_of_a_picture_have_its_light(orbital: Workbench) -> None:
    view = replace(orbital.view(), moving=True)  # no pixel has paths of its own
    frame = orbital.renderer.render(view)
    lit, normals = orbital.renderer.light_points(view, frame.gbuffer.points)
    apart = (lit.radiance[0] != frame.radiance.reshape(-1, 3)[frame.gbuffer.pixels]).any(axis=1)
    assert apart.mean() < 0.01  # in half-shadow, each pixel draws rays of its own towards a lobe
    np.testing.assert_array_equal(normals, frame.gbuffer.normals(orbital.renderer.tiles))
