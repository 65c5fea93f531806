"""A file of a kind that a stranger's package reads, dropped on the page: the request that the page
makes, to a confined reader.
"""

from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from tests.package.strangers import STRANGER, ball, brick, installed, write_package
from tests.server.asking import final
from tests.server.uploads.site import Site

VIEW = {"width": 32, "height": 24, "isovalue": 150.0, "max_error": 0.5}


@pytest.fixture
def stranger() -> Iterator[None]:
    with installed(STRANGER):
        yield


def post(site: Site) -> httpx.Response:
    """Send a brick as the page sends what is dropped on it."""
    return site.client.post("/v1/volumes", params={"name": "f.brick"}, content=brick(ball()))


def test_a_brick_is_refused_without_the_package(site: Site) -> None:
    answer = post(site)
    assert answer.status_code == 422 and "no volume that is known" in answer.json()["detail"]


def test_a_module_that_fails_to_load_breaks_no_upload(site: Site, tmp_path: Path) -> None:
    code = "from isogi.plugins import *\nK = Kind('abc', suffixes=('.abc',), reader='inner:f')\n"
    place = write_package(tmp_path, "torn", code, "isogi.readers", "torn:K")
    (place / "inner.py").write_text("{}['a']\n")
    with installed(place, STRANGER):
        assert post(site).raise_for_status().json()["size"] == [16, 16, 16]
        answer = site.client.post("/v1/volumes", params={"name": "f.abc"}, content=b"123")
        assert answer.status_code == 422
        assert "cannot be read as abc by the plug-in torn (" in answer.json()["detail"]


@pytest.mark.slow
@pytest.mark.usefixtures("stranger")
def test_a_brick_is_shown_by_the_page(site: Site) -> None:
    facts = post(site).raise_for_status().json()
    scene = site.client.get(facts["scene"]).raise_for_status().json()
    assert scene["volume"]["spacing"] == [1.0, 1.0, 2.0]
    shown = final(site.client, facts["id"], **VIEW)
    assert shown.content.startswith(b"\x89PNG")
    assert "provisional=0.000" in shown.headers["isogi-coverage"]
