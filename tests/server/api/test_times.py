"""A series in time over HTTP: its steps are views of one scene, and the light of one stands in for that of the next."""

import asyncio
import io
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pytest

from isogi_core.frame.frame import Frame
from isogi_core.kernels.shading.framebuffer import PROVISIONAL
from isogi_core.model.view import View
from isogi_core.storage.store import Store
from server.render.engine import RenderEngine
from server.render.scene_variant import Change
from server.render.variants import Variants
from tests.live import serving
from tests.loaded import load_scene
from tests.series import SCENE, STEPS, write_series


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_series(tmp_path_factory.mktemp("series"))


@pytest.fixture(scope="module")
def server(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with serving(scene, tmp_path_factory.mktemp("light")) as url:
        yield f"{url}/v1/scenes/series"


def frame(server: str, **query: object) -> np.ndarray:
    """A frame as numbers, once its light is there."""
    view = {"width": 40, "height": 40, "f": "npy", "wait_ms": 10000, "azimuth": 10, **query}
    for _ in range(12):
        answer = httpx.get(f"{server}/frame", params=view, timeout=60).raise_for_status()
        if answer.headers["isogi-provisional"] == "?0":
            return np.asarray(np.load(io.BytesIO(answer.content)))
    raise AssertionError("the frame is not final after two minutes")


def test_a_step_is_the_scene_of_that_step(server: str, scene: Path, tmp_path: Path) -> None:
    alone = scene.with_name("alone.toml")
    alone.write_text(SCENE.replace("time=0", "time=2"))
    with serving(alone, tmp_path) as url:
        expected = frame(f"{url}/v1/scenes/alone")
    found = frame(server, time=2)
    np.testing.assert_array_equal(found[..., 3], expected[..., 3])
    np.testing.assert_allclose(found[..., 6:], expected[..., 6:])
    np.testing.assert_allclose(found[..., :3], expected[..., :3], rtol=1e-5)
    assert np.abs(frame(server, time=0)[..., 3] - expected[..., 3]).any()


def test_the_document_tells_the_steps(server: str) -> None:
    facts = httpx.get(server).json()
    assert (facts["volume"]["time"], facts["volume"]["times"], facts["defaults"]["time"]) == (0, STEPS, 0)
    assert facts["ranges"]["time"] == {"min": 0, "max": STEPS - 1}
    other = httpx.get(server, params={"time": 3}).json()
    assert (other["id"], other["name"], other["volume"]["time"]) == ("series", facts["name"], 3)
    assert other["histogram"]["counts"] != facts["histogram"]["counts"]


def test_a_slice_is_of_its_step(server: str, scene: Path) -> None:
    steps = np.load(scene.with_name("series.npy"))
    for time in (None, 2):
        query = {"axis": "z", "at": 7, "f": "npy"} | ({} if time is None else {"time": time})
        told = np.load(io.BytesIO(httpx.get(f"{server}/slice", params=query).content))
        np.testing.assert_allclose(told, steps[time or 0, 7, ::-1], atol=1e-6)


@pytest.mark.parametrize("time", ["4", "-1", "1.5"])
def test_there_are_no_other_steps(server: str, time: str) -> None:
    answer = httpx.get(f"{server}/frame", params={"time": time})
    assert answer.status_code == 422 and answer.json()["parameter"] == "time"


def test_what_is_no_series_has_no_steps(live_server: str) -> None:
    answer = httpx.get(f"{live_server}/v1/scenes/small/frame", params={"time": 1})
    assert answer.status_code == 422 and "no series in time" in answer.json()["detail"]
    assert "time" not in httpx.get(f"{live_server}/v1/scenes/small").json()["defaults"]


def view_of(engine: RenderEngine) -> View:
    """A small view of the series."""
    scene = engine.scenes["series"]
    return View(0.5, scene.camera(10.0, 20.0, 3.4, 30.0), width=40, height=40)


def final_frame(engine: RenderEngine, scene: str) -> Frame:
    """The frame of a view once it is final."""
    for _ in range(12):
        found = engine.frame(scene, view_of(engine), wait=10.0)
        if not found.provisional:
            return found
    raise AssertionError("the frame is not final after two minutes")


def error_of(found: Frame, wanted: Frame) -> float:
    """RMSE of the surface's radiance over its mean."""
    on = wanted.state > 0
    return float(np.sqrt(((found.radiance - wanted.radiance)[on] ** 2).mean()) / wanted.radiance[on].mean())


def test_the_light_of_the_step_before_stands_in(scene: Path, tmp_path: Path, inline: None) -> None:
    engine = RenderEngine([load_scene(scene)], Store(f"file://{tmp_path}"), workers=1)
    try:
        engine.start()
        steps = Variants(engine, lambda name: None)
        bare = engine.survey(asyncio.run(steps.of(engine.scenes["series"], Change(time=1))).id, view_of(engine), 0.5)
        final_frame(engine, "series")
        engine.dismiss("series@+1")
        lent = engine.survey(asyncio.run(steps.of(engine.scenes["series"], Change(time=1))).id, view_of(engine), 0.5)
        assert set(np.unique(lent.state)) == {0, PROVISIONAL}, "what stands in is told as provisional"
        assert len(lent.demands) == len(bare.demands), "and all of it is still to be baked"
        wanted = final_frame(engine, "series@+1")
        assert error_of(lent, wanted) < 0.7 * error_of(bare, wanted)
    finally:
        engine.close()


def test_few_steps_are_in_memory(scene: Path, tmp_path: Path) -> None:
    engine = RenderEngine([load_scene(scene)], Store(f"file://{tmp_path}"), workers=1)
    try:
        variants, own = Variants(engine, lambda name: name, room=0), engine.scenes["series"]
        for time in (1, 2, 3):
            asyncio.run(variants.of(own, Change(time=time)))
        assert set(engine.scenes) == {"series", "series@+2", "series@+3"}
        lit = asyncio.run(variants.of(own, Change("studio", time=3)))
        assert lit.volume is engine.scenes["series@+3"].volume
        assert asyncio.run(variants.of(own, Change(time=0))) is own
        asyncio.run(variants.of(own, Change(time=1)))
        assert set(engine.scenes) == {"series", "series@+1", "series@studio+3", "series@+3"}
    finally:
        engine.close()
