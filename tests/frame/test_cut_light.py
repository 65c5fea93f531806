"""The light of volumes that are cut open, against closed forms."""

import numpy as np

from isogi_core.model.view import View
from isogi_core.plan.volumes.masks import cut_away
from tests.frame.conftest import MIDDLE, Workbench, scene_of, shell


def test_a_face_under_even_light_has_all_of_it(workbench: Workbench) -> None:
    scene = scene_of(cut_away(shell(0.0), "x>16"), 0.0)
    bench = workbench(scene)
    frame = bench.bake(View(0.0, scene.camera(0.0, 0.0, 3.0, 30.0), width=40, height=40))
    rings = np.linalg.norm(frame.position.reshape(-1, 3)[frame.gbuffer.pixels][:, 1:] - MIDDLE, axis=1)
    light = frame.radiance.reshape(-1, 3)[frame.gbuffer.pixels][(rings > 2.0) & (rings < 9.0)]
    assert np.allclose(light, scene.surfaces.albedo[0], rtol=0.03), "a plane sees the whole sky"


def test_light_comes_into_a_hollow_that_is_cut_open(workbench: Workbench) -> None:
    scene = scene_of(cut_away(shell(), "x>16"), 0.0)
    bench = workbench(scene)
    frame = bench.bake(View(0.0, scene.camera(0.0, 0.0, 3.0, 30.0), width=40, height=40))
    inside = np.linalg.norm(frame.position.reshape(-1, 3)[frame.gbuffer.pixels] - MIDDLE, axis=1) < 7.0
    light = frame.radiance.reshape(-1, 3)[frame.gbuffer.pixels][inside]
    assert inside.sum() > 50 and light.min() > 0.2
