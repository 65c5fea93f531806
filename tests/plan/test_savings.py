"""What plans leave out: each thing only where it is left out, with amounts counted another way."""

import json
from collections.abc import Sequence
from dataclasses import asdict

import numpy as np
import pytest

from isogi_core.cache.chunk_record import record_type
from isogi_core.cache.layer import layer_attributes
from isogi_core.frame.entry_kernels import frame_kernels
from isogi_core.kernels.shading.lattice import DEFAULT_CHUNK_SIDE
from isogi_core.kernels.transport.harmonics import rotate
from isogi_core.kernels.transport.lights import project_lamps
from isogi_core.model.lights import ConstantLight, DirectionalLight, Light, SkyLight
from isogi_core.model.scene_plan import Layer, LeftOut, Saving, ScenePlan
from isogi_core.plan.inputs import PlanOverrides
from isogi_core.plan.left_out import unseen
from isogi_core.plan.reachable_texels import TexelCount
from isogi_core.prepared.prepared_scene import PreparedScene
from tests.loaded import load_scene
from tests.plan.planning import plan_of

LAMP = DirectionalLight()
SKY = SkyLight()
WHITE = ConstantLight()
RED = (0.8, 0.2, 0.2)
CASES: dict[str, tuple[list[Light], dict[str, object]]] = {
    "vicinity": ([WHITE], {"albedo": 0.0}),
    "constant": ([WHITE], {}),
    "coloured constant": ([WHITE], {"albedo": RED}),
    "lamp": ([LAMP], {"rotating": False}),
    "fixed sky": ([SKY], {"rotating": False}),
    "sky": ([SKY], {}),
    "coloured sky": ([SKY], {"albedo": RED}),
    "dark sky": ([SKY], {"albedo": 0.0}),
    "fine sky": ([SKY], {"target": 0.0005}),
    "soft sky": ([SKY], {"target": 0.4}),
}


def found(plan: ScenePlan) -> dict[str, LeftOut]:
    return {each.what: each for each in plan.left_out}


def bytes_of(layers: Sequence[Layer]) -> float:
    """Bytes of a texel, from the records that are written."""
    names = ("rung", "noise", "light", "high")
    total = 0
    for layer in layers:
        record = record_type(layer, DEFAULT_CHUNK_SIDE**3)
        total += (
            sum(record[name].itemsize for name in record.names or () if name in names)
            // DEFAULT_CHUNK_SIDE**3
        )
    return total


@pytest.mark.parametrize("case", CASES)
def test_every_omission_has_a_name_of_its_own_and_a_sentence(case: str) -> None:
    lights, settings = CASES[case]
    plan = plan_of(lights, **settings)
    assert len(found(plan)) == len(plan.left_out)
    for each in plan.left_out:
        assert each.what[0] != " " and each.why[0].isupper() and each.why.endswith(".")
        assert all(saved.amount > 0 and saved.unit for saved in each.saves)
    json.dumps([asdict(each) for each in plan.left_out], allow_nan=False)


@pytest.mark.parametrize("case", CASES)
def test_bytes_of_a_plan_are_those_of_its_records(case: str) -> None:
    lights, settings = CASES[case]
    plan = plan_of(lights, **settings)
    assert plan.bytes_per_texel == bytes_of(plan.layers)


@pytest.mark.parametrize("case", ["vicinity", "constant", "coloured constant", "lamp", "fixed sky"])
def test_what_keeps_no_harmonics_is_measured_by_the_paper(case: str) -> None:
    lights, settings = CASES[case]
    plan = plan_of(lights, **settings)
    (saved,) = found(plan)["S1's harmonics in floats of three channels"].saves
    assert saved.amount == 300 - bytes_of(plan.layers), "25 floats for each of three channels"
    assert saved.unit == "bytes per texel beside S1"


def test_channels_are_left_out_where_they_would_be_the_same() -> None:
    def channels(case: str) -> set[str]:
        lights, settings = CASES[case]
        return {
            what.removeprefix("two of three channels of ")
            for what in found(plan_of(lights, **settings))
            if "channels of" in what
        }

    assert channels("vicinity") == {"direct light"}
    assert channels("constant") == {"light"}
    assert channels("coloured constant") == set()
    assert channels("lamp") == {"irradiance"}
    assert channels("fixed sky") == set()
    assert channels("sky") == {"direct light", "reflected light"}
    assert channels("coloured sky") == {"direct light"}


def test_channels_save_what_a_coloured_scene_adds() -> None:
    grey = plan_of([WHITE])
    coloured = plan_of([WHITE], albedo=RED)
    (saved,) = found(grey)["two of three channels of light"].saves
    assert saved.amount == coloured.bytes_per_texel - grey.bytes_per_texel == 4


def test_bands_are_left_out_of_soft_light_alone() -> None:
    soft = plan_of([SKY], PlanOverrides(lobes=0), target=0.4)
    sharp = plan_of([SKY], PlanOverrides(lobes=0))
    assert any("of direct light" in what and what.startswith("band") for what in found(soft))
    assert not any("of direct light" in what and what.startswith("band") for what in found(sharp))
    order = soft.layers[0].order
    told = plan_of(
        [SKY], PlanOverrides(order=5, indirect_order=soft.indirect_order, precision="half")
    )
    lean = plan_of(
        [SKY], PlanOverrides(order=order, indirect_order=soft.indirect_order, precision="half")
    )
    (saved,) = found(lean)[f"bands {order} to 4 of direct light"].saves
    assert saved.amount == bytes_of(told.layers) - bytes_of(lean.layers)


def test_bands_of_reflected_light_count_up_to_direct_lights() -> None:
    plans = [
        plan_of([SKY], PlanOverrides(order=5, indirect_order=n, precision="half")) for n in (2, 5)
    ]
    (saved,) = found(plans[0])["bands 2 to 4 of reflected light"].saves
    assert saved.amount == bytes_of(plans[1].layers) - bytes_of(plans[0].layers) == 42
    assert not any(
        what.endswith("of reflected light") and "band" in what for what in found(plans[1])
    )


def test_precision_is_left_out_where_it_is_not_kept() -> None:
    told = {
        name: PlanOverrides(order=5, indirect_order=3, precision=name)
        for name in ("bytes", "half", "single")
    }
    kept = {name: plan_of([SKY], each) for name, each in told.items()}
    (halves,) = found(kept["half"])["half of each float"].saves
    assert halves.amount == bytes_of(kept["single"].layers) - bytes_of(kept["half"].layers)
    (second,) = found(kept["bytes"])["second bytes of higher bands"].saves
    assert second.amount == bytes_of(kept["half"].layers) - bytes_of(kept["bytes"].layers)
    assert not any("half" in what or "bytes" in what for what in found(kept["single"]))


def test_reflected_light_is_left_out_where_there_is_none() -> None:
    dark = plan_of([SKY], albedo=0.0)
    told = plan_of([SKY], PlanOverrides(bounces=0))
    lit = plan_of([SKY])
    assert found(dark)["reflected light"].why == "Nothing is reflected at albedo 0."
    assert "asks" in found(told)["reflected light"].why
    assert "reflected light" not in found(lit)
    saved = {
        each.unit: each.amount for each in found(lit)[f"bounces after number {lit.bounces}"].saves
    }
    assert saved == {"rays per path, at most": 1000 - lit.bounces}


@pytest.mark.parametrize(("albedo", "told"), [(0.999, None), (1.0, None), (0.7, 1000)])
def test_bounces_of_the_longest_paths_save_no_number_of_rays(
    albedo: float, told: int | None
) -> None:
    plan = plan_of([SKY], PlanOverrides(bounces=told), albedo=albedo)
    assert plan.bounces == (told or 1000)
    left = found(plan)[f"bounces after number {plan.bounces}"]
    assert left.saves == ()
    assert (
        left.why
        == f"They would bring at most {100 * albedo ** (plan.bounces + 1):.3g}% of the light."
    )


def test_savings_of_roulette_are_given_where_measured() -> None:
    def saved(albedo: float, **told: int) -> tuple[Saving, ...]:
        return found(plan_of([SKY], PlanOverrides(**told), albedo=albedo))[
            "the rest of paths that end by chance"
        ].saves

    measured = (Saving(21, "percent of rays", measured=True),)
    assert saved(0.5) == saved(0.95) == saved(0.7, bounces=30) == measured
    assert saved(0.96) == saved(0.7, bounces=3) == ()
    assert not any("by chance" in what for what in found(plan_of([SKY], albedo=0.49)))


def test_turning_is_left_out_where_it_shows_nothing() -> None:
    for lights, rotating, left in (
        ([WHITE], True, True),
        ([SKY], True, False),
        ([SKY], False, True),
        ([LAMP], False, True),
    ):
        plan = plan_of(lights, rotating=rotating)
        assert ("turning of the light" in found(plan)) == left
        assert any("rotate" in what for what in found(plan)) == left


def test_shadow_rays_are_left_out_where_no_light_is_sharp() -> None:
    assert "shadow rays" in found(plan_of([WHITE]))
    assert "shadow rays" not in found(plan_of([LAMP], rotating=False))
    for rotating in (True, False):
        assert "shadow rays" not in found(plan_of([SKY], rotating=rotating)), "there is a sun in it"


def test_unwritten_chunks_save_megabytes_and_single_texels_none() -> None:
    """A record has room for all texels of its chunk, whether or not they are shown."""
    plan = plan_of([SKY])
    left = {
        each.what: each.saves
        for each in unseen(TexelCount(1000, 300, 20, 40, 30, DEFAULT_CHUNK_SIDE), plan)
    }
    assert [(saved.amount, saved.unit) for saved in left["unseen texels"]] == [(700, "texels")]
    assert [(saved.amount, saved.unit) for saved in left["void texels"]] == [(20, "texels")]
    chunks, megabytes = left["empty chunks"]
    types = [record_type(layer, DEFAULT_CHUNK_SIDE**3) for layer in plan.layers]
    heads = [each[name].itemsize for each in types for name in ("bake", "index", "scale")]
    records = sum(each.itemsize for each in types) - sum(heads)
    assert (chunks.amount, megabytes.amount) == (10, pytest.approx(10 * records / 1e6))
    assert unseen(TexelCount(300, 300, 0, 30, 30, DEFAULT_CHUNK_SIDE), plan) == ()


def test_a_scene_leaves_out_by_its_plan_and_unseen_texels() -> None:
    wide = load_scene("demo:orbital")
    one = load_scene("demo:orbital", isovalues=[0.3, 0.3])
    assert one.isovalue == 0.3
    assert one.left_out[: len(one.plan.left_out)] == one.plan.left_out
    assert one.texels.shown < wide.texels.shown <= wide.texels.total == np.prod(wide.lattice_shape)
    (texels,) = {each.what: each.saves for each in one.left_out}["unseen texels"]
    assert texels.amount == one.texels.total - one.texels.shown


def test_a_bake_says_what_plan_it_was_made_by() -> None:
    scene = load_scene("demo:orbital")
    for layer in scene.plan.layers:
        plan = json.loads(
            json.dumps(layer_attributes(layer, PreparedScene(scene)), allow_nan=False)
        )["plan"]
        assert (plan["representation"], plan["bounces"]) == ("transfer", scene.bounces)
        assert [kept["kind"] for kept in plan["layers"]] == ["direct", "indirect"]
        assert [each["what"] for each in plan["left_out"]] == [
            each.what for each in scene.plan.left_out
        ]


@pytest.mark.parametrize(
    ("lights", "rotating"),
    [([WHITE], True), ([SKY], True), ([SKY], False), ([LAMP], False), ([WHITE, LAMP], False)],
)
def test_kernels_that_are_left_out_are_not_made_ready(lights: list[Light], rotating: bool) -> None:
    """A server that shows the scene alone neither loads nor compiles them."""
    kinds = [{"type": type(light).__name__.removesuffix("Light").lower()} for light in lights]
    scene = load_scene("demo:orbital", lights=kinds, rotating=rotating)
    (idle,) = [each.what for each in scene.left_out if each.what.startswith("kernels ")]
    for kernel in (rotate, project_lamps):
        assert (kernel.__name__ in idle) == (kernel not in frame_kernels([scene]))
