"""The albedo of a view over a real socket: parameters, refusals, tags and the scene's document."""

import re
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pytest

from tests.live import serving
from tests.server.asking import Ask, final, numbers
from tests.server.sockets import pictures_on

VIEW: dict[str, str | int | float] = {"width": 24, "height": 20, "azimuth": 40, "f": "npy"}


@pytest.fixture(scope="module")
def server(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A server of the small scene at albedo 0.3, of which views may ask for 0 to 0.9."""
    scene = small_scene.with_name("live.toml")
    scene.write_text(f"albedo = 0.3\nalbedos = [0, 0.9]\n{small_scene.read_text()}")
    with serving(scene, tmp_path_factory.mktemp("store")) as url:
        yield url


@pytest.fixture(scope="module")
def ask(server: str) -> Iterator[Ask]:
    """Asks for a final frame; its light is baked once, at the scene's own albedo."""
    with httpx.Client(base_url=server, timeout=180) as client:
        final(client, "live", **VIEW)
        yield lambda **more: client.get("/v1/scenes/live/frame", params={**VIEW, **more})


def picture(answer: httpx.Response) -> np.ndarray:
    return numbers(answer)[..., :3]


def test_another_albedo_is_final_at_once_and_brighter(ask: Ask) -> None:
    own = ask()
    bright = ask(albedo=0.9)
    warm = ask(albedo="0.9,0.5,0.1")
    for answer in (bright, warm):
        needed, final = re.findall(r"\d+", answer.headers["isogi-chunks"])
        assert needed == final and "provisional=0.000" in answer.headers["isogi-coverage"], (
            "nothing is baked again"
        )
    assert picture(bright).mean() == pytest.approx(3.0 * picture(own).mean(), rel=0.05), (
        "two balls reflect little"
    )
    reds = [picture(answer)[..., 0] for answer in (warm, bright)]
    np.testing.assert_allclose(*reds, rtol=1e-3, err_msg="red is as bright as grey of that share")
    assert picture(warm)[..., 2].max() < picture(bright)[..., 2].max() / 5.0


def test_tags_differ_by_albedo_and_the_scenes_own_is_default(ask: Ask) -> None:
    own, named, spelt, other = (
        ask(**albedo).headers["etag"] for albedo in ({}, {"albedo": 0.3}, *TWO)
    )
    assert own == named == spelt != other


TWO: tuple[dict[str, str | float], ...] = ({"albedo": "0.3,0.3,0.3"}, {"albedo": 0.31})


@pytest.mark.parametrize(
    "albedo", ["0.95", "0.9,0.95,0.1", "1.5", "-0.1", "0.5,0.5", "red", "nan", ""]
)
def test_albedos_that_are_none_or_not_in_the_range_are_refused(ask: Ask, albedo: str) -> None:
    answer = ask(albedo=albedo)
    assert (answer.status_code, answer.json()["parameter"]) == (422, "albedo")
    assert "from 0 to" in answer.json()["detail"]


def test_a_scene_of_one_albedo_says_how_to_have_more(live_server: str) -> None:
    answer = httpx.get(f"{live_server}/v1/scenes/small/frame", params={**VIEW, "albedo": 0.5})
    assert (answer.status_code, answer.json()["parameter"]) == (422, "albedo")
    assert "albedos = [0, 0.9]" in answer.json()["detail"]
    assert (
        httpx.get(
            f"{live_server}/v1/scenes/small/frame", params={**VIEW, "albedo": 0.7}
        ).status_code
        == 200
    )
    assert httpx.get(f"{live_server}/v1/scenes/small").json()["albedos"] is None


def test_the_document_has_the_range_the_default_and_what_is_kept(server: str) -> None:
    scene = httpx.get(f"{server}/v1/scenes/live").json()
    assert scene["albedos"] == scene["ranges"]["albedo"] == {"min": 0.0, "max": 0.9}
    assert scene["defaults"]["albedo"] == 0.3 and scene["albedo"] == [0.3, 0.3, 0.3]
    direct, indirect = scene["plan"]["layers"]
    assert direct["nodes"] == [] and indirect["nodes"][-1] == 0.9 and scene["plan"]["channels"] == 1


@pytest.mark.slow
def test_coverage_and_the_interface_know_the_parameter(server: str) -> None:
    view = {"albedo": "0.9,0.5,0.1", "width": 24, "height": 20}
    covered = httpx.get(f"{server}/v1/scenes/live/coverage", params=view)
    assert covered.status_code == 200 and covered.json()["pixels"]["surface"] > 0
    paths = httpx.get(f"{server}/openapi.json").json()["paths"]
    for way in ("frame", "coverage"):
        parameters = paths[f"/v1/scenes/{{scene}}/{way}"]["get"]["parameters"]
        assert any(each["name"] == "albedo" for each in parameters)


async def test_a_stream_takes_numbers_and_lists(server: str, ask: Ask) -> None:
    views = [
        {"width": 24, "height": 20, "azimuth": 40, "albedo": albedo}
        for albedo in (0.9, [0.9, 0.5, 0.1], "0.9")
    ]
    grey, warm, spelt = await pictures_on(f"{server}/v1/scenes/live/stream", views)
    assert grey != warm != spelt
