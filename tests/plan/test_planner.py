"""The planner: the least that gives the picture, for every sort of light, what it refuses, and its
error budget.
"""

import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from isogi_core.bake.bake_spec import spec_for
from isogi_core.bake.texel_light import Light as TexelLight
from isogi_core.errors import LightError, SceneError
from isogi_core.files.radiance import write_hdr
from isogi_core.frame.lighting import rotated_by
from isogi_core.kernels.transport.harmonics import MAX_ORDER
from isogi_core.model.environment import LUMINANCE_WEIGHTS, pixel_directions
from isogi_core.model.lights import (
    ConstantLight,
    DirectionalLight,
    Light,
    PointLight,
    ProbeLight,
    SkyLight,
)
from isogi_core.model.scene_plan import Layer, ScenePlan
from isogi_core.plan.bands import project_environment, truncation_error
from isogi_core.plan.budget import (
    bounces_for,
    even,
    harmonics_error,
    rounding_error,
    tail_of_bounces,
)
from isogi_core.plan.inputs import PlanOverrides
from isogi_core.plan.planner import plan_scene, vicinity_plan
from isogi_core.prepared.prepared_scene import PreparedScene
from tests.bake.texels import climbed, surface_texels
from tests.loaded import load_scene
from tests.plan.planning import NOTHING, inputs_of, plan_of
from tests.scale import COMPILED

RED = (0.8, 0.2, 0.2)
WHITE = ConstantLight()
BLUE = ConstantLight((0.2, 0.3, 1.0))


@pytest.fixture(scope="module")
def soft(tmp_path_factory: pytest.TempPathFactory) -> ProbeLight:
    """A grey probe with bands 0 and 1 alone: brighter from above."""
    return probe(tmp_path_factory.mktemp("soft"), 0.8)


def probe(folder: Path, slope: float) -> ProbeLight:
    """A grey probe of radiance 1 + slope · z."""
    image = 1.0 + slope * pixel_directions(32, 64)[..., 2:]
    write_hdr(folder / "probe.hdr", np.repeat(image, 3, axis=-1).astype(np.float32))
    return ProbeLight(folder / "probe.hdr")


def kinds(plan: ScenePlan) -> list[tuple[str, int, int]]:
    return [(layer.kind, layer.order, layer.channels) for layer in plan.layers]


@pytest.mark.parametrize(
    ("settings", "representation", "layers", "bounces"),
    [
        ({"albedo": 0.0}, "vicinity", [("direct", 1, 1)], 0),
        ({"albedo": 0.7}, "constant", [("whole", 1, 1)], 12),
        ({"albedo": RED}, "constant", [("whole", 1, 3)], 20),
        ({"albedo": 0.7, "rotating": False}, "constant", [("whole", 1, 1)], 12),
    ],
)
def test_constant_light_keeps_one_number_for_each_channel(
    settings: dict[str, Any], representation: str, layers: list[tuple[str, int, int]], bounces: int
) -> None:
    for light in (WHITE, BLUE):
        plan = plan_of([light], **settings)
        assert (plan.representation, kinds(plan), plan.bounces, plan.order) == (
            representation,
            layers,
            bounces,
            1,
        )
        assert plan.bytes_per_texel == (4 if plan.channels == 1 else 8)


def test_fixed_light_keeps_irradiance_in_the_channels_it_needs() -> None:
    lamp = DirectionalLight(irradiance=(3.0, 3.0, 3.0))
    for lights, albedo, channels in (
        ([lamp], 0.7, 1),
        ([lamp, BLUE], 0.7, 3),
        ([lamp], RED, 3),
        ([SkyLight()], 0.7, 3),
    ):
        plan = plan_of(lights, rotating=False, albedo=albedo)
        assert (plan.representation, kinds(plan)) == ("irradiance", [("irradiance", 1, channels)])
        assert plan.bytes_per_texel <= 10 and "harmonics" not in dict(plan.errors)


@pytest.mark.parametrize("radiance", [1e-3, 0.4, 1.0, 3.9, 700.0])
def test_the_brightest_irradiance_is_one_to_two_units(radiance: float) -> None:
    lights = [DirectionalLight(irradiance=(math.pi * radiance,) * 3)]
    (layer,) = plan_of(lights, rotating=False).layers
    assert math.frexp(layer.scale)[0] == 0.5, "a power of two"
    assert 1.0 <= radiance / layer.scale * (1 + 1e-12) < 2.0 + 1e-9


def test_turning_light_keeps_harmonics_of_the_least_order(soft: ProbeLight) -> None:
    plan = plan_of([soft])
    assert plan.representation == "transfer"
    direct, indirect = plan.layers
    assert (direct.kind, direct.order, direct.channels) == ("direct", 2, 1), (
        "bands 0 and 1 are all there is"
    )
    assert (indirect.kind, indirect.channels) == ("indirect", 1) and indirect.order <= 2
    assert [layer.channels for layer in plan_of([soft], albedo=RED).layers] == [1, 3]
    assert kinds(plan_of([soft], albedo=0.0)) == [("direct", 2, 1)]


@pytest.mark.parametrize("target", [0.3, 0.1, 0.05, 0.02])
def test_orders_are_least_within_the_target_or_noted(target: float) -> None:
    inputs = inputs_of([SkyLight()], target=target)
    plan = plan_scene(inputs, PlanOverrides(lobes=0))
    direct, indirect = (layer.order for layer in plan.layers)
    error = math.hypot(
        truncation_error(inputs.energy, direct, "direct"),
        truncation_error(inputs.energy, indirect, "indirect"),
    )
    assert dict(plan.errors)["harmonics"] == pytest.approx(error)
    assert (error > target) == bool(plan.notes)
    if error > target:
        assert direct == 6 and f"target of {target:.0%}" in plan.notes[0]
    else:
        assert truncation_error(inputs.energy, direct - 1, "direct") > math.sqrt(0.5) * target


def test_more_bands_are_taken_only_where_they_reach_the_target() -> None:
    energy = inputs_of([SkyLight()]).energy
    errors = {order: truncation_error(energy, order, "direct") for order in (7, 8)}
    for order, error in errors.items():
        within = inputs_of([SkyLight()], target=1.001 * error)
        assert plan_scene(within, PlanOverrides(lobes=0)).layers[0].order == order
    beyond = inputs_of([SkyLight()], target=0.999 * errors[8])
    assert plan_scene(beyond, PlanOverrides(lobes=0)).layers[0].order == 6


@pytest.mark.parametrize("target", [0.1, 0.05, 0.02])
def test_reflected_light_under_a_sun_has_the_order_it_needs(target: float) -> None:
    inputs = inputs_of([SkyLight()], target=target)
    plan = plan_scene(inputs, PlanOverrides())
    direct, indirect = (layer.order for layer in plan.layers)
    straight = truncation_error(inputs.energy_beside(plan.lobes), direct, "direct")
    error = math.hypot(straight, truncation_error(inputs.energy, indirect, "indirect"))
    assert plan.lobes == 1 and dict(plan.errors)["harmonics"] == pytest.approx(error)
    assert error <= target and not plan.notes and indirect <= 6
    if indirect > 1:
        lower = truncation_error(inputs.energy, indirect - 1, "indirect")
        assert math.hypot(straight, lower) > target, "no order less would do"


def test_notes_advise_light_that_stays_only_where_it_turns() -> None:
    (turning,) = plan_of([SkyLight()], PlanOverrides(lobes=0)).notes
    (fixed,) = plan_of([SkyLight()], PlanOverrides("transfer"), rotating=False).notes
    assert turning == f"{fixed} If it need not turn, rotating = false bakes it in place."


def test_notes_show_small_targets_with_all_digits() -> None:
    (note,) = plan_of([SkyLight()], PlanOverrides(lobes=0), target=1.25e-4).notes
    assert note.count("target of 0.0125%.") == 1


@pytest.mark.parametrize(
    ("albedo", "lost"),
    [
        (0.99, None),
        (0.997, "Paths end after 1000 bounces: at most 4.94% of the light is lost"),
        (1.0, "100%"),
    ],
)
def test_a_note_says_where_the_longest_paths_are_too_short(albedo: float, lost: str | None) -> None:
    notes = plan_of([WHITE], albedo=albedo).notes
    assert len(notes) == (lost is not None) and all(
        lost in note and "target of 2%" in note for note in notes if lost
    )
    assert not plan_of([WHITE], PlanOverrides(bounces=1000), albedo=albedo).notes, "as told"


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "most"),
    [
        ("uffizi_256x128", 100),
        ("grace_256x128", 64),
        ("noon_grass_1024x512", 64),
        ("ennis_256x128", 120),
    ],
)
def test_a_turning_probe_takes_64_bytes_or_reaches_two_percent(
    shared_data: Path, name: str, most: int
) -> None:
    plan = plan_of([ProbeLight(shared_data / f"probe_{name}.hdr")])
    assert plan.representation == "transfer" and plan.bytes_per_texel <= most
    assert most == 64 or dict(plan.errors)["harmonics"] < 0.021
    assert all(layer.order >= 2 for layer in plan.layers), "reflected light turns too"


@pytest.mark.data
@pytest.mark.parametrize(
    "name", ["uffizi_256x128", "wells_256x128", "pisa_256x128", "ennis_256x128"]
)
def test_a_smaller_target_never_takes_fewer_bands(shared_data: Path, name: str) -> None:
    """Beyond the target that 8 bands bring a light to, too."""
    light = ProbeLight(shared_data / f"probe_{name}.hdr")
    plans = [plan_of([light], target=target) for target in (0.02, 0.015, 0.01, 0.005)]
    orders = [plan.layers[0].order for plan in plans]
    assert orders == sorted(orders) and orders[-1] in (6, 8)
    assert (orders[0] == 8) == (name[:6] in ("uffizi", "wells_"))


@pytest.mark.parametrize("slope", [0.0, 1e-4, 0.001, 0.01, 0.1])
def test_a_probe_that_is_even_enough_is_constant_light(tmp_path: Path, slope: float) -> None:
    inputs = inputs_of([probe(tmp_path, slope)])
    error = truncation_error(inputs.energy, 1, "direct")
    assert not even(inputs) or error <= 0.5 * inputs.target_error
    assert (plan_scene(inputs, PlanOverrides()).representation == "constant") == even(inputs)
    assert even(inputs) == (slope <= 0.01)


@pytest.mark.parametrize("albedo", [0.05, 0.3, 0.5, 0.7, 0.9, 0.99])
@pytest.mark.parametrize("target", [0.2, 0.02, 0.001])
def test_bounces_are_the_fewest_within_their_share(albedo: float, target: float) -> None:
    bounces = bounces_for((albedo, 0.0, 0.0), target)
    if bounces < 1000:
        assert albedo ** (bounces + 1) <= target
    if bounces > 0:
        assert albedo**bounces > 0.25 * target


@pytest.mark.parametrize(("albedo", "bounces"), [(0.0, 0), (1.0, 1000), (0.999, 1000), (0.7, 12)])
def test_bounces_at_the_ends(albedo: float, bounces: int) -> None:
    assert plan_of([WHITE], albedo=albedo).bounces == bounces


@pytest.mark.parametrize("lights", [[WHITE], [SkyLight()]])
def test_bounces_at_albedo_0_are_refused_and_no_bounces_are_not(lights: list[Light]) -> None:
    with pytest.raises(SceneError, match=r"bounces = 4 .* albedo 0"):
        plan_of(lights, PlanOverrides(bounces=4), albedo=0.0)
    assert plan_of(lights, PlanOverrides(bounces=0), albedo=0.0) == plan_of(lights, albedo=0.0)


@pytest.mark.parametrize(("bounces", "albedo"), [(0, 0.7), (None, 0.0), (0, 0.0)])
def test_unreflected_constant_light_has_one_layer(bounces: int | None, albedo: float) -> None:
    with pytest.raises(SceneError, match="representation = 'constant'"):
        plan_of([WHITE], PlanOverrides("constant", bounces=bounces), albedo=albedo)
    assert (
        plan_of([WHITE], PlanOverrides(bounces=bounces), albedo=albedo).representation == "vicinity"
    )


def test_bounces_of_the_scene_count_as_no_error() -> None:
    overrides = plan_of([WHITE], PlanOverrides(bounces=1))
    chosen = plan_of([WHITE])
    assert overrides.bounces == 1 and "bounces" not in dict(overrides.errors)
    assert dict(chosen.errors)["bounces"] == pytest.approx(0.7 ** (chosen.bounces + 1))


@pytest.mark.parametrize("target", [0.3, 0.02, 0.005, 0.001, 0.0001])
def test_the_coarsest_precision_whose_rounding_fits(soft: ProbeLight, target: float) -> None:
    for lights in ([WHITE], [soft], [SkyLight()]):
        inputs = inputs_of(lights, target=target)
        plan = plan_scene(inputs, PlanOverrides())
        if plan.half:
            assert rounding_error(plan.layers, inputs, plan.lobes) <= 0.5 * target
        else:
            halved = tuple(Layer(layer.kind, layer.order, layer.channels) for layer in plan.layers)
            assert rounding_error(halved, inputs, plan.lobes) > 0.16 * target


@pytest.mark.parametrize(
    ("lights", "rotating", "overrides", "word"),
    [
        ([WHITE], True, PlanOverrides(order=3), "order = 3"),
        ([WHITE], True, PlanOverrides(indirect_order=3), "indirect_order"),
        ([WHITE], True, PlanOverrides(precision="bytes"), "precision"),
        ([WHITE], True, PlanOverrides(representation="irradiance"), "rotating = false"),
        ([WHITE], True, PlanOverrides(representation="vicinity", bounces=2), "bounces"),
        ([SkyLight()], False, PlanOverrides(order=3), "order = 3"),
        ([SkyLight()], True, PlanOverrides(representation="irradiance"), "rotating = false"),
        ([SkyLight()], True, PlanOverrides(representation="vicinity"), "vicinity"),
        ([SkyLight()], True, PlanOverrides(representation="constant"), "constant"),
        ([SkyLight()], True, PlanOverrides(bounces=0, indirect_order=2), "indirect_order = 2"),
        ([SkyLight()], True, PlanOverrides(order=2, indirect_order=3), "indirect_order = 3"),
        ([SkyLight()], True, PlanOverrides(order=2, precision="bytes"), "precision"),
        ([DirectionalLight()], False, PlanOverrides(representation="transfer"), "transfer"),
        ([DirectionalLight()], False, PlanOverrides(representation="constant"), "constant"),
    ],
)
def test_overrides_that_do_nothing_are_refused(
    lights: list[Light], rotating: bool, overrides: PlanOverrides, word: str
) -> None:
    with pytest.raises(SceneError, match=word):
        plan_of(lights, overrides, rotating=rotating)


@pytest.mark.parametrize(("order", "indirect"), [(1, None), (3, 2), (MAX_ORDER, MAX_ORDER)])
def test_orders_of_the_scene_are_kept(order: int, indirect: int | None) -> None:
    plan = plan_of([SkyLight()], PlanOverrides(order=order, indirect_order=indirect))
    assert plan.layers[0].order == plan.order == order
    assert indirect is None or plan.indirect_order == indirect


def test_a_scene_in_the_dark_has_a_plan() -> None:
    for rotating in (True, False):
        plan = plan_of([ConstantLight((0.0, 0.0, 0.0))], rotating=rotating)
        assert plan.representation == "constant"
    assert (
        plan_of([DirectionalLight(irradiance=(0.0, 0.0, 0.0))], rotating=False).layers[0].scale
        == 1.0
    )


@pytest.mark.parametrize(("height", "width"), [(1, 1), (2, 1), (1, 2), (3, 5), (32, 64)])
def test_an_even_probe_is_as_bright_as_constant_light(
    height: int, width: int, tmp_path: Path
) -> None:
    write_hdr(tmp_path / "even.hdr", np.ones((height, width, 3)))
    assert inputs_of([ProbeLight(tmp_path / "even.hdr")]).brightest == pytest.approx(1.0, rel=1e-9)


def test_brightest_is_the_mean_and_twice_the_pull(soft: ProbeLight) -> None:
    assert inputs_of([soft, ConstantLight((2.0, 2.0, 2.0))]).brightest == pytest.approx(
        3.0 + 2 * 0.8 / 3, rel=0.01
    )


@pytest.mark.parametrize(
    ("lights", "word"),
    [
        ([ConstantLight((1e-33, 1e-33, 1e-33))], "1e-33"),
        ([ConstantLight((1e-300, 1e-300, 1e-300))], "1e-300"),
        ([DirectionalLight(irradiance=(1e-40, 0.0, 0.0))], "white surface"),
        ([PointLight((1e-6, 0.0, 0.0), (1e30, 1e30, 1e30))], "1e-32 to 1e\\+32"),
    ],
)
def test_light_beyond_what_frames_hold_is_refused(lights: list[Light], word: str) -> None:
    inputs = replace(inputs_of(lights, rotating=False), radius=1e-6)
    with pytest.raises(LightError, match=word):
        plan_scene(inputs, NOTHING)


def test_vicinity_shading_reads_direct_light_that_is_there() -> None:
    transfer = plan_of([SkyLight()])
    constant = plan_of([WHITE], PlanOverrides(precision="single"))
    assert vicinity_plan(transfer).layers == transfer.layers[:1]
    assert vicinity_plan(constant).layers == (Layer("direct", half=False),)
    assert vicinity_plan(constant).bounces == 0


# --- the budget against measurements
# ----------------------------------------------------------------------------------


ORDERS = {"order": 6, "indirect_order": 3}
SAMPLES = 512


@cache
def engine(folder: Path, precision: str) -> TexelLight:
    """The same texels of the engine with the same paths, kept in some precision."""
    probe = {"type": "probe", "file": str(folder / "probe_uffizi_256x128.hdr")}
    file = folder / "engine_256x256x128_uint8.nhdr"
    scene = load_scene(file, isovalue=70, lights=[probe], bounces=4, precision=precision, **ORDERS)
    spec = spec_for(PreparedScene(scene), "gi")
    return climbed(spec, surface_texels(spec, 96), SAMPLES)


def luminances(light: TexelLight, lights: np.ndarray, order: int) -> np.ndarray:
    """Luminance of each texel that holds light under each of the ``lights`` (k, n²), bands below
    ``order`` alone.
    """
    return light.transfer[~light.void, 0, : order**2] @ lights[:, : order**2].T


def rounding_of(rounded: TexelLight, exact: TexelLight, lights: np.ndarray, order: int) -> float:
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
        [
            LUMINANCE_WEIGHTS @ rotated_by(still, matrix)
            for matrix in Rotation.random(24, rng=3).as_matrix()
        ]
    )
    measured = rounding_of(engine(shared_data, precision), engine(shared_data, "single"), turns, 6)
    expected = rounding_error(
        plan_scene(inputs, PlanOverrides(**ORDERS, precision=precision)).layers, inputs
    )
    assert expected / 1.5 < measured < expected * 1.5


@COMPILED
@pytest.mark.data
@pytest.mark.slow
def test_one_number_errs_as_the_budget_says(shared_data: Path) -> None:
    measured = rounding_of(
        engine(shared_data, "half"), engine(shared_data, "single"), np.ones((1, 1)), 1
    )
    expected = rounding_error(
        plan_scene(inputs_of([ConstantLight()]), PlanOverrides()).layers,
        inputs_of([ConstantLight()]),
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
def test_paths_branch_where_reflections_are_noisier(
    lights: list[Any], changes: dict[str, Any], branches: int
) -> None:
    """Without its lobes direct light is soft, and the light that is reflected is not, unless little
    is.
    """
    assert plan_of(lights, **changes).branches == branches


def test_plans_of_one_light_have_the_same_branches() -> None:
    """However many lobes and bands they keep, where they keep reflected light at all."""
    changes = (PlanOverrides(lobes=0), PlanOverrides(order=4), PlanOverrides(indirect_order=2))
    assert {plan_of([SUN], change).branches for change in changes} == {4}
    assert plan_of([SUN], PlanOverrides(bounces=0)).branches == 1


def test_single_floats_do_not_err() -> None:
    inputs = inputs_of([ConstantLight()])
    assert (
        rounding_error(plan_scene(inputs, PlanOverrides(precision="single")).layers, inputs) == 0.0
    )


def test_constant_light_loses_nothing_to_harmonics() -> None:
    inputs = inputs_of([ConstantLight()])
    assert harmonics_error(plan_scene(inputs, PlanOverrides()).layers, inputs) == 0.0


@pytest.mark.parametrize("bounces", [0, 3, 12])
def test_the_tail_of_bounces_bounds_what_a_closed_hollow_loses(bounces: int) -> None:
    """In a furnace each bounce brings R times the last: of all light the rest is R^(b + 1)."""
    albedo = 0.7
    series = albedo ** np.arange(400)
    assert tail_of_bounces((albedo, 0.1, 0.2), bounces) == pytest.approx(
        series[bounces + 1 :].sum() / series.sum()
    )
