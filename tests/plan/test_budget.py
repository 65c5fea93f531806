"""The error budget against measurements: texels of real volumes baked in each precision, under real probes."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from isogi_core.bake.bake_spec import spec_for
from isogi_core.bake.texel_light import Light
from isogi_core.frame.lighting import rotated_by
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.model.lights import ConstantLight, ProbeLight, SkyLight
from isogi_core.plan.bands import project_environment
from isogi_core.plan.budget import harmonics_error, rounding_error, tail_of_bounces
from isogi_core.plan.inputs import PlanOverrides
from isogi_core.plan.planner import plan_scene
from isogi_core.prepared.prepared_scene import PreparedScene
from tests.bake.texels import climbed, surface_texels
from tests.loaded import load_scene
from tests.plan.planning import inputs_of, plan_of
from tests.scale import COMPILED

ORDERS = {"order": 6, "indirect_order": 3}
SAMPLES = 512


@cache
def engine(folder: Path, precision: str) -> Light:
    """The same texels of the engine with the same paths, kept in some precision."""
    probe = {"type": "probe", "file": str(folder / "probe_uffizi_256x128.hdr")}
    file = folder / "engine_256x256x128_uint8.nhdr"
    scene = load_scene(file, isovalue=70, lights=[probe], bounces=4, precision=precision, **ORDERS)
    spec = spec_for(PreparedScene(scene), "gi")
    return climbed(spec, surface_texels(spec, 96), SAMPLES)


def luminances(light: Light, lights: np.ndarray, order: int) -> np.ndarray:
    """Luminance of each texel that holds light under each of the ``lights`` (k, n²), bands below ``order`` alone."""
    return light.transfer[~light.void, 0, : order**2] @ lights[:, : order**2].T


def rounding_of(rounded: Light, exact: Light, lights: np.ndarray, order: int) -> float:
    """Difference of the luminances, a root mean square over texels and lights, over the mean."""
    exactly, roughly = (luminances(light, lights, order) for light in (exact, rounded))
    return float(np.sqrt(np.mean((roughly - exactly) ** 2)) / exactly.mean())


@COMPILED
@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize("probe", ["uffizi_256x128", "grace_256x128", "noon_grass_1024x512"])
@pytest.mark.parametrize("precision", ["half", "bytes"])
def test_rounding_errs_as_the_budget_says(shared_data: Path, probe: str, precision: str) -> None:
    lights = [ProbeLight(shared_data / f"probe_{probe}.hdr")]
    inputs = inputs_of(lights)
    still = project_environment(inputs.environment, 6)
    turns = np.array(
        [LUMINANCE_WEIGHTS @ rotated_by(still, matrix) for matrix in Rotation.random(24, rng=3).as_matrix()]
    )
    measured = rounding_of(engine(shared_data, precision), engine(shared_data, "single"), turns, 6)
    expected = rounding_error(plan_scene(inputs, PlanOverrides(**ORDERS, precision=precision)).layers, inputs)
    assert expected / 1.5 < measured < expected * 1.5


@COMPILED
@pytest.mark.data
@pytest.mark.slow
def test_one_number_errs_as_the_budget_says(shared_data: Path) -> None:
    measured = rounding_of(engine(shared_data, "half"), engine(shared_data, "single"), np.ones((1, 1)), 1)
    expected = rounding_error(
        plan_scene(inputs_of([ConstantLight()]), PlanOverrides()).layers, inputs_of([ConstantLight()])
    )
    assert measured == pytest.approx(expected, rel=0.2)


SUN = SkyLight()
"""A sky whose sun is a lobe."""


@pytest.mark.parametrize(
    ("lights", "changes", "branches"),
    [
        ([SUN], {}, 4),
        ([SUN], {"albedo": 0.1}, 2),
        ([SUN], {"albedo": 0.03}, 1),
        ([ConstantLight()], {}, 1),
        ([SUN], {"rotating": False}, 1),
    ],
)
def test_paths_branch_where_reflections_are_noisier(lights: list[Any], changes: dict[str, Any], branches: int) -> None:
    """Without its lobes direct light is soft, and the light that is reflected is not, unless little is."""
    assert plan_of(lights, **changes).branches == branches


def test_plans_of_one_light_have_the_same_branches() -> None:
    """However many lobes and bands they keep, where they keep reflected light at all."""
    changes = (PlanOverrides(lobes=0), PlanOverrides(order=4), PlanOverrides(indirect_order=2))
    assert {plan_of([SUN], change).branches for change in changes} == {4}
    assert plan_of([SUN], PlanOverrides(bounces=0)).branches == 1


def test_single_floats_do_not_err() -> None:
    inputs = inputs_of([ConstantLight()])
    assert rounding_error(plan_scene(inputs, PlanOverrides(precision="single")).layers, inputs) == 0.0


def test_constant_light_loses_nothing_to_harmonics() -> None:
    inputs = inputs_of([ConstantLight()])
    assert harmonics_error(plan_scene(inputs, PlanOverrides()).layers, inputs) == 0.0


@pytest.mark.parametrize("bounces", [0, 3, 12])
def test_the_tail_of_bounces_bounds_what_a_closed_hollow_loses(bounces: int) -> None:
    """In a furnace each bounce brings R times the last: of all light the rest is R^(b + 1)."""
    albedo = 0.7
    series = albedo ** np.arange(400)
    assert tail_of_bounces((albedo, 0.1, 0.2), bounces) == pytest.approx(series[bounces + 1 :].sum() / series.sum())
