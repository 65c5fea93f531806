"""Exports over HTTP: the file is the command's own, jobs are dismissed, and what does not fit is
refused.
"""

import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from isogi_server.errors import FullError, UnknownResultError
from isogi_server.render.jobs import ExportFolder
from tests.server.asking import Told
from tests.server.idle import Idle, idle_server
from tests.server.inline import LONG
from tests.server.jobs import baking, until_over
from tests.server.sockets import wait_for

SCENE = """\
volume = "small.nrrd"
isovalue = 0.5
isovalues = [0.2, 0.8]
bounces = 1
target_error = 0.2
lights = [{ type = "sky" }]
"""
EXPORT = "/v1/scenes/exported/export"
VIEW = {"isovalue": "0.45", "yaw": "70", "exposure": "2.5"}


@pytest.fixture(scope="module")
def scene(small_scene: Path) -> Path:
    path = small_scene.with_name("exported.toml")
    path.write_text(SCENE)
    return path


def test_files_are_those_of_the_command(
    scene: Path, tmp_path: Path, inline: None, told: Told
) -> None:
    fetched = {}
    with baking(scene, tmp_path / "store") as client:
        for kind in ("glb", "usdz", "vti"):
            begun = client.post(EXPORT, params={**VIEW, "f": kind})
            assert (begun.status_code, begun.json()["processID"]) == (202, "export")
            over = until_over(client, begun.headers["location"])
            assert (over["status"], over["progress"]) == ("successful", 100)
            (link,) = [each for each in over["links"] if each["rel"].endswith("/results")]
            assert "100% of its light final" in link["title"]
            answer = client.get(link["href"])
            assert (
                answer.headers["content-disposition"]
                == f'attachment; filename="exported-0.45.{kind}"'
            )
            assert answer.headers["content-type"] == link["type"]
            fetched[kind] = answer.content
            client.delete(begun.headers["location"])
            assert client.get(link["href"]).status_code == 404
    options = [text for name, value in VIEW.items() for text in (f"--{name}", value)]
    for kind, content in fetched.items():
        output = tmp_path / f"a.{kind}"
        told("export", scene, "-o", output, "--store", tmp_path / "store", *options)
        assert output.read_bytes() == content


@pytest.fixture(scope="module")
def idle(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Idle]:
    with idle_server(scene, tmp_path_factory.mktemp("idle")) as idle:
        yield idle


@pytest.mark.parametrize(
    ("asked", "why"),
    [
        ({"f": "stl"}, "glb, usdz, ply, obj, vti, nrrd"),
        ({"isovalue": "0.9"}, "from 0.2 to 0.8"),
        ({"azimuth": "3"}, "no parameter 'azimuth'"),
        ({"light": "1,0,0,0", "yaw": "3"}, "given twice"),
        ({"environment": "disco"}, "disco"),
    ],
)
def test_what_makes_no_sense_is_422_and_begins_nothing(
    idle: Idle, asked: dict[str, str], why: str
) -> None:
    answer = httpx.post(f"{idle.url}{EXPORT}", params=asked)
    assert answer.status_code == 422 and why in answer.json()["detail"]
    assert httpx.get(f"{idle.url}/v1/jobs").json()["jobs"] == []


def test_a_dismissed_export_wants_no_light_and_has_no_file(idle: Idle) -> None:
    address = httpx.post(f"{idle.url}{EXPORT}").headers["location"]
    assert wait_for(lambda: bool(idle.wanted), LONG)
    assert httpx.get(f"{idle.url}{address}/file").status_code == 404
    assert httpx.delete(f"{idle.url}{address}").json()["status"] == "dismissed"
    assert idle.wanted == set()
    assert httpx.delete(f"{idle.url}{address}").status_code == 200


def test_a_request_that_is_repeated_begins_no_second_job(idle: Idle) -> None:
    def begin(key: str | None, **params: str) -> str:
        headers = {} if key is None else {"Idempotency-Key": key}
        answer = httpx.post(f"{idle.url}{EXPORT}", params=params, headers=headers)
        assert answer.status_code == 202 and answer.json()["processID"] == "export"
        return str(answer.headers["location"])

    first = begin("a")
    others = {begin("b"), begin("a", yaw="70"), begin(None), begin(None)}
    assert begin("a") == first and len(others) == 4 and first not in others
    # Also once it has ended: its client may not have heard of it.
    httpx.delete(f"{idle.url}{first}")
    assert begin("a") == first
    assert httpx.get(f"{idle.url}{first}").json()["status"] == "dismissed"
    assert (
        httpx.post(f"{idle.url}{EXPORT}", headers={"Idempotency-Key": "a" * 300}).status_code == 422
    )
    for each in {first, *others}:
        httpx.delete(f"{idle.url}{each}")


def test_a_volume_needs_a_texel_at_each_voxel(small_scene: Path, tmp_path: Path) -> None:
    with idle_server(small_scene, tmp_path) as idle:
        answer = httpx.post(f"{idle.url}/v1/scenes/small/export", params={"f": "vti"})
        assert answer.status_code == 422 and "lattice = 1" in answer.json()["detail"]


def test_the_oldest_files_and_forgotten_ones_make_room() -> None:
    folder = ExportFolder(100)
    folder.check(100)
    with pytest.raises(FullError, match="exports_mb"):
        folder.check(101)
    try:
        for number, job in enumerate(("a", "b", "c")):
            folder.place(job, f"{job}.glb").write_bytes(bytes(30))
            time.sleep(0.02 * (number < 2))
        folder.make_room({"a", "b", "c"}, 10)
        assert [folder.find(job).name for job in "abc"] == ["a.glb", "b.glb", "c.glb"]
        folder.make_room({"a", "c"}, 40)
        assert folder.find("a") and folder.find("c")
        with pytest.raises(UnknownResultError, match="export it again"):
            folder.find("b")
        folder.make_room({"a", "c"}, 41)
        assert folder.find("c")
        with pytest.raises(UnknownResultError):
            folder.find("a")
    finally:
        folder.close()
