"""Light probes that clients send: on a real socket, through the confined reader, kept and
deleted.
"""

import re
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pytest

from isogi_core.files.radiance import read_hdr, write_hdr
from isogi_core.model.environment import mean_radiance
from isogi_server.uploads.folder import read_environment
from tests.server.uploads.site import Site

LIGHTS = "/v1/environments"
SMALL = {"width": 32, "height": 32}


def picture(folder: Path, image: np.ndarray) -> bytes:
    """The bytes of an .hdr file."""
    write_hdr(folder / "sent.hdr", image)
    return (folder / "sent.hdr").read_bytes()


def lamp(height: int = 16) -> np.ndarray:
    image = np.full((height, 2 * height, 3), 0.25)
    image[height // 4, height // 2] = (64.0, 32.0, 16.0)
    return image


@pytest.fixture
def sent(site: Site, tmp_path: Path) -> Iterator[dict[str, str]]:
    """An environment that is there while a test runs."""
    answer = site.client.post(
        LIGHTS, params={"name": "Hall"}, content=picture(tmp_path, lamp())
    ).raise_for_status()
    yield answer.json()
    site.client.delete(answer.json()["href"])


def test_it_lights_every_scene(site: Site, sent: dict[str, str]) -> None:
    assert sent["name"] == "Hall" and sent["href"] == f"{LIGHTS}/{sent['id']}"
    scene = site.client.get("/v1/scenes/small").json()
    assert scene["environments"][-1] == sent
    lit = site.client.get("/v1/scenes/small", params={"environment": sent["id"]}).json()
    assert [light["type"] for light in lit["lights"]] == ["probe"]
    queries = ({}, {"environment": sent["id"]})
    own, other = (
        site.client.get("/v1/scenes/small/frame", params={**SMALL, **query}) for query in queries
    )
    assert own.raise_for_status().content != other.raise_for_status().content


def test_it_is_kept_once_as_it_was_sent_and_counts(
    site: Site, sent: dict[str, str], tmp_path: Path
) -> None:
    file = site.folder / f"{sent['id']}.hdr"
    assert np.allclose(read_hdr(file), lamp(), rtol=0.01)
    again = site.client.post(LIGHTS, content=picture(tmp_path, lamp()))
    assert (again.status_code, again.json()["id"]) == (200, sent["id"])
    held = site.client.get(LIGHTS).json()["uploads"]
    assert held["free_bytes"] < held["quota_bytes"]
    assert read_environment(file) is not None, "it is found again"


@pytest.mark.slow
def test_a_large_one_is_made_smaller_with_its_energy(site: Site, tmp_path: Path) -> None:
    image = lamp(1024)
    facts = site.client.post(LIGHTS, content=picture(tmp_path, image)).raise_for_status().json()
    kept = read_hdr(site.folder / f"{facts['id']}.hdr")
    assert kept.shape == (512, 1024, 3), "as docs/uploads.md says"
    assert np.allclose(mean_radiance(kept), mean_radiance(image), rtol=0.01)
    assert site.client.delete(facts["href"]).status_code == 204


def test_an_exr_is_kept_as_a_radiance_picture(site: Site, tmp_path: Path) -> None:
    exr = pytest.importorskip("OpenEXR")
    planes = {name: lamp()[..., k].astype(np.float32) for k, name in enumerate("RGB")}
    given = {"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}
    with exr.File(given, planes) as file:
        file.write(str(tmp_path / "sent.exr"))
    data = (tmp_path / "sent.exr").read_bytes()
    facts = site.client.post(LIGHTS, content=data).raise_for_status().json()
    assert np.allclose(read_hdr(site.folder / f"{facts['id']}.hdr"), lamp(), rtol=0.01)
    assert site.client.delete(facts["href"]).status_code == 204
    # The library prints a warning of a damaged file to stdout, which is no answer.
    answer = site.client.post(LIGHTS, content=data[: len(data) // 2])
    assert answer.status_code == 422 and "damaged or cut short" in answer.json()["detail"]


@pytest.mark.slow
def test_what_is_no_light_is_refused_in_a_sentence(site: Site, tmp_path: Path) -> None:
    refused = {
        b"NRRD0004\n": "no Radiance picture|not a Radiance picture",
        picture(tmp_path, np.ones((8, 8, 3))): "twice as wide as high",
        picture(tmp_path, np.zeros((8, 16, 3))): "black",
        picture(tmp_path, lamp())[:-40]: "damaged or cut short",
        b"#?RADIANCE\n\n-Y 9000 +X 18000\n": "make it smaller",
    }
    for content, words in refused.items():
        answer = site.client.post(LIGHTS, content=content)
        assert answer.status_code == 422 and re.search(words, answer.json()["detail"]), answer.text


def test_a_light_that_is_deleted_is_named_by_no_view(site: Site, tmp_path: Path) -> None:
    facts = site.client.post(LIGHTS, content=picture(tmp_path, lamp(8))).raise_for_status().json()
    query = {**SMALL, "environment": facts["id"]}
    for cut in ({}, {"cut": "x>5"}):
        assert site.client.get("/v1/scenes/small/frame", params=query | cut).status_code == 200
    assert site.client.delete(facts["href"]).status_code == 204
    assert site.client.get("/v1/scenes/small/frame", params=query).status_code == 422
    assert site.client.delete(facts["href"]).status_code == 404
    assert not any(facts["id"] in name for name in site.engine.scenes)
    assert not (site.folder / f"{facts['id']}.hdr").exists()


def test_a_server_without_uploads_says_so(live_server: str, tmp_path: Path) -> None:
    answer = httpx.post(f"{live_server}{LIGHTS}", content=picture(tmp_path, lamp()))
    assert answer.status_code == 403
    assert "takes no uploads" in answer.json()["detail"]
    listed = httpx.get(f"{live_server}{LIGHTS}").json()
    assert listed["uploads"] is None and len(listed["environments"]) == 5
