"""A series in time over HTTP: its steps are views of one scene, and the light of one stands in for
that of the next.
"""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import httpx
import numpy as np
import pytest

from isogi_core.bake.noise import Goal
from isogi_core.frame.frame import Frame
from isogi_core.kernels.shading.framebuffer import PROVISIONAL
from isogi_core.model.view import View
from isogi_server.render.engine import RenderEngine
from isogi_server.render.scene_variant import Change
from isogi_server.render.variants import Variants
from tests.live import serving
from tests.loaded import load_scene
from tests.series import SCENE, STEPS, write_series
from tests.server.asking import SMALL, final, numbers
from tests.server.inline import LONG


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_series(tmp_path_factory.mktemp("series"))


@pytest.fixture(scope="module")
def client(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    with (
        serving(scene, tmp_path_factory.mktemp("light")) as url,
        httpx.Client(base_url=url) as client,
    ):
        yield client


def frame(client: httpx.Client, scene: str = "series", **query: int) -> np.ndarray:
    """A frame as numbers, once its light is there."""
    return numbers(final(client, scene, **SMALL, azimuth=10, **query))


def test_a_step_is_the_scene_of_that_step(
    client: httpx.Client, scene: Path, tmp_path: Path
) -> None:
    alone = scene.with_name("alone.toml")
    alone.write_text(SCENE.replace("time=0", "time=2"))
    with serving(alone, tmp_path) as url, httpx.Client(base_url=url) as other:
        expected = frame(other, "alone")
    found = frame(client, time=2)
    np.testing.assert_array_equal(found[..., 3], expected[..., 3])
    np.testing.assert_allclose(found[..., 6:], expected[..., 6:])
    np.testing.assert_allclose(found[..., :3], expected[..., :3], rtol=1e-5)
    assert np.abs(frame(client, time=0)[..., 3] - expected[..., 3]).any()


def test_the_document_tells_the_steps(client: httpx.Client) -> None:
    facts = client.get("/v1/scenes/series").json()
    assert (facts["volume"]["time"], facts["volume"]["times"], facts["defaults"]["time"]) == (
        0,
        STEPS,
        0,
    )
    assert facts["ranges"]["time"] == {"min": 0, "max": STEPS - 1}
    other = client.get("/v1/scenes/series", params={"time": 3}).json()
    assert (other["id"], other["name"], other["volume"]["time"]) == ("series", facts["name"], 3)
    assert other["histogram"]["counts"] != facts["histogram"]["counts"]


@pytest.mark.parametrize(("asked", "time"), [({}, 0), ({"time": 2}, 2)])
def test_a_slice_is_of_its_step(
    client: httpx.Client, scene: Path, asked: dict[str, int], time: int
) -> None:
    told = numbers(
        client.get("/v1/scenes/series/slice", params={"axis": "z", "at": 7, "f": "npy", **asked})
    )
    np.testing.assert_allclose(
        told, np.load(scene.with_name("series.npy"))[time, 7, ::-1], atol=1e-6
    )


@pytest.mark.parametrize("time", ["4", "-1", "1.5"])
def test_there_are_no_other_steps(client: httpx.Client, time: str) -> None:
    answer = client.get("/v1/scenes/series/frame", params={"time": time})
    assert answer.status_code == 422 and answer.json()["parameter"] == "time"


def test_what_is_no_series_has_no_steps(live_server: str) -> None:
    answer = httpx.get(f"{live_server}/v1/scenes/small/frame", params={"time": 1})
    assert answer.status_code == 422 and "no series in time" in answer.json()["detail"]
    assert "time" not in httpx.get(f"{live_server}/v1/scenes/small").json()["defaults"]


@pytest.fixture
def series(scene: Path, tmp_path: Path) -> Iterator[RenderEngine]:
    """An engine of the series that is not started."""
    with closing(RenderEngine([load_scene(scene)], tmp_path / "light", workers=1)) as engine:
        yield engine


def view_of(engine: RenderEngine) -> View:
    """A small view of the series."""
    scene = engine.scenes["series"]
    return View(0.5, scene.camera(10.0, 20.0, 3.4, 30.0), width=40, height=40)


def error_of(found: Frame, wanted: Frame) -> float:
    """RMSE of the surface's radiance over its mean."""
    on = wanted.state > 0
    return float(
        np.sqrt(((found.radiance - wanted.radiance)[on] ** 2).mean()) / wanted.radiance[on].mean()
    )


async def test_the_light_of_the_step_before_stands_in(series: RenderEngine, inline: None) -> None:
    series.start()
    variants = Variants(series, lambda name: None)
    own = series.scenes["series"]
    view = view_of(series)
    bare = series.survey((await variants.of(own, Change(time=1))).id, view, Goal.checked(0.5))
    assert not series.frame("series", view, wait=LONG).provisional
    series.dismiss("series@+1")
    lent = series.survey((await variants.of(own, Change(time=1))).id, view, Goal.checked(0.5))
    assert set(np.unique(lent.state)) == {0, PROVISIONAL}, "what stands in is told as provisional"
    assert len(lent.demands) == len(bare.demands), "and all of it is still to be baked"
    wanted = series.frame("series@+1", view, wait=LONG)
    assert not wanted.provisional
    assert error_of(lent, wanted) < 0.7 * error_of(bare, wanted)


async def test_few_steps_are_in_memory(series: RenderEngine) -> None:
    variants = Variants(series, lambda name: name, room=0)
    own = series.scenes["series"]
    for time in (1, 2, 3):
        await variants.of(own, Change(time=time))
    assert set(series.scenes) == {"series", "series@+2", "series@+3"}
    lit = await variants.of(own, Change("studio", time=3))
    assert lit.volume is series.scenes["series@+3"].volume
    assert await variants.of(own, Change(time=0)) is own
    await variants.of(own, Change(time=1))
    assert set(series.scenes) == {"series", "series@+1", "series@studio+3", "series@+3"}
