"""What a page draws several surfaces from, over a real socket: the document, and the light of each
side.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.live import serving_with_a_worker
from tests.server.asking import final

CARD = "/v1/scenes/shells/card"
VIEW: dict[str, Any] = {"width": 40, "height": 36, "azimuth": 40, "max_error": 0.5}
PINNED = "\n[[surfaces]]\nisovalue = 0.35\nalbedo = [0.2, 0.4, 0.8]\nclear = 0.6\n"


@pytest.fixture(scope="module")
def client(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    """A client of a server whose first view, of balls in a clear shell, is final."""
    folder = tmp_path_factory.mktemp("shells")
    (folder / "small.nrrd").write_bytes((small_scene.parent / "small.nrrd").read_bytes())
    (folder / "shells.toml").write_text(small_scene.read_text() + PINNED)
    store = tmp_path_factory.mktemp("store")
    with (
        serving_with_a_worker(folder / "shells.toml", store) as url,
        httpx.Client(base_url=url, timeout=300) as found,
    ):
        final(found, "shells", **VIEW)
        yield found


def chunks(client: httpx.Client, **more: Any) -> list[dict[str, Any]]:
    """The chunks that the view reads."""
    answer = client.get(f"{CARD}/chunks", params={**VIEW, **more})
    assert answer.status_code == 200, answer.text
    found: list[dict[str, Any]] = answer.json()["chunks"]
    return found


def layer_of(chunk: dict[str, Any]) -> int:
    """The chunk's place along z."""
    return int(chunk["at"].split(".")[0])


def test_the_document_lists_the_surfaces_and_their_sides(client: httpx.Client) -> None:
    found = client.get(CARD, params=VIEW).json()
    assert (found["drawable"], found["because"]) == (True, [])
    sliding, pinned = found["scene"]["surfaces"]
    assert (sliding["isovalue"], sliding["clear"]) == (None, 0.0)
    assert (pinned["isovalue"], pinned["clear"]) == (0.35, 0.6)
    assert sliding["albedo"] == pytest.approx([1.0, 1.0, 1.0])
    for side in ("outer", "inner"):
        red, _, blue = pinned[side]["sky"]
        grey = sliding[side]["sky"][0]
        assert red[0] / grey[0] == pytest.approx(pinned["albedo"][0], rel=1e-5)
        assert red[0] < blue[0]
    hidden = client.get(CARD, params={**VIEW, "surfaces": "off"}).json()["scene"]
    assert hidden["surfaces"] is None


def test_light_of_each_side_is_kept_by_its_version(client: httpx.Client) -> None:
    size = client.get(CARD, params=VIEW).json()["scene"]["lattice"]
    deep = -(-size["size"][2] // size["chunk"])
    pinned = next(each for each in chunks(client) if layer_of(each) >= 2 * deep)
    named = f"{CARD}/light/{pinned['at']}-{pinned['version']}"
    answer = client.get(named, params={"max_error": 0.5})
    head = answer.content[:32]
    assert head[:4] == b"ISOB" and head[24:32].hex() == pinned["version"]
    assert int.from_bytes(head[8:10], "little") == layer_of(pinned)
    other = client.get(named, params={"max_error": 0.5, "isovalue": 0.55})
    assert other.content[24:32].hex() != pinned["version"], "it depends on the isovalue"


def test_there_is_no_chunk_beyond_the_last_side(client: httpx.Client) -> None:
    assert client.get(f"{CARD}/light/99.0.0").status_code == 404
    answer = client.get(f"{CARD}/transfer/0.0.0")
    assert answer.status_code == 404 and "transfer" in answer.json()["detail"]
