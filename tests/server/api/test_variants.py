"""Light and materials that a view names, over a real socket: frames, documents, skies, streams, and
what is refused.
"""

from contextlib import closing
from pathlib import Path

import httpx
import numpy as np
import pytest

from isogi_core.errors import ViewError
from isogi_core.model.lights import ENVIRONMENTS
from isogi_core.model.view import IDENTITY
from isogi_core.plan.assembly import load_scene
from isogi_server.parameters import FrameParams
from isogi_server.render.engine import RenderEngine
from isogi_server.render.scene_variant import Change
from isogi_server.render.variants import Variants
from isogi_server.settings import Settings
from isogi_server.views import view_of
from tests.server.asking import SMALL, final, numbers
from tests.server.sockets import pictures_on

SCENE = "/v1/scenes/small"


def frame(client: httpx.Client, **more: str | float) -> np.ndarray:
    """The numbers of a picture once all its light is final."""
    return numbers(final(client, **{**SMALL, "max_error": 0.2, **more}))


def traced(scene: Path, place: Path, **settings: object) -> np.ndarray:
    """The path-traced radiance of the same view of a scene that has these settings by itself; (h,
    w, 3).
    """
    loaded = load_scene(scene, **settings)
    with closing(RenderEngine([loaded], place, workers=1)) as engine:
        engine.start(with_workers=False)
        params = FrameParams(shading="path_traced", samples=256, width=40, height=40)
        return engine.frame(loaded.id, view_of(loaded, params, Settings())).radiance


@pytest.mark.parametrize(
    ("query", "settings", "rel"),
    [
        ({"environment": "overcast"}, {"environment": "overcast"}, 0.05),
        ({"material": "glass,index=1.3"}, {"material": "glass", "index": 1.3}, 0.03),
        (
            {"material": "subsurface,mean_free_path=1"},
            {"material": "subsurface", "mean_free_path": 1},
            0.06,
        ),
    ],
    ids=["light", "glass", "wax"],
)
def test_a_view_has_the_light_and_material_that_it_names(
    client: httpx.Client,
    small_scene: Path,
    tmp_path: Path,
    query: dict[str, str],
    settings: dict[str, object],
    rel: float,
) -> None:
    shown = frame(client, **query, max_error=0.1)
    on = shown[..., 3] > 0
    truth = traced(small_scene, tmp_path, **settings)[on].mean()
    assert shown[..., :3][on].mean() == pytest.approx(truth, rel=rel)
    assert abs(frame(client)[..., :3][on].mean() / truth - 1.0) > 2 * rel, "its own is another"


def test_going_back_to_a_light_bakes_nothing(client: httpx.Client) -> None:
    def paths() -> list[str]:
        return [
            line
            for line in client.get("/metrics").text.splitlines()
            if line.startswith("isogi_paths_total")
        ]

    for name in ("studio", "overcast", "studio"):
        frame(client, environment=name)
    before = paths()
    for name in ("studio", "overcast"):
        frame(client, environment=name)
    assert paths() == before != []


def documents(client: httpx.Client, **query: str) -> list[dict[str, object]]:
    """The document of the scene, and of a variant, which has no name or address of its own."""
    own, other = (client.get(SCENE, params=each).raise_for_status().json() for each in ({}, query))
    assert own["id"] == other["id"] == "small"
    assert [each["id"] for each in client.get("/v1/scenes").json()["scenes"]] == ["small"]
    return [own, other]


def test_the_document_is_of_the_light_that_is_named(client: httpx.Client) -> None:
    own, lit = documents(client, environment="evening")
    assert (own["environment"], lit["environment"]) == (None, "evening")
    assert [each["id"] for each in own["environments"]] == list(ENVIRONMENTS)  # type: ignore[attr-defined]
    assert (
        lit["lights"] == [{"type": "environment", "name": ENVIRONMENTS["evening"]}] != own["lights"]
    )
    assert lit["defaults"]["exposure"] != own["defaults"]["exposure"]  # type: ignore[index]
    assert client.get("/v1/scenes/small@evening").status_code == 404


def test_the_document_tells_materials_and_is_of_the_one_named(client: httpx.Client) -> None:
    own, wax = documents(client, material="subsurface,mean_free_path=3")
    assert (own["material"], wax["material"]) == ("diffuse", "subsurface,mean_free_path=3.0")
    told = {each["kind"]: each for each in own["materials"]}  # type: ignore[attr-defined]
    assert list(told) == ["diffuse", "glass", "subsurface"] and not any(
        each["refused"] for each in told.values()
    )
    assert told["glass"]["numbers"] == {"index": 1.5, "absorption": 0.0}
    assert told["subsurface"]["numbers"]["mean_free_path"] > 0 and told["diffuse"]["numbers"] == {}
    assert own["turns"] and wax["turns"] and wax["rotating"]
    assert (own["turn_step"], wax["turn_step"]) == (None, 5.0), "wax is baked for each turn"
    assert wax["plan"]["representation"] == "irradiance"  # type: ignore[index]


def test_the_document_of_a_cut_has_the_scenes_own_name(client: httpx.Client) -> None:
    documents(client, cut="x>11.5")


@pytest.mark.parametrize("route", ["", "/frame", "/coverage", "/events"])
@pytest.mark.parametrize(
    "query", ["environment=moon", "environment=", "material=jelly", "material=glass,index=9"]
)
def test_what_is_no_light_or_material_is_422(client: httpx.Client, route: str, query: str) -> None:
    answer = client.get(f"{SCENE}{route}?{query}")
    assert answer.status_code == 422 and answer.json()["parameter"] == query.partition("=")[0]
    assert "must be one of overcast, studio" in answer.json()["detail"] or "material" in query


def test_glass_keeps_no_light_to_export(client: httpx.Client) -> None:
    answer = client.post(f"{SCENE}/export", params={"material": "glass"})
    assert answer.status_code == 422 and "keeps no light of its own" in answer.json()["detail"]


def test_a_job_for_a_variant_leads_to_its_picture(client: httpx.Client) -> None:
    query = {"width": "40", "height": "40", "environment": "noon", "azimuth": "77"}
    answer = client.get(f"{SCENE}/frame", params=query, headers={"Prefer": "respond-async"})
    if answer.status_code == 202:
        assert "small@" not in answer.json()["links"][0]["title"]
        while (job := client.get(answer.headers["location"]).json())["status"] != "successful":
            assert job["status"] in ("accepted", "running")
        (href,) = (
            link["href"]
            for link in job["links"]
            if link["rel"] != "self" and "/frame?" in link["href"]
        )
        assert href.startswith(f"{SCENE}/frame?") and "environment=noon" in href
        assert client.get(href).headers["isogi-provisional"] == "?0"


async def test_a_stream_changes_light_and_material(live_server: str) -> None:
    lights = [{"environment": each} for each in ("studio", "evening")]
    materials = [{"material": each} for each in ("diffuse", "glass", "glass,index=2")]
    assert len(set(await pictures_on(f"{live_server}{SCENE}/stream", [*lights, *materials]))) == 5


def test_light_that_does_not_turn_is_baked_for_each_turn(client: httpx.Client) -> None:
    wax = {"material": "subsurface,mean_free_path=1"}
    own = final(client, **SMALL, **wax, max_error=0.2)
    turned = final(client, **SMALL, **wax, max_error=0.2, yaw=178)
    assert turned.headers["etag"] != own.headers["etag"]
    on = numbers(own)[..., 3] > 0
    assert (on == (numbers(turned)[..., 3] > 0)).all(), "the same surface"
    change = np.abs(numbers(turned)[on, :3] - numbers(own)[on, :3]).mean()
    assert change > 0.04 * numbers(own)[on, :3].mean()
    again = client.get(
        f"{SCENE}/frame",
        params={**SMALL, **wax, "max_error": 0.2, "yaw": 180},
        headers={"If-None-Match": turned.headers["etag"]},
    )
    assert again.status_code == 304, "angles are rounded to steps of 5 degrees"
    twice = client.get(
        f"{SCENE}/frame", params={**SMALL, **wax, "max_error": 0.2, "light": "0,0,0,1"}
    )
    assert twice.headers["isogi-provisional"] == "?0", "a quaternion of the same turn"


def test_a_turn_that_is_none_is_422(client: httpx.Client) -> None:
    wax = {"material": "subsurface,mean_free_path=1"}
    answer = client.get(f"{SCENE}/frame", params={**wax, "light": "0,0,0,0"})
    assert answer.status_code == 422 and "quaternion" in answer.json()["detail"]


async def test_few_turns_are_kept(tmp_path: Path) -> None:
    surfaces = [{"isovalue": 0.012, "albedo": [0.8, 0.3, 0.1]}]
    scene = load_scene("demo:orbital", lights=[{"type": "sky"}], surfaces=surfaces)
    with closing(RenderEngine([scene], tmp_path / "light", workers=1)) as engine:
        variants = Variants(engine, lambda name: name)
        for yaw in range(0, 60, 5):
            shown = await variants.of(scene, Change(turn=(float(yaw), 0.0, 0.0)))
            assert shown.turn == (yaw, 0.0, 0.0)
        assert await variants.of(scene, Change(turn=(0.0, 0.0, 0.0))) is scene
        assert list(engine.scenes) == [
            "orbital",
            *(f"orbital@^{yaw},0,0" for yaw in range(20, 60, 5)),
        ]
        again = engine.again("orbital@^5,0,0")
        assert again is not None and again.turn == (5.0, 0.0, 0.0)
        with pytest.raises(ViewError, match="baked for each turn"):
            view_of(again, FrameParams(yaw=40.0), Settings())
        assert view_of(again, FrameParams(yaw=6.0), Settings()).light == IDENTITY


async def test_light_that_is_kept_for_all_turns_makes_no_variant(engine: RenderEngine) -> None:
    own = engine.scenes["small"]
    assert await Variants(engine, lambda name: name).of(own, Change(turn=(40.0, 0.0, 0.0))) is own
    assert view_of(own, FrameParams(yaw=41.0), Settings()).light != IDENTITY


async def test_few_variants_are_kept(engine: RenderEngine) -> None:
    variants = Variants(engine, lambda name: name if name in ENVIRONMENTS else None, most=2)
    for name in ("studio", "noon", "studio", "evening"):
        await variants.of(engine.scenes["small"], Change(name))
    assert set(engine.scenes) == {"small", "small@studio", "small@evening"}
    engine.dismiss("small")
    assert engine.scenes == {}, "variants go with their scene"
