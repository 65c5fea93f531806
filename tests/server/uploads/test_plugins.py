"""A file of a kind that a stranger's package reads, dropped on the page: the request that the page
makes, to a confined reader.
"""

from collections.abc import Iterator

import httpx
import pytest

from tests.package.strangers import STRANGER, ball, brick, installed
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


@pytest.mark.slow
@pytest.mark.usefixtures("stranger")
def test_a_brick_is_shown_by_the_page(site: Site) -> None:
    facts = post(site).raise_for_status().json()
    scene = site.client.get(facts["scene"]).raise_for_status().json()
    assert scene["volume"]["spacing"] == [1.0, 1.0, 2.0]
    shown = final(site.client, facts["id"], **VIEW)
    assert shown.content.startswith(b"\x89PNG")
    assert "provisional=0.000" in shown.headers["isogi-coverage"]
