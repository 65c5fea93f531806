"""Cuts and windows over HTTP: pictures, facts, what is refused, and how many cuts are kept."""

import asyncio
import hashlib
import io
import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from isogi_core.model.lights import ENVIRONMENTS
from isogi_core.model.view import read_window
from isogi_core.plan.scene import Scene
from isogi_core.storage.store import Store
from server.errors import UnknownSceneError
from server.render.engine import RenderEngine
from server.render.scene_variant import Change, SceneVariant
from server.render.variants import Variants
from tests.loaded import load_scene
from tests.server.idle import idle_server
from tests.server.sockets import pictures_on

SCENE = "/v1/scenes/small"


def frame(server: str, **query: str) -> tuple[httpx.Response, np.ndarray]:
    """A frame as numbers, once its light is there."""
    view = {"width": "40", "height": "40", "f": "npy", "wait_ms": "10000", "azimuth": "10", **query}
    for _ in range(12):
        answer = httpx.get(f"{server}{SCENE}/frame", params=view, timeout=60).raise_for_status()
        if answer.headers["isogi-provisional"] == "?0":
            break
    return answer, np.load(io.BytesIO(answer.content))


def texels_kept(server: str) -> float:
    """How many texels of cuts kept the light of the whole."""
    found = httpx.get(f"{server}/metrics").text.split("\nisogi_texels_kept_total ")[1]
    return float(found.split("\n")[0])


def middle(scene_file: Path) -> float:
    """World x of the middle of the small scene's volume."""
    return load_scene(scene_file).volume.world_centre[0]


def test_a_window_hides_what_lies_there_and_bakes_nothing(live_server: str, small_scene: Path) -> None:
    x = middle(small_scene)
    whole, before = frame(live_server)
    looked, after = frame(live_server, window=f"x>{x}")
    assert before[..., 6][before[..., 3] > 0].max() > x + 1
    assert after[..., 6][after[..., 3] > 0].max() <= x + 1e-3
    assert whole.headers["etag"] != looked.headers["etag"]


def test_a_cut_takes_away_and_lets_light_in(live_server: str, small_scene: Path) -> None:
    x = middle(small_scene) + 1.0  # no other test on this server cuts there
    frame(live_server, shading="vicinity")
    before = texels_kept(live_server)
    answer, after = frame(live_server, cut=f"x>{x}", shading="vicinity")
    assert texels_kept(live_server) > before, "texels that light reaches as before are not baked again"
    assert answer.headers["isogi-provisional"] == "?0"
    assert after[..., 6][after[..., 3] > 0].max() <= x + 0.2
    assert (after[..., :3][after[..., 3] > 0].max(axis=1) > 0.0).all()


def test_the_document_of_a_cut_has_the_scenes_own_name(live_server: str, small_scene: Path) -> None:
    cut = f"x>{middle(small_scene)}"
    answer = httpx.get(f"{live_server}{SCENE}", params={"cut": cut}).raise_for_status().json()
    assert answer["id"] == "small"
    listed = httpx.get(f"{live_server}/v1/scenes").json()["scenes"]
    assert [each["id"] for each in listed] == ["small"], "what is cut is no scene of its own"


@pytest.mark.parametrize("route", ["/frame", "/coverage", "/events"])
@pytest.mark.parametrize(
    ("query", "reason"),
    [
        ({"cut": "x=3"}, "'x=3' is none"),
        ({"cut": "1,1,0>3"}, "across the voxels"),
        ({"cut": "x>-99"}, "leaves nothing"),
        ({"window": "w>3"}, "'w>3' is none"),
        ({"surfaces": "off"}, "scenes with [[surfaces]]"),
        ({"hide": "3"}, "scenes of labels"),
        ({"hide": "liver"}, "give the values of labels"),
        ({"window": "0,0,0>3"}, "no direction"),
        ({"window": ";".join(["x>3"] * 13)}, "at most 12 planes"),
    ],
)
def test_planes_without_meaning_are_422(live_server: str, route: str, query: dict[str, str], reason: str) -> None:
    answer = httpx.get(f"{live_server}{SCENE}{route}", params=query)
    assert answer.status_code == 422 and answer.json()["parameter"] == next(iter(query))
    assert reason in answer.json()["detail"]


@pytest.fixture
def crowded(request: pytest.FixtureRequest, small_scene: Path, tmp_path: Path) -> Iterator[str]:
    """The URL of a server that has room for one cut, which clients wait for as long as a parameter says."""
    with idle_server(small_scene, tmp_path) as idle:
        idle.service.variants = Variants(
            idle.engine, lambda name: None, most_cuts=1, room=0, patience=getattr(request, "param", math.inf)
        )
        yield idle.url


def test_eight_people_each_see_the_cut_of_their_own(crowded: str, small_scene: Path) -> None:
    """Each cut makes way for the next while it is drawn, or its light is requested."""
    x, views = middle(small_scene), 3

    async def person(client: httpx.AsyncClient, number: int) -> list[httpx.Response]:
        view = {"cut": f"x>{x + number / 2}", "width": 24, "height": 24, "f": "npy"}
        return [await client.get(f"{SCENE}/frame", params=view | {"azimuth": 10 * n}) for n in range(views)]

    async def people() -> list[list[httpx.Response]]:
        async with httpx.AsyncClient(base_url=crowded, timeout=60) as client:
            return await asyncio.gather(*(person(client, number) for number in range(8)))

    answers = [answer for each in asyncio.run(people()) for answer in each]
    assert {answer.status_code for answer in answers} == {200}
    edges = [np.load(io.BytesIO(answer.content))[..., 6].max() for answer in answers[::views]]
    assert edges == sorted(edges) and edges[0] < edges[-1] - 2, "everybody has the cut that was asked for"


@pytest.mark.parametrize("crowded", [1.2], indirect=True)
def test_a_cut_that_waits_too_long_for_others_is_429(crowded: str, small_scene: Path, monkeypatch: Any) -> None:
    make = Variants.make

    def slowly(*given: Any) -> Scene:
        time.sleep(0.5)
        return make(*given)

    async def people() -> list[httpx.Response]:
        async with httpx.AsyncClient(base_url=crowded, timeout=60) as client:
            cuts = [f"x>{middle(small_scene) + number / 7}" for number in range(6)]
            views = [{"cut": cut, "width": 16, "height": 16, "shading": "lambert"} for cut in cuts]
            return await asyncio.gather(*(client.get(f"{SCENE}/frame", params=view) for view in views))

    monkeypatch.setattr(Variants, "make", slowly)
    answers = asyncio.run(people())
    assert {answer.status_code for answer in answers} == {200, 429}
    assert all("Retry-After" in answer.headers for answer in answers if answer.status_code == 429)


def test_a_stream_goes_on_when_its_cut_made_way(crowded: str, small_scene: Path) -> None:
    x = middle(small_scene)
    views = [{"cut": f"x>{x}"}, {"cut": f"x>{x + 2}"}, {"cut": f"x>{x}"}, {"cut": f"x>{x + 2}"}]
    pictures = asyncio.run(pictures_on(f"{crowded}{SCENE}/stream", views))
    assert pictures[0] == pictures[2] != pictures[1] == pictures[3]


def test_a_cut_that_is_gone_with_its_scene_has_no_inner_name(small_scene: Path, tmp_path: Path) -> None:
    engine = RenderEngine([load_scene(small_scene)], Store(f"file://{tmp_path}"), workers=1)
    try:
        variants = Variants(engine, lambda name: None)
        cut = asyncio.run(variants.of(engine.scenes["small"], Change(cut="x>12")))
        engine.dismiss("small")
        with pytest.raises(UnknownSceneError, match=r"^The scene 'small' is not"):
            engine.renderer(cut.id)
    finally:
        engine.close()


def test_many_small_cuts_are_kept(small_scene: Path, tmp_path: Path) -> None:
    engine = RenderEngine([load_scene(small_scene)], Store(f"file://{tmp_path}"), workers=1)
    try:
        own, variants = engine.scenes["small"], Variants(engine, lambda name: None)
        for number in range(20):
            asyncio.run(variants.of(own, Change(cut=f"x>{5 + number / 2}")))
        assert len(engine.scenes) == 21
    finally:
        engine.close()


def test_cuts_whose_48_bits_were_alike_have_names_of_their_own(small_scene: Path) -> None:
    scene = load_scene(small_scene)
    for one, other in ((16426130, 20828990), (25665836, 28872787)):
        names = [SceneVariant.of(scene, Change(cut=f"x>{x}")).id for x in (one, other)]
        assert names[0] != names[1]
        ends = [hashlib.blake2b(repr(read_window(f"x>{x}")).encode(), digest_size=6).digest() for x in (one, other)]
        assert ends[0] == ends[1], "else this test shows nothing"


def test_few_cuts_are_kept_and_share_their_voxels(small_scene: Path, tmp_path: Path) -> None:
    engine = RenderEngine([load_scene(small_scene)], Store(f"file://{tmp_path}"), workers=1)
    try:
        own = engine.scenes["small"]
        place = {name: name for name in ENVIRONMENTS}.get
        variants, x = Variants(engine, place, most=3, most_cuts=2, room=0), own.volume.world_centre[0]
        one = asyncio.run(variants.of(own, Change(cut=f"x>{x}")))
        lit = asyncio.run(variants.of(own, Change("noon", f"x> {x}")))
        assert lit.volume is one.volume and lit.lighting.environment is not one.lighting.environment
        assert asyncio.run(variants.of(own, Change(cut=f" x>{x}"))) is one
        asyncio.run(variants.of(own, Change("studio")))
        asyncio.run(variants.of(own, Change(cut=f"x>{x + 1}")))
        left = set(engine.scenes) - {"small", "small@studio"}
        assert len(left) == 2 and lit.id not in left and one.id in left
    finally:
        engine.close()
