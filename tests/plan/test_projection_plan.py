"""Where texels are projected: at the isovalues whose surfaces are stiff, if the scene does not settle it."""

import math
import re
from typing import Any

import numpy as np
import pytest

from isogi_core.errors import SceneError
from isogi_core.model.volume import Isovalue
from isogi_core.plan import projection
from isogi_core.plan.projection import (
    INTERPOLATION,
    NOISY_ERROR,
    SMOOTH_ERROR,
    STEEP_ERROR,
    ProjectionPlan,
    measure_stiffness,
    plan_projection,
)
from tests.kernels.fields import field_of
from tests.loaded import load_scene


def level(value: float) -> Isovalue:
    return Isovalue(np.float64(value))


def plan_of(errors: list[float], allowed: float = 0.01) -> ProjectionPlan:
    return ProjectionPlan(np.arange(len(errors), dtype=float), np.array(errors), allowed)


def stepped(height: float) -> np.ndarray:
    """A smooth slope along x up to 1, and a step of a ``height`` above it."""
    slope = np.minimum(np.arange(24) / 12.0, 1.0) + height * (np.arange(24) >= 18)
    return np.broadcast_to(slope, (20, 20, 24)).astype(np.float32).copy()


def test_the_error_at_the_nearest_level_counts() -> None:
    plan = plan_of([0.0, 0.02, 0.005])
    assert [plan.error(level(at)) for at in (-3, 0, 0.4, 0.6, 1, 1.4, 1.6, 9)] == [0, 0, 0, *[0.02] * 3, 0.005, 0.005]
    assert [plan.projects(level(at)) for at in (0, 0.4, 1, 1.4, 2)] == [False, False, True, True, False]


@pytest.mark.parametrize(
    ("errors", "spans"),
    [
        ([0.0, 0.0], []),
        ([0.0, 0.02, 0.0, 0.0, 0.03], [(0.5, 1.5), (3.5, 4.0)]),
        ([0.02, 0.0, 0.02], [(0.0, 0.5), (1.5, 2.0)]),
        ([0.0, 0.02, 0.02, 0.0], [(0.5, 2.5)]),
        ([0.02], [(0.0, 0.0)]),
    ],
)
def test_spans_hold_just_the_isovalues_that_project(errors: list[float], spans: list[tuple[float, float]]) -> None:
    plan = plan_of(errors)
    assert plan.spans() == spans and plan.any == bool(spans)
    for at in np.linspace(0.0, len(errors) - 1, 8 * len(errors)).tolist():
        inside = any(low <= at <= high for low, high in spans)
        assert plan.projects(level(at)) == inside or at % 1.0 == 0.5


def test_a_steep_surface_is_projected_and_a_smooth_one_is_not() -> None:
    """The error of a step is SMOOTH_ERROR + STEEP_ERROR: above what a target of 2 % allows, and below that of 4 %."""
    field, span = field_of(stepped(2.0)), (level(0.0), level(3.0))
    plan = plan_projection(field, span, level(2.0), 0.02)
    assert plan.allowed == pytest.approx(INTERPOLATION * 0.02)
    assert plan.error(level(0.5)) == pytest.approx(SMOOTH_ERROR)
    assert plan.error(level(2.0)) == pytest.approx(SMOOTH_ERROR + STEEP_ERROR)
    assert not plan.projects(level(0.5)) and plan.projects(level(2.0))
    assert not plan_projection(field, span, level(2.0), 0.04).any


def test_a_sample_of_layers_tells_what_all_of_them_tell() -> None:
    rng = np.random.default_rng(3)
    z, y, x = np.mgrid[:64, :40, :40]
    voxels = (np.hypot(np.hypot(x - 20, y - 20), z / 2 - 16) / 20 + 0.1 * rng.normal(size=x.shape)).astype(np.float32)
    whole, part = (measure_stiffness(field_of(voxels), (0.4, 0.6), most=most) for most in (None, voxels.size // 8))
    assert (part.cells < 0.2 * whole.cells).all() and (part.cells > 0.05 * whole.cells).all()
    for place in range(2):
        assert part.expectation(place).likely == pytest.approx(whole.expectation(place).likely, rel=0.1)
        assert whole.expectation(place).likely > SMOOTH_ERROR + 0.2 * NOISY_ERROR


@pytest.mark.parametrize("most", [1, 100, 1 << 30])
def test_a_sample_of_a_thin_volume_is_not_empty(most: int) -> None:
    found = measure_stiffness(field_of(stepped(2.0)[:3]), (2.0,), most=most)
    assert found.cells[0] > 0 and found.share(found.steep)[0] == 1.0


@pytest.mark.parametrize("projected", [True, False])
def test_a_scene_may_settle_it(projected: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(projection, "count_stiffness", None)
    scene = load_scene("demo:orbital", projected=projected)
    assert scene.projection.any is projected
    assert scene.projection.spans() == ([scene.span] if projected else [])
    assert any(each.what == "surface-projected texels" for each in scene.left_out) is not projected
    other = load_scene("demo:orbital", projected=not projected)
    assert scene.digest != other.digest and scene.bake_digest == other.bake_digest


def test_what_is_left_out_says_what_interpolation_errs_by() -> None:
    scene = load_scene("demo:orbital", lattice=0.4)
    (found,) = (each for each in scene.left_out if each.what == "surface-projected texels")
    error = scene.projection.error(scene.start)
    said = re.match(r"The error of interpolation is about ([\d.]+)", found.why)
    assert said is not None and math.isclose(float(said[1]), 100.0 * error, rel_tol=1e-2)


@pytest.mark.parametrize("settings", [{"sharpen": True}, {"sharpen": False}])
def test_the_former_key_is_refused_with_the_new_one(settings: dict[str, Any]) -> None:
    with pytest.raises(SceneError, match="projected = false"):
        load_scene("demo:orbital", **settings)
