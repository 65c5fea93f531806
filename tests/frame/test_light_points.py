"""Light at points that no ray has found is that of pixels at the same points."""

from dataclasses import replace

import numpy as np

from isogi_core.frame.renderer import Renderer
from tests.frame.conftest import Workbench


def test_points_of_a_picture_have_its_light(orbital: Workbench) -> None:
    view, renderer = orbital.view(), Renderer(orbital.renderer.caches, orbital.renderer.tiles)
    frame = renderer.render(view)  # by a renderer of its own, in which no pixel has paths of its own
    shown = frame.radiance.reshape(-1, 3)[frame.gbuffer.pixels]
    for moving in (False, True):
        lit, normals = renderer.light_points(replace(view, moving=moving), frame.gbuffer.points)
        assert (lit.radiance[0] != shown).any(axis=1).mean() < 0.01  # half-shadows are of random rays
    np.testing.assert_array_equal(normals, frame.gbuffer.normals(orbital.renderer.tiles))
