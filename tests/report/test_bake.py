"""Light that is baked in memory is the light that a store would hold."""

from pathlib import Path

import numpy as np

from isogi_core.bake.refine import locate
from isogi_core.frame.projected_texels import STEEPNESS, find_distances
from isogi_core.frame.renderer import Renderer
from isogi_report.bench import UNREACHED_TARGET, Bench, ViewBake
from isogi_report.speed import bake_view, make_renderer
from tests.report.conftest import MakeBench


def test_frames_have_the_bits_of_those_from_a_store(under_sky: Bench, tmp_path: Path) -> None:
    bake = ViewBake(under_sky.renderer(under_sky.scene), under_sky.view)
    bake.grow(16)
    bake.frame()
    frame = Renderer(bake.renderer.caches, under_sky.tiles).render(under_sky.view, UNREACHED_TARGET)
    stored = bake_view(make_renderer(under_sky.scene, str(tmp_path)), under_sky.view, 16)
    assert stored.surface > 20
    assert np.array_equal(frame.radiance, stored.radiance) and np.array_equal(frame.error, stored.error)
    assert bake.samples == 16.0
    assert bake.seconds > 0.0


def test_texels_far_from_the_surface_are_projected(make_bench: MakeBench) -> None:
    bench = make_bench(projected=True, lattice=0.5, target_error=0.05)
    renderer = bench.renderer(bench.scene)
    bake = ViewBake(renderer, bench.view)
    bake.grow(256)
    frame, texels = bake.frame(), len(bake.shown.places)
    assert frame.quality.projection
    ways = find_distances(bake.shown, renderer.prepared, renderer.tiles).voxels
    distant = np.flatnonzero(STEEPNESS * ways > 0.05)
    np.testing.assert_array_equal(bake.texels[texels:], bake.texels[:texels][distant])
    projected = frame.quality.projection.reading.projected_rows >= 0
    assert 0 < projected.sum() <= len(distant) and not np.delete(projected, distant).any()
    level = frame.gbuffer.isovalue
    own = bake.light.rows(np.arange(texels, len(bake.texels)))
    void = locate(bake.texels[texels:], renderer.prepared, level)[1]
    np.testing.assert_array_equal(own.void, void)
    assert not projected[distant[void]].any()


def test_growing_goes_on_where_it_was(under_sky: Bench) -> None:
    renderer = under_sky.renderer(under_sky.scene)
    twice, once = (ViewBake(renderer, under_sky.view) for _ in range(2))
    twice.grow(16)
    twice.grow(32)
    once.grow(32)
    assert np.array_equal(twice.frame().radiance, once.frame().radiance)
