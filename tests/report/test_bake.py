"""Light that is baked in memory is the light that a store would hold."""

from pathlib import Path

import numpy as np

from isogi_core.report.bake import ViewBake
from isogi_core.report.bench import Bench
from server.measure import bake_view, make_renderer


def test_frames_have_the_bits_of_those_from_a_store(under_sky: Bench, tmp_path: Path) -> None:
    bake = ViewBake(under_sky.renderer(under_sky.scene), under_sky.view)
    bake.grow(16)
    stored = bake_view(make_renderer(under_sky.scene, str(tmp_path)), under_sky.view, 16)
    assert stored.surface > 20
    assert np.array_equal(bake.frame().radiance, stored.radiance)
    assert np.array_equal(bake.frame().error, stored.error)
    assert bake.samples == 16.0
    assert bake.seconds > 0.0


def test_growing_goes_on_where_it_was(under_sky: Bench) -> None:
    renderer = under_sky.renderer(under_sky.scene)
    twice, once = (ViewBake(renderer, under_sky.view) for _ in range(2))
    twice.grow(16)
    twice.grow(32)
    once.grow(32)
    assert np.array_equal(twice.frame().radiance, once.frame().radiance)
