"""Light that a view names, over a real socket: frames, documents, skies, streams, and light that is kept."""

import asyncio
import io
from pathlib import Path

import httpx
import numpy as np
import pytest

from isogi_core.frame.framing import paint_panorama
from isogi_core.model.lights import ENVIRONMENTS
from isogi_core.plan.assembly import load_scene
from isogi_core.storage.store import Store
from server.parameters import FrameParams
from server.render.engine import RenderEngine
from server.render.scene_variant import Change
from server.render.variants import Variants
from server.settings import Settings
from server.views import view_of
from tests.server.sockets import pictures_on

SCENE = "/v1/scenes/small"
VIEW = {"width": 40, "height": 40, "f": "npy", "wait_ms": 10_000, "max_error": 0.2}


def frame(server: str, **more: str) -> np.ndarray:
    """The numbers of a picture once all its light is final."""
    while True:
        answer = httpx.get(f"{server}{SCENE}/frame", params={**VIEW, **more}, timeout=120)
        assert answer.status_code == 200, answer.text
        if answer.headers["isogi-provisional"] == "?0":
            return np.asarray(np.load(io.BytesIO(answer.content)))


def test_a_view_is_shown_in_the_light_that_it_names(live_server: str, small_scene: Path, tmp_path: Path) -> None:
    shown = frame(live_server, environment="overcast", max_error="0.1")  # its mean is to be right within 0.05
    scene = load_scene(small_scene, environment="overcast")
    engine = RenderEngine([scene], Store(f"file://{tmp_path}"), workers=1)
    try:
        engine.start(hire=False)
        params = FrameParams(shading="path_traced", samples=256, width=40, height=40)
        traced = engine.frame(scene.id, view_of(scene, params, Settings()))
    finally:
        engine.close()
    on = shown[..., 3] > 0
    light, truth = shown[..., :3][on].mean(), traced.radiance[on].mean()
    assert light == pytest.approx(truth, rel=0.05)
    assert abs(frame(live_server)[..., :3][on].mean() / truth - 1.0) > 0.1, "its own light is another"


def test_going_back_to_a_light_bakes_nothing(live_server: str) -> None:
    for name in ("studio", "overcast", "studio"):
        frame(live_server, environment=name)
    before = httpx.get(f"{live_server}/metrics").text
    frame(live_server, environment="studio")
    frame(live_server, environment="overcast")
    after = httpx.get(f"{live_server}/metrics").text
    paths = [[line for line in text.splitlines() if line.startswith("isogi_paths_total")] for text in (before, after)]
    assert paths[0] == paths[1] and paths[0]


def test_the_document_is_of_the_light_that_is_named(live_server: str) -> None:
    own, lit = (
        httpx.get(f"{live_server}{SCENE}", params=query).raise_for_status().json()
        for query in ({}, {"environment": "evening"})
    )
    assert (own["environment"], lit["environment"], lit["id"]) == (None, "evening", "small")
    assert [each["id"] for each in own["environments"]] == list(ENVIRONMENTS)
    assert lit["lights"] == [{"type": "environment", "name": ENVIRONMENTS["evening"]}] != own["lights"]
    assert lit["defaults"]["exposure"] != own["defaults"]["exposure"]
    listed = httpx.get(f"{live_server}/v1/scenes").json()["scenes"]
    assert [each["id"] for each in listed] == ["small"], "a variant is no scene of its own"


def test_its_sky_is_painted(live_server: str, small_scene: Path) -> None:
    answer = httpx.get(f"{live_server}{SCENE}/sky", params={"width": 64, "environment": "gallery"})
    scene = load_scene(small_scene, environment="gallery")
    from PIL import Image

    picture = np.asarray(Image.open(io.BytesIO(answer.content)).convert("RGB"))
    assert np.array_equal(picture, paint_panorama(scene.lighting.environment, scene.lighting.lamps, 64))


@pytest.mark.parametrize("route", ["", "/frame", "/coverage", "/events", "/sky"])
@pytest.mark.parametrize("name", ["moon", "0" * 20, ""])
def test_what_is_no_light_is_422(live_server: str, route: str, name: str) -> None:
    answer = httpx.get(f"{live_server}{SCENE}{route}", params={"environment": name})
    assert answer.status_code == 422 and answer.json()["parameter"] == "environment"
    assert answer.json()["detail"].startswith("environment must be one of overcast, studio")


def test_a_variant_has_no_address_of_its_own(live_server: str) -> None:
    frame(live_server, environment="overcast")
    assert httpx.get(f"{live_server}/v1/scenes/small@overcast").status_code == 404


def test_a_job_for_it_leads_to_its_picture(live_server: str) -> None:
    query = {"width": "40", "height": "40", "environment": "noon", "azimuth": "77"}
    answer = httpx.get(f"{live_server}{SCENE}/frame", params=query, headers={"Prefer": "respond-async"})
    if answer.status_code == 202:
        assert "small@" not in answer.json()["links"][0]["title"]
        while (job := httpx.get(f"{live_server}{answer.headers['location']}").json())["status"] != "successful":
            assert job["status"] in ("accepted", "running")
        (href,) = (link["href"] for link in job["links"] if link["rel"] != "self" and "/frame?" in link["href"])
        assert href.startswith(f"{SCENE}/frame?") and "environment=noon" in href
        assert httpx.get(f"{live_server}{href}").headers["isogi-provisional"] == "?0"


def test_a_stream_changes_its_light(live_server: str) -> None:
    views = [{"environment": each} for each in ("studio", "evening")]
    first, second = asyncio.run(pictures_on(f"{live_server}{SCENE}/stream", views))
    assert first != second


def test_few_variants_are_kept(small_scene: Path, tmp_path: Path) -> None:
    engine = RenderEngine([load_scene(small_scene)], Store(f"file://{tmp_path}"), workers=1)
    try:
        own = engine.scenes["small"]
        variants = Variants(engine, lambda name: name if name in ENVIRONMENTS else None, most=2)
        for name in ("studio", "noon", "studio", "evening"):
            asyncio.run(variants.of(own, Change(name)))
        assert set(engine.scenes) == {"small", "small@studio", "small@evening"}
        engine.dismiss("small")
        assert engine.scenes == {}, "variants go with their scene"
    finally:
        engine.close()
