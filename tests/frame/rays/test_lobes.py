"""Lobes in a frame: the sun's own shadow, light that is not counted twice, and what is kept while
the light rests.
"""

import math
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.errors import Cancelled
from isogi_core.files.radiance import write_hdr
from isogi_core.frame import surface_renderer as module
from isogi_core.frame.lighting import RotatedLight
from isogi_core.kernels.transport.lights import DIRECTIONAL
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.model.view import quaternion_from_angles
from isogi_core.model.volume import Volume, make_volume
from tests.frame.conftest import LOOSE, SKY, Workbench, ball, luminance, relative_rmse, scene_of

Make = Callable[..., Workbench]
TURN = quaternion_from_angles(70.0, 20.0, -10.0)


def table(size: int = 32) -> Volume:
    """A ball over a plate: the distance to their skin in voxels, positive inside."""
    z, y, x = np.mgrid[:size, :size, :size] - (size - 1) / 2
    plate = np.minimum(2.0 - np.abs(z + 10.0), 13.0 - np.maximum(np.abs(x), np.abs(y)))
    over = 5.0 - np.sqrt(x**2 + y**2 + z**2)
    return make_volume(np.maximum(plate, over).astype(np.float32), name="table")


def set_out(workbench: Make, volume: Volume, **settings: Any) -> Workbench:
    """The workbench of a volume under a sky with a sun."""
    return workbench(
        scene_of(volume, 0.0, **{"lights": [SKY], "bounces": 1, "target_error": LOOSE, **settings})
    )


@pytest.mark.slow
def test_a_sun_as_a_lobe_is_as_the_path_tracer_has_it(workbench: Make) -> None:
    wrong = {}
    for lobes in (0, 1):
        bench = set_out(workbench, table(), lobes=lobes, target_error=0.03)
        view = bench.view(elevation=50.0, size=40)
        truth = bench.renderer.render(replace(view, shading="path_traced", samples=1024))
        wrong[lobes] = relative_rmse(bench.bake(view), truth)
    assert wrong[1] < 0.05 and wrong[1] < 0.35 * wrong[0]


@pytest.mark.parametrize("light", [(1.0, 0.0, 0.0, 0.0), TURN])
def test_provisional_light_counts_no_lobe_twice(workbench: Make, light: Any) -> None:
    """A ball shadows nothing but itself: unbaked, harmonics alone and with a lobe show nearly the
    same light.
    """
    frames = [set_out(workbench, ball(24, 8.0), lobes=n).renderer for n in (0, 1)]
    view = set_out(workbench, ball(24, 8.0)).view(size=48, light=light)
    plain, with_lobe = (luminance(renderer.render(view)) for renderer in frames)
    assert plain.mean() == pytest.approx(with_lobe.mean(), rel=0.02)
    assert np.sqrt(((plain - with_lobe) ** 2).mean()) < 0.1 * plain.mean(), (
        "order 3 has nearly all of unshadowed light"
    )


def test_lobes_rotate_as_the_light_does(workbench: Make) -> None:
    bench = set_out(workbench, ball(24, 8.0), albedo=[0.2, 0.4, 0.8])
    spec = bench.caches.spec("gi")
    (sun,) = spec.lobes
    still, turned = (
        RotatedLight(spec, bench.view(light=q)).lobes for q in ((1.0, 0.0, 0.0, 0.0), TURN)
    )
    matrix = RotatedLight(spec, bench.view(light=TURN)).matrix
    assert still.kinds.tolist() == [DIRECTIONAL]
    np.testing.assert_allclose(still.places[0], sun.towards)
    np.testing.assert_allclose(turned.places[0], matrix @ sun.towards)
    np.testing.assert_allclose(turned.edges[0], still.edges[0] @ matrix.T)
    np.testing.assert_allclose(
        np.linalg.norm(still.edges[0], axis=1), math.sin(math.radians(sun.angle / 2.0))
    )
    np.testing.assert_allclose(still.edges[0] @ still.places[0], 0.0, atol=1e-12)
    shine = sun.irradiance * np.array([0.2, 0.4, 0.8]) / math.pi
    np.testing.assert_allclose(spec.unit * still.colours[0], shine)


def test_rays_to_lobes_are_cast_again_when_the_light_rotates(
    workbench: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    cast = []
    find = module.find_lobes
    begun = []
    begin = module.find_starts
    monkeypatch.setattr(module, "find_lobes", lambda *given: cast.append(1) or find(*given))
    monkeypatch.setattr(module, "find_starts", lambda *given: begun.append(1) or begin(*given))
    bench = set_out(workbench, ball(24, 8.0))
    for light, expected in (
        ((1.0, 0.0, 0.0, 0.0), 1),
        ((1.0, 0.0, 0.0, 0.0), 1),
        (TURN, 2),
        (TURN, 2),
    ):
        frame = bench.renderer.render(bench.view(size=16, light=light))
        assert len(cast) == expected and frame.seconds["lobes"] > 0.0
        assert len(begun) == 1, "where they start no light changes"
    bench.renderer.render(bench.view(size=16, shading="vicinity"))
    assert len(cast) == 2, "vicinity shading has no lobes"


@pytest.mark.slow
def test_a_moving_view_has_few_lobes_and_one_at_rest_all(workbench: Make, tmp_path: Path) -> None:
    image = np.full((32, 64, 3), 0.02, np.float32)
    rng = np.random.default_rng(3)
    image[rng.integers(4, 20, 40), rng.integers(0, 64, 40)] = rng.uniform(5.0, 50.0, (40, 1))
    write_hdr(tmp_path / "street.hdr", image)
    light = {"type": "probe", "file": str(tmp_path / "street.hdr")}
    bench = set_out(workbench, table(), lights=[light], bounces=0, target_error=0.02)
    spec = bench.caches.spec("gi")
    view = bench.view(elevation=50.0, size=24)
    assert len(spec.moving.lobes) == 4 < len(spec.lobes)
    assert spec.moving.digest == spec.digest
    truth = bench.renderer.render(replace(view, shading="path_traced", samples=4096))
    at_rest = bench.bake(view)
    moving = bench.renderer.render(replace(view, moving=True))
    assert relative_rmse(at_rest, truth) < 0.6 * relative_rmse(moving, truth), (
        "all lobes sharpen all shadows"
    )
    assert luminance(moving).mean() == pytest.approx(luminance(at_rest).mean(), rel=0.05), (
        "no light is lost"
    )


def test_cancelled_rays_to_lobes_stop(workbench: Make) -> None:
    bench = set_out(workbench, ball(24, 8.0))
    view = bench.view(size=16)
    cancelled = threading.Event()
    gbuffer = bench.renderer.gbuffer(view)
    turned = RotatedLight(bench.caches.spec("gi"), view)
    cancelled.set()
    with pytest.raises(Cancelled):
        bench.renderer.surface.lobes(turned, gbuffer, bench.renderer.tiles.cancelled_by(cancelled))
    assert bench.renderer.surface.lobes(turned, gbuffer).lit.any()


def test_the_suns_shadow_lacks_the_suns_light_alone(workbench: Make) -> None:
    bench = set_out(workbench, table())
    view = bench.view(elevation=60.0, size=32)
    gbuffer = bench.renderer.gbuffer(view)
    spec = bench.caches.spec("gi")
    lit = spec.unit * bench.renderer.surface.lobes(RotatedLight(spec, view), gbuffer).lit
    normals = gbuffer.normals(bench.renderer.tiles)
    (sun,) = spec.lobes
    open_light = (
        0.7
        / math.pi
        * np.maximum(normals @ np.array(sun.towards), 0.0)
        * (sun.irradiance @ LUMINANCE_WEIGHTS)
    )
    share = (lit[:, :3] @ LUMINANCE_WEIGHTS)[open_light > 0.0] / open_light[open_light > 0.0]
    assert (share < 1.001).all()
    assert (share < 1e-6).mean() > 0.005 and (np.abs(share - 1.0) < 1e-4).mean() > 0.5, (
        "in the shadow, or in the light"
    )
