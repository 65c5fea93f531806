"""The sky of a scene over a real socket: a picture that may be kept."""

import io
from pathlib import Path

import httpx
import numpy as np
import pytest
from PIL import Image

from isogi_core.frame.framing import paint_panorama
from isogi_core.plan.assembly import load_scene

PATH = "/v1/scenes/small/sky"


def picture_of(answer: httpx.Response) -> np.ndarray:
    assert answer.status_code == 200, answer.text
    return np.asarray(Image.open(io.BytesIO(answer.content)).convert("RGB"))


def test_it_is_the_panorama_of_the_scene(live_server: str, small_scene: Path) -> None:
    answer = httpx.get(f"{live_server}{PATH}", params={"width": 100})
    scene = load_scene(small_scene)
    assert answer.headers["content-type"] == "image/png"
    assert np.array_equal(picture_of(answer), paint_panorama(scene.lighting.environment, scene.lighting.lamps, 100))
    assert picture_of(httpx.get(f"{live_server}{PATH}")).shape == (128, 256, 3)


@pytest.mark.parametrize("form", ["jpeg", "webp"])
def test_other_formats(live_server: str, form: str) -> None:
    answer = httpx.get(f"{live_server}{PATH}", params={"f": form})
    assert answer.headers["content-type"] == f"image/{form}"
    assert picture_of(answer).shape == (128, 256, 3)


def test_what_a_client_has_is_not_sent_again(live_server: str) -> None:
    answer = httpx.get(f"{live_server}{PATH}")
    tag = answer.headers["etag"]
    assert answer.headers["cache-control"] == "no-cache"
    again = httpx.get(f"{live_server}{PATH}", headers={"If-None-Match": tag})
    assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", tag)
    others = ({"width": "64"}, {"f": "webp"})
    assert len({tag, *(httpx.get(f"{live_server}{PATH}", params=each).headers["etag"] for each in others)}) == 3


def test_at_its_version_address_it_is_immutable(live_server: str) -> None:
    version = httpx.get(f"{live_server}{PATH}").headers["etag"].strip('"')
    kept = httpx.get(f"{live_server}{PATH}", params={"version": version})
    assert kept.headers["cache-control"] == "max-age=31536000, immutable"
    other = httpx.get(f"{live_server}{PATH}", params={"version": "0" * 32})
    assert (other.status_code, other.headers["cache-control"]) == (200, "no-cache")


@pytest.mark.parametrize(
    ("name", "text"),
    [("width", "15"), ("width", "513"), ("width", "1e2"), ("f", "npy"), ("version", "x"), ("yaw", "0")],
)
def test_what_it_does_not_read_is_refused(live_server: str, name: str, text: str) -> None:
    answer = httpx.get(f"{live_server}{PATH}", params={name: text})
    assert answer.status_code == 422
    assert name in answer.json()["detail"]


def test_an_unknown_scene_has_none(live_server: str) -> None:
    assert httpx.get(f"{live_server}/v1/scenes/none/sky").status_code == 404
