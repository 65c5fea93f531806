"""Cuts and windows over HTTP: pictures, facts, what is refused, and how many cuts are kept."""

import asyncio
import io
from pathlib import Path

import httpx
import numpy as np
import pytest

from isogi_core.model.lights import ENVIRONMENTS
from isogi_core.storage.store import Store
from server.render.engine import RenderEngine
from server.render.variants import Change, Variants
from tests.loaded import load_scene

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


def test_few_cuts_are_kept_and_share_their_voxels(small_scene: Path, tmp_path: Path) -> None:
    engine = RenderEngine([load_scene(small_scene)], Store(f"file://{tmp_path}"), workers=1)
    try:
        own = engine.scenes["small"]
        place = {name: name for name in ENVIRONMENTS}.get
        variants, x = Variants(engine, place, most=3, most_cuts=2), own.volume.world_centre[0]
        one = asyncio.run(variants.of(own, Change(cut=f"x>{x}")))
        lit = asyncio.run(variants.of(own, Change("noon", f"x> {x}")))
        assert lit.volume is one.volume and lit.environment is not one.environment
        assert asyncio.run(variants.of(own, Change(cut=f" x>{x}"))) is one
        asyncio.run(variants.of(own, Change("studio")))
        asyncio.run(variants.of(own, Change(cut=f"x>{x + 1}")))
        left = set(engine.scenes) - {"small", "small@studio"}
        assert len(left) == 2 and lit.id not in left and one.id in left
    finally:
        engine.close()
