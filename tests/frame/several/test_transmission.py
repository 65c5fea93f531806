"""Surfaces that light gets through, diffuse: against closed forms, and the cache against paths."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from isogi_core.bake.bake_spec import spec_for
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.several.composed_frame import parts_of
from isogi_core.kernels.transport.harmonics import cosine_lobe_factors
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.plan.bands import evaluate_harmonics
from isogi_core.plan.variants import OUTER, Side
from tests.frame.conftest import SKY, Workbench, ball, relative_rmse, scene_of
from tests.frame.several.drawing import bake, check, drawn
from tests.loaded import load_scene

SIZE = 32
THIN = {"albedo": [0.3, 0.1, 0.5], "transmission": [0.4, 0.6, 0.2], "target_error": 0.02}


@pytest.mark.parametrize(("distance", "side"), [(3.0, OUTER), (0.1, Side(0, True))])
def test_a_sheet_that_loses_nothing_vanishes_in_the_furnace(
    distance: float, side: Side, tmp_path: Path
) -> None:
    """A closed shell under an even sky is as bright as that, from outside and from inside."""
    shell = {"albedo": [0.7, 0.4, 0.2], "transmission": [0.3, 0.6, 0.8], "bounces": 60}
    bench = Workbench(scene_of(ball(), 0.0, **shell), tmp_path)
    frame = drawn(bench, bench.view(size=16, distance=distance, shading="path_traced", samples=128))
    assert {part.side for part in parts_of(frame)} == {side}
    shown = frame.radiance[frame.state > 0]
    np.testing.assert_allclose(shown @ LUMINANCE_WEIGHTS, 1.0, atol=0.2)
    np.testing.assert_allclose(shown.mean(axis=0), 1.0, atol=0.01)


def test_texels_of_a_closed_shell_keep_its_closed_form(tmp_path: Path) -> None:
    """Leaving it outside is ρ L + τ E_in, where E_in = τ L (1 + ρ + …) over the bounces."""
    shell = {"albedo": 0.3, "transmission": 0.5, "bounces": 3, "target_error": 0.02}
    bench = Workbench(scene_of(ball(24, 7.0), 0.0, **shell), tmp_path)
    frame = bake(bench, bench.view(size=SIZE))
    expected = 0.3 + 0.5 * 0.5 * (1.0 + 0.3 + 0.3**2)
    on = frame.state > 0
    np.testing.assert_allclose(frame.radiance[on].mean(axis=0), expected, rtol=0.01)
    assert frame.radiance[on].std() < 0.03 * expected


@pytest.mark.slow
def test_a_picture_at_its_target_is_what_paths_say(tmp_path: Path) -> None:
    """Lit from behind by a sun low in the sky."""
    sun = {"type": "sky", "sun_azimuth": 200.0, "sun_elevation": 20.0}
    bench = Workbench(
        load_scene("demo:orbital", isovalue=0.06, lights=[sun], bounces=3, **THIN), tmp_path
    )
    view = bench.view(size=SIZE)
    bake(bench, view)
    frame = check(bench, view)
    assert not frame.provisional and frame.measured is not None and frame.measured.likely <= 0.03
    traced = drawn(bench, replace(view, shading="path_traced", samples=2048))
    assert relative_rmse(frame, traced) < 0.03
    on = frame.state > 0
    np.testing.assert_allclose(
        frame.radiance[on].mean(axis=0), traced.radiance[on].mean(axis=0), rtol=0.01
    )
    opaque = load_scene(
        "demo:orbital",
        isovalue=0.06,
        lights=[sun],
        bounces=3,
        albedo=THIN["albedo"],
        rotating=False,
    )
    other = Workbench(opaque, tmp_path).renderer.render(
        replace(view, shading="path_traced", samples=256)
    )
    assert frame.radiance[on].mean() > 1.5 * other.radiance[on].mean(), "light comes through"


def test_unshadowed_light_falls_on_both_sides(tmp_path: Path) -> None:
    """What stands in for texels is ρ E(n) + τ E(-n) of the light's harmonics."""
    bench = Workbench(load_scene("demo:orbital", lights=[SKY], **THIN), tmp_path)
    light = RotatedLight(spec_for(bench.prepared, "gi"), bench.view())
    shares = [np.array(THIN[key])[:, None] for key in ("albedo", "transmission")]
    n = np.random.default_rng(3).normal(size=(3, 20))
    n /= np.linalg.norm(n, axis=0)
    lobe = np.repeat(cosine_lobe_factors(3) / np.pi, [1, 3, 5])
    around = light.around * lobe
    front, back = (around @ harmonics_at(each) for each in (n, -n))
    found = light.spec.unit * (light.sky.light * light.sky.lobe) @ harmonics_at(n)
    np.testing.assert_allclose(found, shares[0] * front + shares[1] * back, rtol=1e-6)


def harmonics_at(n: np.ndarray) -> np.ndarray:
    """Harmonics of order 3 at unit vectors (3, m); (9, m)."""
    return np.asarray(evaluate_harmonics(3, np.arccos(n[2]), np.arctan2(n[1], n[0])))
