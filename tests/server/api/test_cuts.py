"""Cuts and windows over HTTP: pictures, facts, what is refused, and how many cuts are kept."""

import asyncio
import hashlib
import math
import threading
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
from isogi_server.errors import UnknownSceneError
from isogi_server.render.engine import RenderEngine
from isogi_server.render.scene_variant import Change, SceneVariant
from isogi_server.render.variants import Variants
from tests.loaded import load_scene
from tests.server.asking import SMALL, final, numbers
from tests.server.idle import idle_server
from tests.server.sockets import pictures_on

SCENE = "/v1/scenes/small"


def frame(client: httpx.Client, **query: str) -> tuple[httpx.Response, np.ndarray]:
    """A frame, and the x of the surface in its pixels, once its light is there."""
    answer = final(client, **SMALL, azimuth=10, **query)
    planes = numbers(answer)
    surface = planes[planes[..., 3] > 0]
    assert (surface[:, :3].max(axis=1) > 0.0).all()
    return answer, surface[:, 6]


def texels_kept(client: httpx.Client) -> float:
    """How many texels of cuts kept the light of the whole."""
    found = client.get("/metrics").text.split("\nisogi_texels_kept_total ")[1]
    return float(found.split("\n")[0])


def middle(scene_file: Path) -> float:
    """World x of the middle of the small scene's volume."""
    return load_scene(scene_file).volume.world_centre[0]


def test_a_window_hides_what_lies_there(client: httpx.Client, small_scene: Path) -> None:
    x = middle(small_scene)
    whole, before = frame(client)
    looked, after = frame(client, window=f"x>{x}")
    assert before.max() > x + 1 and after.max() <= x + 1e-3
    assert whole.headers["etag"] != looked.headers["etag"]


def test_a_cut_takes_away_and_lets_light_in(client: httpx.Client, small_scene: Path) -> None:
    x = middle(small_scene) + 10.0  # a rim, and no other test on this server cuts there
    frame(client, shading="vicinity")
    before = texels_kept(client)
    assert frame(client, cut=f"x>{x}", shading="vicinity")[1].max() <= x + 0.2
    assert texels_kept(client) > before, (
        "texels of isosurfaces that are not cut are not baked again"
    )


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
def test_planes_without_meaning_are_422(
    client: httpx.Client, route: str, query: dict[str, str], reason: str
) -> None:
    answer = client.get(f"{SCENE}{route}", params=query)
    assert answer.status_code == 422 and answer.json()["parameter"] == next(iter(query))
    assert reason in answer.json()["detail"]


@pytest.fixture
def crowded(request: pytest.FixtureRequest, small_scene: Path, tmp_path: Path) -> Iterator[str]:
    """The URL of a server that has room for one cut, which clients wait for as long as a parameter
    says.
    """
    with idle_server(small_scene, tmp_path) as idle:
        idle.service.variants = Variants(
            idle.engine,
            lambda name: None,
            most_cuts=1,
            room=0,
            patience=getattr(request, "param", math.inf),
        )
        yield idle.url


async def test_eight_people_each_see_the_cut_of_their_own(crowded: str, small_scene: Path) -> None:
    """Each cut makes way for the next while it is drawn, or its light is requested."""
    x = middle(small_scene)
    views = 3

    async def person(number: int) -> list[httpx.Response]:
        view = {"cut": f"x>{x + number / 2}", "width": 24, "height": 24, "f": "npy"}
        return [
            await client.get(f"{SCENE}/frame", params=view | {"azimuth": 10 * n})
            for n in range(views)
        ]

    async with httpx.AsyncClient(base_url=crowded, timeout=60) as client:
        answers = [
            answer for each in await asyncio.gather(*map(person, range(8))) for answer in each
        ]
    assert {answer.status_code for answer in answers} == {200}
    edges = [numbers(answer)[..., 6].max() for answer in answers[::views]]
    assert edges == sorted(edges) and edges[0] < edges[-1] - 2, (
        "everybody has the cut that was asked for"
    )


@pytest.mark.parametrize("crowded", [1.2], indirect=True)
async def test_a_cut_that_waits_too_long_for_others_is_429(
    crowded: str, small_scene: Path, monkeypatch: Any
) -> None:
    make = Variants.make

    def slowly(*given: Any) -> Scene:
        time.sleep(0.5)
        return make(*given)

    monkeypatch.setattr(Variants, "make", slowly)
    async with httpx.AsyncClient(base_url=crowded, timeout=60) as client:
        cuts = [f"x>{middle(small_scene) + number / 7}" for number in range(6)]
        views = [{"cut": cut, "width": 16, "height": 16, "shading": "lambert"} for cut in cuts]
        answers = await asyncio.gather(
            *(client.get(f"{SCENE}/frame", params=view) for view in views)
        )
    assert {answer.status_code for answer in answers} == {200, 429}
    assert all("Retry-After" in answer.headers for answer in answers if answer.status_code == 429)


async def test_cuts_of_addresses_take_turns(
    crowded: str, small_scene: Path, monkeypatch: Any
) -> None:
    """One address asks for eight at once; the cut of another, which comes then, waits for one of
    them.
    """
    made = list[str | None]()
    release = threading.Event()
    make = Variants.make

    def slowly(variants: Variants, scene: Scene, variant: SceneVariant, place: str | None) -> Scene:
        made.append(variant.cut)
        assert release.wait(30)
        return make(variants, scene, variant, place)

    monkeypatch.setattr(Variants, "make", slowly)
    x = middle(small_scene)
    crowd = [f"x>{x + number / 9}" for number in range(8)]
    async with from_address("127.0.0.1", crowded) as one, from_address("127.0.0.2", crowded) as two:
        tasks = [asyncio.create_task(one.get(SCENE, params={"cut": cut})) for cut in crowd]
        while not made:
            await asyncio.sleep(0.01)
        await asyncio.sleep(0.5)  # all eight have arrived, or are near
        tasks.append(asyncio.create_task(two.get(SCENE, params={"cut": "y>5"})))
        await asyncio.sleep(0.5)
        release.set()
        answers = await asyncio.gather(*tasks)
    assert {answer.status_code for answer in answers} == {200}
    assert made.index("y>5") <= 2, made


def from_address(address: str, url: str) -> httpx.AsyncClient:
    """A client that asks from an address of this machine."""
    transport = httpx.AsyncHTTPTransport(local_address=address)
    return httpx.AsyncClient(transport=transport, base_url=url, timeout=60)


async def test_a_stream_goes_on_when_its_cut_made_way(crowded: str, small_scene: Path) -> None:
    x = middle(small_scene)
    views = [{"cut": f"x>{x}"}, {"cut": f"x>{x + 2}"}, {"cut": f"x>{x}"}, {"cut": f"x>{x + 2}"}]
    pictures = await pictures_on(f"{crowded}{SCENE}/stream", views)
    assert pictures[0] == pictures[2] != pictures[1] == pictures[3]


async def test_a_cut_that_is_gone_with_its_scene_has_no_inner_name(engine: RenderEngine) -> None:
    cut = await Variants(engine, lambda name: None).of(engine.scenes["small"], Change(cut="x>12"))
    engine.dismiss("small")
    with pytest.raises(UnknownSceneError, match=r"^The scene 'small' is not"):
        engine.renderer(cut.id)


async def test_many_small_cuts_are_kept(engine: RenderEngine) -> None:
    own = engine.scenes["small"]
    variants = Variants(engine, lambda name: None)
    for number in range(20):
        await variants.of(own, Change(cut=f"x>{5 + number / 2}"))
    assert len(engine.scenes) == 21


def test_cuts_whose_48_bits_were_alike_have_names_of_their_own(small_scene: Path) -> None:
    scene = load_scene(small_scene)
    for one, other in ((16426130, 20828990), (25665836, 28872787)):
        names = [SceneVariant.of(scene, Change(cut=f"x>{x}")).id for x in (one, other)]
        assert names[0] != names[1]
        ends = [
            hashlib.blake2b(repr(read_window(f"x>{x}")).encode(), digest_size=6).digest()
            for x in (one, other)
        ]
        assert ends[0] == ends[1], "else this test shows nothing"


async def test_few_cuts_are_kept_and_share_their_voxels(engine: RenderEngine) -> None:
    own = engine.scenes["small"]
    place = {name: name for name in ENVIRONMENTS}.get
    variants = Variants(engine, place, most=3, most_cuts=2, room=0)
    x = own.volume.world_centre[0]
    one = await variants.of(own, Change(cut=f"x>{x}"))
    lit = await variants.of(own, Change("noon", f"x> {x}"))
    assert lit.volume is one.volume and lit.lighting.environment is not one.lighting.environment
    assert await variants.of(own, Change(cut=f" x>{x}")) is one
    await variants.of(own, Change("studio"))
    await variants.of(own, Change(cut=f"x>{x + 1}"))
    left = set(engine.scenes) - {"small", "small@studio"}
    assert len(left) == 2 and lit.id not in left and one.id in left
