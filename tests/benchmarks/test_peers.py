"""Peers, where they are installed, are shown the same surface as ours: else their times would mean
nothing.
"""

import numpy as np
import pytest

from isogi_core.plan.assembly import load_scene
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_report.speed import bounce, cast, primary_rays, view_of

SIZE = 96
AGREE = 0.995
"""Share of the pixels that must agree: a mesh and a trilinear surface differ at silhouettes."""


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("demo:casting", albedo=0.7, bounces=4, lights=[{"type": "constant"}])


@pytest.fixture(scope="module")
def seen(scene: Scene) -> np.ndarray:
    """Which pixels show the surface."""
    t, _ = cast(PreparedScene(scene), primary_rays(PreparedScene(scene), SIZE))
    return np.isfinite(t).reshape(SIZE, SIZE)


def test_embree_hits_where_ours_do(scene: Scene) -> None:
    pytest.importorskip("embreex")
    pytest.importorskip("skimage")
    from benchmarks.common import mesh
    from benchmarks.speed import embree

    tree = embree.Tree(
        embree.Device(1), *mesh.make_mesh(scene.volume, scene.volume.normalise_isovalue(127.5))
    )
    rays = primary_rays(PreparedScene(scene), SIZE)
    for _ in range(2):
        t, _ = cast(PreparedScene(scene), rays)
        for trace in (tree.device.one, tree.device.sixteen):
            found = tree.trace(
                trace, rays.origins.astype(np.float32), rays.directions.astype(np.float32)
            )[0]
            assert (np.isfinite(found) == np.isfinite(t)).mean() > 0.97
            both = np.isfinite(found) & np.isfinite(t)
            assert np.median(np.abs(found[both] - t[both])) < 0.02
        rays = bounce(PreparedScene(scene), rays, np.random.default_rng(1))
    assert tree.bytes > 1e6
    tree.close()
    assert tree.device.bytes < tree.bytes


def test_vtk_shows_what_ours_shows(scene: Scene, seen: np.ndarray) -> None:
    pytest.importorskip("vtk")
    from benchmarks.speed import vtk

    vtk.use_threads(2)
    data = vtk.image(scene.volume)
    view = view_of(scene, SIZE)
    for by in vtk.PASSES:
        picture = vtk.Window(data, view, (0.5, 0.5, 0.7), by).picture(127.5)
        assert ((picture.max(axis=-1) > 0) == seen).mean() > AGREE


def test_mitsuba_sees_the_light_that_ours_sees(scene: Scene, seen: np.ndarray) -> None:
    pytest.importorskip("mitsuba")
    pytest.importorskip("skimage")
    from benchmarks.common import mesh, mitsuba
    from benchmarks.speed import paths

    surface = mesh.make_mesh(scene.volume, scene.volume.normalise_isovalue(127.5))
    assert mitsuba.usable("scalar_rgb")
    tracer = mitsuba.PathTracer(
        "scalar_rgb", surface, view_of(scene, SIZE), paths.ALBEDO, paths.SEGMENTS + 1
    )
    theirs = tracer.picture(32, 2)[..., 0][seen].mean()
    rng = np.random.default_rng(1)
    prepared = PreparedScene(scene)
    _, ours = paths.walk(prepared, bounce(prepared, primary_rays(prepared, 4 * SIZE), rng), rng)
    assert paths.ALBEDO * ours == pytest.approx(theirs, rel=0.02)
