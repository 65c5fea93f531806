"""Materials that a view names, over a real socket: frames, documents, and what is refused."""

import asyncio
import io
import time
from pathlib import Path

import httpx
import numpy as np
import pytest

from isogi_core.plan.assembly import load_scene
from isogi_core.storage.store import Store
from server.parameters import FrameParams
from server.render.engine import RenderEngine
from server.settings import Settings
from server.views import view_of
from tests.server.sockets import pictures_on

SCENE = "/v1/scenes/small"
VIEW = {"width": 40, "height": 40, "f": "npy", "wait_ms": 10_000, "max_error": 0.2}


def frame(server: str, **more: str) -> np.ndarray:
    """The numbers of a picture once all its light is final."""
    while True:
        answer = httpx.get(f"{server}{SCENE}/frame", params={**VIEW, **more}, timeout=120)
        if answer.status_code == 429:  # kernels are compiled
            time.sleep(1.0)
            continue
        assert answer.status_code == 200, answer.text
        if answer.headers["isogi-provisional"] == "?0":
            return np.asarray(np.load(io.BytesIO(answer.content)))


def traced(scene: Path, place: Path, **settings: object) -> np.ndarray:
    """The path-traced radiance of the same view of a scene that has these settings by itself; (h, w, 3)."""
    loaded = load_scene(scene, **settings)
    engine = RenderEngine([loaded], Store(f"file://{place}"), workers=1)
    try:
        engine.start(hire=False)
        params = FrameParams(shading="path_traced", samples=256, width=40, height=40)
        return engine.frame(loaded.id, view_of(loaded, params, Settings())).radiance
    finally:
        engine.close()


@pytest.mark.parametrize(
    ("material", "settings", "rel"),
    [
        ("glass,index=1.3", {"material": "glass", "index": 1.3}, 0.03),
        ("subsurface,mean_free_path=1", {"material": "subsurface", "mean_free_path": 1}, 0.06),
    ],
)
def test_a_view_is_of_the_material_that_it_names(
    live_server: str, small_scene: Path, tmp_path: Path, material: str, settings: dict[str, object], rel: float
) -> None:
    shown = frame(live_server, material=material, max_error="0.1")
    on = shown[..., 3] > 0
    truth = traced(small_scene, tmp_path, **settings)[on].mean()
    assert shown[..., :3][on].mean() == pytest.approx(truth, rel=rel)
    assert abs(frame(live_server)[..., :3][on].mean() / truth - 1.0) > 2 * rel, "its own is another"


def test_the_document_tells_materials_and_is_of_the_one_named(live_server: str) -> None:
    own, wax = (
        httpx.get(f"{live_server}{SCENE}", params=query).raise_for_status().json()
        for query in ({}, {"material": "subsurface,mean_free_path=3"})
    )
    assert (own["material"], wax["material"], wax["id"]) == ("diffuse", "subsurface,mean_free_path=3.0", "small")
    told = {each["kind"]: each for each in own["materials"]}
    assert list(told) == ["diffuse", "glass", "subsurface"] and not any(each["refused"] for each in told.values())
    assert told["glass"]["numbers"] == {"index": 1.5, "absorption": 0.0}
    assert told["subsurface"]["numbers"]["mean_free_path"] > 0 and told["diffuse"]["numbers"] == {}
    assert own["turns"] and not wax["turns"] and wax["plan"]["representation"] == "irradiance"
    listed = httpx.get(f"{live_server}/v1/scenes").json()["scenes"]
    assert [each["id"] for each in listed] == ["small"], "a variant is no scene of its own"


@pytest.mark.parametrize("route", ["", "/frame", "/coverage", "/events"])
@pytest.mark.parametrize("material", ["jelly", "glass,index=9", "glass,mean_free_path=2", ""])
def test_what_is_no_material_is_422(live_server: str, route: str, material: str) -> None:
    answer = httpx.get(f"{live_server}{SCENE}{route}", params={"material": material})
    assert answer.status_code == 422 and answer.json()["parameter"] == "material"


def test_glass_keeps_no_light_to_export(live_server: str) -> None:
    answer = httpx.post(f"{live_server}{SCENE}/export", params={"material": "glass"})
    assert answer.status_code == 422 and "keeps no light of its own" in answer.json()["detail"]


def test_a_stream_changes_its_material(live_server: str) -> None:
    views = [{"material": each} for each in ("diffuse", "glass", "glass,index=2")]
    assert len(set(asyncio.run(pictures_on(f"{live_server}{SCENE}/stream", views)))) == 3
