"""Peers, where they are installed, are shown the same surface as ours: else their times would mean nothing."""

import numpy as np
import pytest

from isogi_core.bake.recipe import Recipe
from isogi_core.model.scene import Scene, load_scene
from server.measure import bounce, cast, primary_rays, view_of

SIZE = 96
AGREE = 0.995
"""Share of the pixels that must agree: a mesh and a trilinear surface differ at silhouettes."""


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("demo:casting", albedo=0.7, bounces=4, lights=[{"type": "constant"}])


@pytest.fixture(scope="module")
def seen(scene: Scene) -> np.ndarray:
    """Which pixels show the surface."""
    t, _ = cast(Recipe(scene), primary_rays(Recipe(scene), SIZE))
    return np.isfinite(t).reshape(SIZE, SIZE)


def test_embree_hits_where_ours_do(scene: Scene) -> None:
    pytest.importorskip("embreex")
    pytest.importorskip("skimage")
    from benchmarks import embree, mesh

    tree = embree.Tree(embree.Device(1), *mesh.make_mesh(scene.volume, scene.volume.normalise_isovalue(127.5)))
    rays = primary_rays(Recipe(scene), SIZE)
    for _ in range(2):
        t, _ = cast(Recipe(scene), rays)
        for trace in (tree.device.one, tree.device.sixteen):
            found = tree.trace(trace, rays.origins.astype(np.float32), rays.directions.astype(np.float32))[0]
            assert (np.isfinite(found) == np.isfinite(t)).mean() > 0.97
            both = np.isfinite(found) & np.isfinite(t)
            assert np.median(np.abs(found[both] - t[both])) < 0.02
        rays = bounce(Recipe(scene), rays, np.random.default_rng(1))
    assert tree.bytes > 1e6
    tree.close()
    assert tree.device.bytes < tree.bytes


def test_vtk_shows_what_ours_shows(scene: Scene, seen: np.ndarray) -> None:
    pytest.importorskip("vtk")
    from benchmarks import vtk_scene

    vtk_scene.use_threads(2)
    data, view = vtk_scene.image(scene.volume), view_of(scene, SIZE)
    for by in vtk_scene.PASSES:
        picture = vtk_scene.Window(data, view, (0.5, 0.5, 0.7), by).picture(127.5)
        assert ((picture.max(axis=-1) > 0) == seen).mean() > AGREE


def test_mitsuba_sees_the_light_that_ours_sees(scene: Scene, seen: np.ndarray) -> None:
    pytest.importorskip("mitsuba")
    pytest.importorskip("skimage")
    from benchmarks import mesh, mitsuba_scene, paths

    surface = mesh.make_mesh(scene.volume, scene.volume.normalise_isovalue(127.5))
    assert mitsuba_scene.usable("scalar_rgb")
    tracer = mitsuba_scene.PathTracer("scalar_rgb", surface, view_of(scene, SIZE), paths.ALBEDO, paths.SEGMENTS + 1)
    theirs = tracer.picture(32, 2)[..., 0][seen].mean()
    rng, recipe = np.random.default_rng(1), Recipe(scene)
    _, ours = paths.walk(recipe, bounce(recipe, primary_rays(recipe, 4 * SIZE), rng), rng)
    assert paths.ALBEDO * ours == pytest.approx(theirs, rel=0.02)
