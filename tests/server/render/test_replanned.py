"""A scene whose plan changes gets what it then needs, and keeps what is still true."""

from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.frame.frame import Frame
from isogi_core.kernels.shading.framebuffer import PROVISIONAL
from isogi_core.model.scene_plan import ScenePlan, most_samples
from isogi_core.plan.assembly import load_scene
from isogi_core.plan.scene import Scene
from isogi_server.render.engine import RenderEngine
from tests.baking import bake_each_texel
from tests.server.inline import chunks_in, view_of

SKY = {"type": "sky", "sun_azimuth": 30.0, "sun_elevation": 50.0}
SETTINGS: dict[str, Any] = {
    "lattice": 0.5,
    "bounces": 1,
    "target_error": 0.5,
    "lights": [SKY],
    "precision": "half",
}
"""Each texel takes 64 samples, whatever its noise."""

Turn = Callable[..., "Shown"]


class Shown:
    """What an engine shows of a scene: the first frame, the final one, and the store before,
    between and after.
    """

    def __init__(self, store: Path, **settings: Any) -> None:
        self.scene: Scene = load_scene("demo:orbital", **{**SETTINGS, **settings})
        self.before = chunks_in(store)
        with closing(RenderEngine([self.scene], str(store))) as engine:
            engine.start()
            self.plan = engine.scenes[self.scene.id].plan
            self.first = engine.frame(self.scene.id, view_of(self.scene))
            self.final = bake_each_texel(engine, self.scene.id, view_of(self.scene))
        self.after = chunks_in(store)
        assert not self.final.provisional

    @property
    def digests(self) -> list[str]:
        """The digest of each layer of the scene's plan."""
        return [self.scene.layer_digest(layer) for layer in self.plan.layers]

    @property
    def written(self) -> set[str]:
        """Digests of the layers that were written to; every other chunk is as it was."""
        assert all(self.after[name] == digest for name, digest in self.before.items())
        return {name.split("/")[0] for name in self.after.keys() - self.before.keys()}


@pytest.fixture
def turn(unfiltered: None, inline: None, tmp_path: Path) -> Iterator[Turn]:
    """Shows a scene of these settings, one after the other on the same store unless told.

    Filters would weigh light by its noise, which more layers tell better.
    """
    yield lambda store="light", **settings: Shown(tmp_path / store, **settings)


def alike(one: Frame, other: Frame, error: float = 1e-5) -> np.ndarray:
    """Which surface pixels of two frames have the same light, but for rounding; (pixels,) bool."""
    assert np.array_equal(one.state > 0, other.state > 0)
    return np.isclose(one.radiance, other.radiance, rtol=error).all(axis=-1)[one.state > 0]


def shown_meanwhile(first: Frame, former: Frame) -> bool:
    """Whether a frame is provisional and lit as the former was, but at the few texels that are
    buried.
    """
    return bool(
        (first.state[first.state > 0] == PROVISIONAL).all() and alike(first, former).mean() > 0.95
    )


def same_light(one: Frame, other: Frame) -> bool:
    """Whether two frames are the same bit for bit, but for what they say of their error."""
    return (
        one.radiance.tobytes() == other.radiance.tobytes()
        and one.state.tobytes() == other.state.tobytes()
    )


def omitted(plan: ScenePlan) -> set[str]:
    """What a plan says that it leaves out."""
    return {each.what for each in plan.left_out}


def test_texels_take_as_many_samples_in_every_plan() -> None:
    assert most_samples(SETTINGS["target_error"]) == 64


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["half", "bytes"])
def test_more_bands_are_baked_while_the_former_ones_are_shown(turn: Turn, precision: str) -> None:
    small = turn(order=3, indirect_order=2, precision=precision)
    large = turn(order=5, indirect_order=2, precision=precision)
    assert shown_meanwhile(large.first, small.final) and large.first.demands
    assert large.digests[1] == small.digests[1] and large.written == {large.digests[0]}
    assert same_light(
        large.final, turn("fresh", order=5, indirect_order=2, precision=precision).final
    )


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["half", "bytes"])
def test_fewer_bands_are_served_by_the_layers_that_are_there(turn: Turn, precision: str) -> None:
    large = turn(order=5, indirect_order=2, precision=precision)
    small = turn(order=3, indirect_order=2, precision=precision)
    assert (small.plan.order, small.digests) == (3, large.digests)
    assert "bands 3 to 4 of direct light" in omitted(small.scene.plan) - omitted(small.plan)
    assert dict(small.plan.errors)["harmonics"] == dict(small.scene.plan.errors)["harmonics"]
    assert not small.first.provisional and not small.written
    assert same_light(
        small.final, turn("fresh", order=3, indirect_order=2, precision=precision).final
    )


@pytest.mark.slow
def test_albedo_that_turns_coloured_bakes_reflected_light_alone(turn: Turn) -> None:
    grey = turn(order=3, indirect_order=2)
    coloured = turn(order=3, indirect_order=2, albedo=[0.7, 0.5, 0.3])
    assert (grey.plan.channels, coloured.plan.channels) == (1, 3)
    assert coloured.digests[0] == grey.digests[0] and coloured.written == {coloured.digests[1]}
    assert coloured.first.demands
    assert same_light(
        coloured.final, turn("fresh", order=3, indirect_order=2, albedo=[0.7, 0.5, 0.3]).final
    )


@pytest.mark.slow
def test_light_that_turns_for_a_while_finds_its_first_bake_again(turn: Turn) -> None:
    fixed = turn(rotating=False)
    turning = turn(rotating=True, order=3)
    again = turn(rotating=False)
    assert [shown.plan.representation for shown in (fixed, turning, again)] == [
        "irradiance",
        "transfer",
        "irradiance",
    ]
    assert fixed.written and turning.written == set(turning.digests) and not again.written
    assert fixed.written.isdisjoint(turning.written)
    assert not again.first.provisional
    assert again.first.radiance.tobytes() == fixed.final.radiance.tobytes()
    assert again.first.version == fixed.final.version


@pytest.mark.slow
def test_single_floats_have_own_layers_and_serve_half_floats(turn: Turn) -> None:
    half = turn(order=3)
    single = turn(order=3, precision="single")
    assert shown_meanwhile(single.first, half.final) and single.first.demands
    assert single.written == set(single.digests) and single.written.isdisjoint(half.digests)
    alone = turn("other", order=3, precision="single")
    served = turn("other", order=3)
    assert served.digests == alone.digests and not served.written
    assert omitted(served.scene.plan) - omitted(served.plan) == {"half of each float"}
    assert "rounding" in dict(served.scene.plan.errors) and "rounding" not in dict(
        served.plan.errors
    )
    assert same_light(served.final, single.final)
    assert alike(served.final, half.final, 2e-3).all()
